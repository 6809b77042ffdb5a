"""The verbs of a session as messages of either dialect.

Arguments are always the contract's: joint arrays in firmware order, the ankle entries as motors A and B.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Protocol

import numpy as np

from asimov_gym.edge.control import Dialect
from asimov_gym.edge.dialect import PROTOCOL_VERSION, RULES
from asimov_gym.edge.wire import cloud_pb2, io_pb2
from asimov_gym.robot import ankle

CommandMessage = cloud_pb2.CloudCommand | io_pb2.RobotCommand


class CommandWriter(Protocol):
    """Makes one dialect's messages, not yet stamped with time and sequence."""

    def stand(self) -> CommandMessage: ...

    def damp(self) -> CommandMessage: ...

    def velocity(self, vx: float, vy: float, vyaw: float) -> CommandMessage:
        """m/s, m/s, rad/s; finite."""
        ...

    def trajectory(self, positions: np.ndarray, kp: np.ndarray | None, kd: np.ndarray | None) -> CommandMessage:
        """Arrays of 25 finite values in firmware order; None for the default gains.

        Raises:
            ValueError: the dialect cannot say this.
        """
        ...


class CloudWriter:
    """Dialect `cloud`: as it is."""

    def stand(self) -> cloud_pb2.CloudCommand:
        return cloud_pb2.CloudCommand(mode=cloud_pb2.ModeCommand(mode=cloud_pb2.MODE_STAND))

    def damp(self) -> cloud_pb2.CloudCommand:
        return cloud_pb2.CloudCommand(mode=cloud_pb2.ModeCommand(mode=cloud_pb2.MODE_DAMP))

    def velocity(self, vx: float, vy: float, vyaw: float) -> cloud_pb2.CloudCommand:
        return cloud_pb2.CloudCommand(velocity=cloud_pb2.VelocityCommand(vx=vx, vy=vy, vyaw=vyaw))

    def trajectory(self, positions: np.ndarray, kp: np.ndarray | None, kd: np.ndarray | None) -> cloud_pb2.CloudCommand:
        segment = cloud_pb2.JointSegment(positions=positions, kp=_given(kp), kd=_given(kd))
        request = cloud_pb2.TrajectoryRequest(full=cloud_pb2.FullTrajectory(segments=[segment]))
        return cloud_pb2.CloudCommand(trajectory=request)


class IoWriter:
    """Dialect `io`: ankle entries become pitch and roll, arrays take its motor order, gains come in pairs."""

    _rules = RULES[Dialect.IO]

    def stand(self) -> io_pb2.RobotCommand:
        return io_pb2.RobotCommand(mode=io_pb2.CONTROL_MODE_STAND, protocol_version=PROTOCOL_VERSION)

    def damp(self) -> io_pb2.RobotCommand:
        return io_pb2.RobotCommand(mode=io_pb2.CONTROL_MODE_DAMP, protocol_version=PROTOCOL_VERSION)

    def velocity(self, vx: float, vy: float, vyaw: float) -> io_pb2.RobotCommand:
        return io_pb2.RobotCommand(
            mode=io_pb2.CONTROL_MODE_MOVE,
            command_control=io_pb2.COMMAND_CONTROL_POLICY,
            policy=io_pb2.VelocityCommand(vx=vx, vy=vy, vyaw=vyaw),
            protocol_version=PROTOCOL_VERSION,
        )

    def trajectory(self, positions: np.ndarray, kp: np.ndarray | None, kd: np.ndarray | None) -> io_pb2.RobotCommand:
        if (kp is None) != (kd is None):
            given, missing = ("kp", "kd") if kd is None else ("kd", "kp")
            raise ValueError(
                f"{given} without {missing}: over this lane the robot takes both or neither; give both, or leave both "
                "out for its defaults"
            )
        # The firmware reads pitch and roll and couples them by the linear form, whatever its linkage is.
        entries = ankle.to_joint_position(positions, "linear")
        targets = io_pb2.AllTrajectory(
            positions=self._rules.from_joint_order(entries),
            kp=_given(None if kp is None else self._rules.from_joint_order(kp)),
            kd=_given(None if kd is None else self._rules.from_joint_order(kd)),
        )
        return io_pb2.RobotCommand(
            mode=io_pb2.CONTROL_MODE_MOVE,
            command_control=io_pb2.COMMAND_CONTROL_TRAJECTORY,
            all_trajectory=targets,
            protocol_version=PROTOCOL_VERSION,
        )


def _given(values: np.ndarray | None) -> list[float]:
    return [] if values is None else values.tolist()


WRITERS: Mapping[Dialect, CommandWriter] = MappingProxyType({Dialect.CLOUD: CloudWriter(), Dialect.IO: IoWriter()})
"""Writer by dialect."""
