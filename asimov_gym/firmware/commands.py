"""What the firmware takes from the edge: four commands, already checked, in SI units and joint order."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from asimov_gym.firmware.modes import Trigger
from asimov_gym.robot.joints import JOINT_NAMES


@dataclass(frozen=True)
class Damp:
    """Go limp."""

    trigger = Trigger.DAMP


@dataclass(frozen=True)
class Stand:
    """Take the standing pose."""

    trigger = Trigger.STAND


@dataclass(frozen=True)
class Velocity:
    """Walk. Holds until the next command."""

    vx: float
    """m/s, forward."""
    vy: float
    """m/s, to the left."""
    vyaw: float
    """rad/s, counter-clockwise."""
    trigger = Trigger.VELOCITY

    @property
    def vector(self) -> np.ndarray:
        """(vx, vy, vyaw)."""
        return np.array([self.vx, self.vy, self.vyaw])


@dataclass(frozen=True)
class Trajectory:
    """Drive every joint to a position at once."""

    position: np.ndarray
    """rad, (25,), joint order."""
    kp: np.ndarray | None = None
    """N·m/rad at the joint, (25,); None for the default gains."""
    kd: np.ndarray | None = None
    """N·m·s/rad at the joint, (25,); None for the default gains."""
    trigger = Trigger.TRAJECTORY

    def __post_init__(self) -> None:
        for name, value in (("position", self.position), ("kp", self.kp), ("kd", self.kd)):
            if value is not None and (value.shape != (len(JOINT_NAMES),) or not np.isfinite(value).all()):
                raise ValueError(f"{name} must be {len(JOINT_NAMES)} finite numbers in joint order, got {value}")


Command = Damp | Stand | Velocity | Trajectory
