"""What the firmware takes from the edge: its commands, already checked, in SI units and joint order."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from asimov_gym.firmware.modes import Trigger
from asimov_gym.robot.joints import JOINT_NAMES


@dataclass(frozen=True)
class Damp:
    """Go limp."""

    limp: bool = False
    """Without the damping too: no torque at all. The robot's own interface never asks for it."""
    trigger = Trigger.DAMP


@dataclass(frozen=True)
class Stand:
    """Take the standing pose."""

    trigger = Trigger.STAND


@dataclass(frozen=True)
class Velocity:
    """Walk. Holds until the next command, or until its time is up."""

    vx: float
    """m/s, forward."""
    vy: float
    """m/s, to the left."""
    vyaw: float
    """rad/s, counter-clockwise."""
    timeout_s: float | None = None
    """After this long without another velocity the robot walks on the spot: the velocity becomes zero, the mode stays.
    None holds it for ever."""
    trigger = Trigger.VELOCITY

    def __post_init__(self) -> None:
        if not all(math.isfinite(value) for value in (self.vx, self.vy, self.vyaw)):
            raise ValueError(f"a velocity must be finite, got vx={self.vx}, vy={self.vy}, vyaw={self.vyaw}")
        _check_timeout(self.timeout_s)

    @property
    def vector(self) -> np.ndarray:
        """(vx, vy, vyaw)."""
        return np.array([self.vx, self.vy, self.vyaw])


@dataclass(frozen=True)
class Trajectory:
    """Drive every joint to a position at once."""

    position: np.ndarray
    """rad, (25,), joint order: the pose that the machine is to reach, which under the exact ankle is not quite what the
    firmware's linear linkage was asked for (see `Linkage.reached_position`)."""
    kp: np.ndarray | None = None
    """N·m/rad at the joint, (25,); None for the default gains."""
    kd: np.ndarray | None = None
    """N·m·s/rad at the joint, (25,); None for the default gains."""
    timeout_s: float | None = None
    """After this long without another trajectory the robot goes to DAMP; None for the configuration's
    `trajectory_timeout_s`."""
    trigger = Trigger.TRAJECTORY

    def __post_init__(self) -> None:
        _check_timeout(self.timeout_s)
        for name, value in (("position", self.position), ("kp", self.kp), ("kd", self.kd)):
            if value is not None and (value.shape != (len(JOINT_NAMES),) or not np.isfinite(value).all()):
                raise ValueError(f"{name} must be {len(JOINT_NAMES)} finite numbers in joint order, got {value}")


def _check_timeout(seconds: float | None) -> None:
    if seconds is not None and not (math.isfinite(seconds) and seconds > 0.0):
        raise ValueError(f"timeout_s must be None or a finite number > 0, got {seconds!r}")


@dataclass(frozen=True)
class Stream:
    """Give the joints to the stream of joint commands; see `asimov_gym.firmware.joint_control`."""

    trigger = Trigger.TRAJECTORY


@dataclass(frozen=True)
class Freeze:
    """Hold every joint where it is, with the robot's own gains, until another command. Nothing balances the robot."""

    trigger = Trigger.TRAJECTORY


Command = Damp | Stand | Velocity | Trajectory | Stream | Freeze
