"""The two dialects of the robot's interface, and every difference between them in one table.

`cloud` is the published interface: CloudCommand in, EdgeTelemetry and EdgeEvent out. `io` is the one that the robot's
public Python client speaks: RobotCommand in, RobotState out. Decoding, telemetry, time-outs and the docs read `RULES`;
nothing else knows of a difference.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Literal

import numpy as np

from asimov_gym.edge.control import Dialect, Source
from asimov_gym.firmware.trajectory_control import KD_LIMIT, KP_LIMIT
from asimov_gym.robot.joints import MOTOR_NAMES

PROTOCOL_VERSION = 1
"""Version that a RobotCommand must state, and that a RobotState states."""
KP_RANGE = (0.0, KP_LIMIT)
"""Position gain of a motor, N·m/rad; beyond it a gain is clamped. Both dialects."""
KD_RANGE = (0.0, KD_LIMIT)
"""Damping gain of a motor, N·m·s/rad; beyond it a gain is clamped. Both dialects."""


def _swap_neck() -> tuple[str, ...]:
    """Firmware order with the two neck motors exchanged."""
    order = list(MOTOR_NAMES)
    pitch, yaw = order.index("Neck_Pitch"), order.index("Neck_Yaw")
    order[pitch], order[yaw] = order[yaw], order[pitch]
    return tuple(order)


@dataclass(frozen=True)
class DialectRules:
    """What one dialect means by the same commands."""

    velocity_limit: tuple[float, float, float]
    """Range of |vx|, |vy| (m/s) and |vyaw| (rad/s); beyond it a velocity is clamped."""
    trajectory_timeout_s: float
    """MOVE/TRAJECTORY falls back to DAMP after this long without a request."""
    trajectory_from_damp: bool
    """Whether joint targets engage a robot in DAMP; else they are dropped there."""
    arming_s: float
    """How long STAND must have been held upright before velocity or joint targets are taken; 0: at once."""
    gains_together: bool
    """Whether kp and kd must come together; else each may be given alone."""
    ankle_entries: Literal["motors", "joints"]
    """What a trajectory's four ankle entries are: motors A and B, or pitch and roll. Reports always hold the motors."""
    motor_order: tuple[str, ...]
    """Motor names in the order of its joint arrays."""
    ankle_limit: tuple[float, float] | None = None
    """Clamp of pitch and roll in a trajectory, rad; None for the joints' own range."""
    velocity_timeout_s: Mapping[Source, float] = field(default_factory=lambda: MappingProxyType({}))
    """Lanes on which a velocity becomes zero (the robot stays in MOVE) this long after the last one; else it holds."""

    def to_joint_order(self, values: np.ndarray) -> np.ndarray:
        """Entries of a joint array (25,) of this dialect, put in the contract's order."""
        return values[_PERMUTATION[self.motor_order]]

    from_joint_order = to_joint_order
    """The way back: the permutation swaps one pair and is its own inverse."""


RULES: Mapping[Dialect, DialectRules] = MappingProxyType(
    {
        Dialect.CLOUD: DialectRules(
            velocity_limit=(2.0, 1.0, 2.0),
            trajectory_timeout_s=0.2,
            trajectory_from_damp=True,
            arming_s=0.0,
            gains_together=False,
            ankle_entries="motors",
            motor_order=MOTOR_NAMES,
        ),
        Dialect.IO: DialectRules(
            velocity_limit=(0.4, 0.4, 0.8),
            trajectory_timeout_s=2.0,
            trajectory_from_damp=False,
            arming_s=0.5,
            gains_together=True,
            ankle_entries="joints",
            motor_order=_swap_neck(),
            ankle_limit=(0.35, 0.1),
            velocity_timeout_s=MappingProxyType({Source.UDP: 2.0}),
        ),
    }
)
"""Rules by dialect."""

_PERMUTATION = {
    rules.motor_order: np.array([rules.motor_order.index(name) for name in MOTOR_NAMES]) for rules in RULES.values()
}
