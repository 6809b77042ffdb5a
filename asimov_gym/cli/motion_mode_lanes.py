"""The lanes of `asimov robot --motion-modes`: which were asked for, and all of them open at once."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import TYPE_CHECKING

from asimov_gym.edge import Edge

if TYPE_CHECKING:
    from asimov_gym.edge.motion_modes_service import MotionModes
    from asimov_gym.edge.transports.ros2 import Ros2Lane
    from asimov_gym.edge.transports.rosbridge import RosbridgeLane

ROSBRIDGE_PORT = 9090
"""Taken where none is given."""


@dataclass(frozen=True)
class MotionModeOptions:
    """Which lanes serve motion modes, and where."""

    ros2: bool = False
    rosbridge_port: int | None = None
    """TCP; 0 for any free one, None for no such lane."""
    listen: str = "127.0.0.1"


def parse_motion_modes(lanes: Sequence[str], listen: str = "127.0.0.1") -> MotionModeOptions | None:
    """What `--motion-modes` asks for; None if it was not given.

    Args:
        lanes: each `ros2`, `rosbridge` or `rosbridge:PORT`.
        listen: address that they are opened on.

    Raises:
        ValueError: one is none of these, or comes twice.
    """
    if not lanes:
        return None
    kinds = [lane.partition(":")[0] for lane in lanes]
    if len(set(kinds)) < len(kinds):
        raise ValueError(f"--motion-modes takes each lane once, got {' '.join(lanes)}")
    port: int | None = None
    for lane in lanes:
        kind, colon, number = lane.partition(":")
        if kind == "rosbridge" and (not colon or (number.isascii() and number.isdecimal())):
            port = int(number) if colon else ROSBRIDGE_PORT
        elif lane != "ros2":
            raise ValueError(f"--motion-modes must be ros2, rosbridge or rosbridge:PORT, got {lane!r}")
    return MotionModeOptions("ros2" in kinds, port, listen)


class MotionModeLanes:
    """The open lanes, over one service.

    Args:
        edge: of the robot.
        options: which to open.
        stack: closes them.

    Raises:
        ImportError: a package is missing; the line says how to install it.
        TransportError: a lane cannot be opened.
    """

    def __init__(self, edge: Edge, options: MotionModeOptions, stack: ExitStack) -> None:
        from asimov_gym.edge.motion_modes_service import MotionModes

        self.modes: MotionModes = stack.enter_context(MotionModes(edge))
        self.ros2: Ros2Lane | None = None
        self.rosbridge: RosbridgeLane | None = None
        if options.ros2:
            from asimov_gym.edge.transports.ros2 import Ros2Lane  # needs an optional package

            self.ros2 = stack.enter_context(Ros2Lane(self.modes, listen=options.listen))
        if options.rosbridge_port is not None:
            from asimov_gym.edge.transports.rosbridge import RosbridgeLane  # so does this

            lane = RosbridgeLane(edge, self.modes, options.rosbridge_port, options.listen)
            self.rosbridge = stack.enter_context(lane)

    def connect_lines(self) -> list[tuple[str, str]]:
        """How to reach them, for people."""
        lanes = {"ROS 2": self.ros2, "rosbridge": self.rosbridge}
        return [(kind, lane.connect_line) for kind, lane in lanes.items() if lane is not None]
