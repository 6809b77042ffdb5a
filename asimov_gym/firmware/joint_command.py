"""One command of joint control, and what it asks of the joints at an instant.

A command gives every joint a position, a velocity and a load for a while. In between two commands the wanted position
moves on at the wanted velocity, so that a stream of a few hundred commands a second makes a smooth motion; past its end
a command asks for nothing. All of it is here and pure. Who may command, and what follows when the stream ends, is in
`asimov_gym.firmware.joint_control`.

Times are microseconds of the robot's clock (`Clock.now_us`). Joint arrays are (25,) in joint order, the ankles as pitch
and roll.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from asimov_gym.physics import JointTarget
from asimov_gym.robot.joints import EFFORT, JOINT_NAMES, RANGE

FEET = 2
"""Feet, left before right, in contact advice and contact states."""
VELOCITY_BOUND = 1000.0
"""Wanted velocities are held within this, rad/s: no joint comes near, and absurd inputs stop the physics."""
_LARGEST_KEY = 2**32 - 1


class Advice(Enum):
    """What the commander knows of a foot's contact; a hint to the estimator."""

    NONE = "none"
    IN_CONTACT = "in contact"
    NOT_IN_CONTACT = "not in contact"


@dataclass(frozen=True)
class JointGains:
    """Gains of the control law at the joints.

    Raises:
        ValueError: not 25 values each, or one that is not finite or negative.
    """

    kp: np.ndarray
    """N·m/rad, (25,)."""
    kd: np.ndarray
    """N·m·s/rad, (25,)."""

    def __post_init__(self) -> None:
        for name in ("kp", "kd"):
            values = getattr(self, name)
            _check_joints(f"gains.{name}", values)
            if (values < 0.0).any():
                joint = int(np.flatnonzero(values < 0.0)[0])
                raise ValueError(f"gains.{name} of {JOINT_NAMES[joint]} must be 0 or more, got {values[joint]:g}")

    def within(self, kp_limit: float, kd_limit: float) -> JointGains:
        """The same, no greater than the limits."""
        if (self.kp <= kp_limit).all() and (self.kd <= kd_limit).all():
            return self
        return JointGains(np.minimum(self.kp, kp_limit), np.minimum(self.kd, kd_limit))


@dataclass(frozen=True)
class JointCommand:
    """Where the joints shall go until `end_us`.

    Raises:
        ValueError: a wrong length, a value that is not finite, or one out of its range; the message names the field.
    """

    position: np.ndarray
    """rad, (25,), at the reference time."""
    velocity: np.ndarray
    """rad/s, (25,); drives the damping term, and the position where it is extrapolated."""
    load: np.ndarray
    """Feed-forward torque, N·m, (25,)."""
    end_us: int
    """When the command stops being executed."""
    gains: JointGains | None = None
    """None for those of the last command that had some; the first of a run needs them."""
    reference_us: int | None = None
    """Where extrapolation starts; None for the time at which the command came in."""
    extrapolation_us: int | None = None
    """For how long the position is extrapolated, at most; None for not at all."""
    velocity_limit: float | None = None
    """A measured joint speed beyond this, rad/s, is a fault; None for no limit. Holds for this command only."""
    key: int = 0
    """Echoed in the state, to measure the loop; 0 is for none."""
    advice: tuple[Advice, ...] = field(default=(Advice.NONE,) * FEET)
    """Of each foot."""

    def __post_init__(self) -> None:
        for name in ("position", "velocity", "load"):
            _check_joints(name, getattr(self, name))
        if self.extrapolation_us is not None and self.extrapolation_us < 0:
            raise ValueError(f"extrapolation_us must be 0 or more, got {self.extrapolation_us}")
        limit = self.velocity_limit
        if limit is not None and not (math.isfinite(limit) and limit > 0.0):
            raise ValueError(f"velocity_limit must be a finite number above 0 rad/s, got {limit:g}")
        if not 0 <= self.key <= _LARGEST_KEY:
            raise ValueError(f"key must be from 0 to {_LARGEST_KEY}, got {self.key}")
        if len(self.advice) != FEET:
            raise ValueError(f"advice must be given for {FEET} feet or none, got {len(self.advice)}")


@dataclass(frozen=True)
class JointLimits:
    """What wanted positions and loads are held within."""

    low: np.ndarray
    """rad, (25,)."""
    high: np.ndarray
    """rad, (25,)."""
    load: Callable[[np.ndarray], np.ndarray]
    """Greatest load of each joint, N·m, (25,), at a pose (25,)."""


def _effort(position: np.ndarray) -> np.ndarray:
    return EFFORT


ASIMOV_LIMITS = JointLimits(RANGE[:, 0], RANGE[:, 1], _effort)
"""Asimov's ranges and efforts. They do not depend on the pose: both motors of an ankle have more to give than the
joint's effort at every angle. What speed takes from a motor is in `torque_limits`."""


def extrapolated_position(command: JointCommand, received_us: int, now_us: int) -> np.ndarray:
    """Wanted position at an instant before any limit, rad, (25,).

    `position + velocity * clamp(now - reference, 0, min(extrapolation, end - reference))`: it starts at the reference
    time, never runs backwards and ends with the command.
    """
    if command.extrapolation_us is None:
        return command.position
    reference = received_us if command.reference_us is None else command.reference_us
    longest = min(command.extrapolation_us, command.end_us - reference)
    return command.position + command.velocity * (1e-6 * max(0, min(now_us - reference, longest)))


def desired_target(
    command: JointCommand,
    gains: JointGains,
    received_us: int,
    now_us: int,
    measured: np.ndarray,
    limits: JointLimits = ASIMOV_LIMITS,
) -> JointTarget:
    """What a command asks of the one control law at an instant.

    Args:
        command: in force; whoever calls looks at its end.
        gains: its own, or those remembered.
        received_us: when it came in.
        now_us: the instant.
        measured: pose, rad, (25,), at which the load limits are taken.
        limits: wanted position and load are held within them.

    Returns:
        Target of one robot, arrays (1, 25): `torque = kp (position - q) + kd (velocity - q') + load`.
    """
    position = np.minimum(np.maximum(extrapolated_position(command, received_us, now_us), limits.low), limits.high)
    velocity = np.minimum(np.maximum(command.velocity, -VELOCITY_BOUND), VELOCITY_BOUND)
    greatest = limits.load(measured)
    load = np.minimum(np.maximum(command.load, -greatest), greatest)
    return JointTarget(position[None], velocity[None], load[None], gains.kp[None], gains.kd[None])


def contact_made(made: bool, touching: bool, advice: Advice) -> bool:
    """Whether a foot counts as in contact.

    Args:
        made: whether it did so far.
        touching: whether the ground bears on it now.
        advice: of the commander. On a made contact NOT_IN_CONTACT ends it and NONE lets it end with the force; on a
            lost one NONE and IN_CONTACT let a touch make it and NOT_IN_CONTACT does not.
    """
    if advice is Advice.NOT_IN_CONTACT:
        return False
    return touching or (made and advice is Advice.IN_CONTACT)


def _check_joints(name: str, values: np.ndarray) -> None:
    if values.shape != (len(JOINT_NAMES),):
        raise ValueError(f"{name} must hold {len(JOINT_NAMES)} values, one for each joint, got {values.size}")
    if not np.isfinite(values).all():
        joint = int(np.flatnonzero(~np.isfinite(values))[0])
        raise ValueError(f"{name} of {JOINT_NAMES[joint]} must be a finite number, got {values[joint]}")
