"""The joint-control lane: gRPC services that a client of Boston Dynamics' joint-control interface finds on this robot.

The message definitions are the vendor's published package `bosdyn-api`, an optional dependency under a licence of its
own (Boston Dynamics SDK licence 20191101-BDSDK-SL) that allows it with a software simulator and forbids it with any
hardware but the vendor's. So it serves the simulated robot and nothing else. Nothing of that package is copied here, it
is imported when a lane starts, and no other part of this project knows it.
"""

from asimov_gym.edge.transports.joint_control.lane import LICENCE_LINE, JointControlLane

__all__ = ["LICENCE_LINE", "JointControlLane"]
