"""Reward terms of the walking task: plain functions of what happened in a step, each (N,) and without its weight.

Velocities are in the heading frame. `Motion` gathers the quantities that several terms need.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from asimov_gym.physics import Reading
from asimov_gym.robot.array_library import namespace
from asimov_gym.robot.feet import STANCE
from asimov_gym.robot.joints import EFFORT, JOINT_NAMES, POLICY_TO_JOINT, RANGE, STAND_POSITION, VELOCITY_LIMIT

CONTACT_FORCE = 5.0
"""A foot carries when the ground pushes it up with more than this, N."""

_PENDULUM_S = 0.25
"""Time constant of an inverted pendulum as high as the pelvis, sqrt(0.61 m / g), s."""

# How far a joint may stray before the pose term costs a unit, rad: generous where walking needs it.
_SPREAD = {"hip_pitch": 0.5, "knee": 0.5, "ankle_pitch": 0.3}
_ARM_SPREAD = {"shoulder_pitch": 0.2, "elbow": 0.2}


def _spread(joint: str) -> float:
    name = joint.removesuffix("_joint").removeprefix("left_").removeprefix("right_")
    if name in _SPREAD:
        return _SPREAD[name]
    if name in _ARM_SPREAD:
        return _ARM_SPREAD[name]
    return 0.1 if name.startswith(("shoulder", "wrist")) else 0.15


_SPREADS = np.full(len(JOINT_NAMES), np.inf)  # a joint that is held does not count
_SPREADS[POLICY_TO_JOINT] = [_spread(JOINT_NAMES[i]) for i in POLICY_TO_JOINT]
_MIDDLE, _HALF = RANGE.mean(axis=1), 0.5 * (RANGE[:, 1] - RANGE[:, 0])


@dataclass(frozen=True)
class Motion:
    """What a step did, for N copies."""

    reading: Reading
    velocity: Any
    """Pelvis velocity, heading frame, (N, 3)."""
    yaw_rate: Any
    """(N,)."""
    mean_velocity: Any
    """Running mean of vx, vy and yaw rate, (N, 3)."""
    foot_offset: Any
    """Feet relative to the pelvis, heading frame, (N, 2, 3)."""
    foot_height: Any
    """Height of the soles above the ground, (N, 2)."""
    contact: Any
    """(N, 2), 1 where the foot carries."""
    command: Any
    """(N, 3)."""
    moving: Any
    """(N,), 1 where the command asks to walk."""
    resting: Any
    """(N,), 1 where it asks to stand and nothing has thrown the robot off: the terms for standing hold then."""
    swing: Any
    """Sine of each foot's phase while moving, 0 at rest, (N, 2); positive while it should swing."""
    action: Any
    """This step's action and the two before, (N, 3, 23), newest first."""
    step_height: float


def track_velocity(m: Motion) -> Any:
    """Follow the commanded planar velocity."""
    xp = namespace(m.velocity)
    error = m.velocity[:, 0:2] - m.command[:, 0:2]
    return xp.exp(-squares(error) / 0.25)


def track_yaw_rate(m: Motion) -> Any:
    """Follow the commanded turning rate."""
    xp = namespace(m.velocity)
    error = m.yaw_rate - m.command[:, 2]
    return xp.exp(-error * error / 0.25)


def track_velocity_closely(m: Motion) -> Any:
    """Follow the commanded planar velocity at every moment, sharply: no sway within a step."""
    error = m.velocity[:, 0:2] - m.command[:, 0:2]
    return 1.0 / (1.0 + squares(error) / 0.02)  # half of it at 14 cm/s; falls slowly, to lead from afar


def track_yaw_rate_closely(m: Motion) -> Any:
    """Follow the commanded turning rate at every moment, sharply: no twist within a step."""
    error = m.yaw_rate - m.command[:, 2]
    return 1.0 / (1.0 + error * error / 0.06)  # half of it at 0.24 rad/s


def track_mean_velocity(m: Motion) -> Any:
    """Follow the commanded planar velocity on average over a gait cycle, sharply."""
    xp = namespace(m.velocity)
    error = m.mean_velocity[:, 0:2] - m.command[:, 0:2]
    return xp.exp(-squares(error) / 0.02)


def track_mean_yaw_rate(m: Motion) -> Any:
    """Follow the commanded turning rate on average over a gait cycle, sharply."""
    xp = namespace(m.velocity)
    error = m.mean_velocity[:, 2] - m.command[:, 2]
    return xp.exp(-error * error / 0.04)


# The other tracking terms are flat where little is left to gain, and there a bit of slowness buys comfort.
def track_mean_velocity_exactly(m: Motion) -> Any:
    """Follow the commanded planar velocity on average over a gait cycle, with a peak instead of a plateau."""
    xp = namespace(m.velocity)
    error = m.mean_velocity[:, 0:2] - m.command[:, 0:2]
    return xp.exp(-xp.sqrt(squares(error)) / 0.1)


def track_mean_yaw_rate_exactly(m: Motion) -> Any:
    """Follow the commanded turning rate on average over a gait cycle, with a peak instead of a plateau."""
    xp = namespace(m.velocity)
    error = m.mean_velocity[:, 2] - m.command[:, 2]
    return xp.exp(-xp.abs(error) / 0.2)


def capture(m: Motion) -> Any:
    """Bring the feet under where the pelvis is thrown: the point at which a walker must step to come to rest again
    (Pratt et al. 2006, Humanoids), as seen from the commanded velocity, should lie between them."""
    middle = 0.5 * (m.foot_offset[:, 0, 0:2] + m.foot_offset[:, 1, 0:2])
    point = (m.velocity[:, 0:2] - m.command[:, 0:2]) * _PENDULUM_S
    return 1.0 / (1.0 + squares(point - middle) / 0.0225)  # half of it at 15 cm; falls slowly, to lead from afar


def alive(m: Motion) -> Any:
    """One for every step not fallen."""
    return namespace(m.velocity).ones_like(m.yaw_rate)


def foot_height(m: Motion) -> Any:
    """Lift each foot by its clock; keep both on the ground at rest."""
    xp = namespace(m.velocity)
    error = m.foot_height - m.step_height * xp.clip(m.swing, 0.0, 1.0)
    return xp.exp(-squares(error) * (m.moving + m.resting) / 0.003)


def foot_contact(m: Motion) -> Any:
    """Share of the feet whose contact agrees with the clock; at rest both should carry."""
    xp = namespace(m.velocity)
    wanted = xp.astype(m.swing <= 0.0, m.velocity.dtype)
    return 1.0 - xp.mean(xp.abs(m.contact - wanted), axis=-1) * (m.moving + m.resting)


def tilt(m: Motion) -> Any:
    """Squared sine of the pelvis' tilt."""
    return squares(m.reading.gravity[:, 0:2])


def pose(m: Motion) -> Any:
    """Distance from the standing pose, each joint against its spread; less at rest."""
    return _stray(m) * (0.3 + 0.7 * m.moving)


def rest_pose(m: Motion) -> Any:
    """Distance from the standing pose while asked to stand."""
    return _stray(m) * m.resting


def _stray(m: Motion) -> Any:
    """Mean squared distance of the policy's joints from the standing pose, in units of their spreads."""
    xp = namespace(m.velocity)
    q = m.reading.joint_position
    stray = (q - xp.asarray(STAND_POSITION, dtype=q.dtype)) / xp.asarray(_SPREADS, dtype=q.dtype)
    return xp.sum(stray * stray, axis=-1) / len(POLICY_TO_JOINT)


def squares(vector: Any) -> Any:
    """Sum of squares over a short last axis. NumPy adds columns five times as fast as it sums along so few entries."""
    total = vector[..., 0] ** 2
    for i in range(1, vector.shape[-1]):
        total = total + vector[..., i] ** 2
    return total


def tilt_rate(m: Motion) -> Any:
    """Squared roll and pitch rate."""
    return squares(m.reading.gyro[:, 0:2])


def vertical_speed(m: Motion) -> Any:
    """Squared vertical velocity of the pelvis."""
    return m.velocity[:, 2] ** 2


def action_rate(m: Motion) -> Any:
    """Squared change of the action."""
    xp = namespace(m.velocity)
    return xp.sum((m.action[:, 0] - m.action[:, 1]) ** 2, axis=-1)


def action_jerk(m: Motion) -> Any:
    """Squared second difference of the action."""
    xp = namespace(m.velocity)
    return xp.sum((m.action[:, 0] - 2.0 * m.action[:, 1] + m.action[:, 2]) ** 2, axis=-1)


def slip(m: Motion) -> Any:
    """Squared horizontal speed of carrying feet."""
    speed = squares(m.reading.foot_velocity[:, :, 0:2]) * m.contact
    return speed[:, 0] + speed[:, 1]


def flat_foot(m: Motion) -> Any:
    """Squared tilt of the soles."""
    lean = squares(m.reading.foot_up[:, :, 0:2])
    return lean[:, 0] + lean[:, 1]


def joint_limit(m: Motion) -> Any:
    """How far joints reach beyond 90 % of their range, rad, summed."""
    xp = namespace(m.velocity)
    q = m.reading.joint_position
    reach = xp.abs(q - xp.asarray(_MIDDLE, dtype=q.dtype)) - xp.asarray(0.9 * _HALF, dtype=q.dtype)
    return xp.sum(xp.clip(reach, 0.0, None), axis=-1)


def joint_speed(m: Motion) -> Any:
    """How far joints are beyond 80 % of their speed limit, as a share of it, summed."""
    xp = namespace(m.velocity)
    v = m.reading.joint_velocity
    share = xp.abs(v) / xp.asarray(VELOCITY_LIMIT, dtype=v.dtype)
    return xp.sum(xp.clip(share - 0.8, 0.0, None), axis=-1)


def feet_apart(m: Motion) -> Any:
    """How much closer than 0.16 m the feet are to each other sideways, in units of 5 cm."""
    xp = namespace(m.velocity)
    gap = m.foot_offset[:, 0, 1] - m.foot_offset[:, 1, 1]
    return xp.clip(0.16 - gap, 0.0, 0.3) / 0.05


def rest_stance(m: Motion) -> Any:
    """How far each foot is from where STAND would have it under the pelvis while asked to stand: squares, in units of
    5 cm, summed. STAND does not balance: it topples a robot that rests in another stance."""
    xp = namespace(m.velocity)
    away = m.foot_offset[:, :, 0:2] - xp.asarray(STANCE, dtype=m.foot_offset.dtype)
    square = squares(away) / 0.0025
    return xp.clip(square[:, 0] + square[:, 1], 0.0, 16.0) * m.resting


def rest(m: Motion) -> Any:
    """Mean squared joint speed while asked to stand."""
    xp = namespace(m.velocity)
    return xp.mean(m.reading.joint_velocity**2, axis=-1) * m.resting


def rest_drift(m: Motion) -> Any:
    """Horizontal speed of the pelvis while asked to stand: over time, the way it drifts."""
    xp = namespace(m.velocity)
    speed = xp.sqrt(xp.sum(m.velocity[:, 0:2] ** 2, axis=-1))
    return speed * m.resting


def effort(m: Motion) -> Any:
    """Mean squared torque as a share of the joint's limit."""
    xp = namespace(m.velocity)
    share = m.reading.joint_torque / xp.asarray(EFFORT, dtype=m.reading.joint_torque.dtype)
    return xp.mean(share * share, axis=-1)


TERMS: Mapping[str, Callable[[Motion], Any]] = MappingProxyType(
    {
        term.__name__: term
        for term in (
            track_velocity,
            track_yaw_rate,
            track_velocity_closely,
            track_yaw_rate_closely,
            track_mean_velocity,
            track_mean_yaw_rate,
            track_mean_velocity_exactly,
            track_mean_yaw_rate_exactly,
            capture,
            alive,
            foot_height,
            foot_contact,
            tilt,
            pose,
            rest_pose,
            tilt_rate,
            vertical_speed,
            action_rate,
            action_jerk,
            slip,
            flat_foot,
            joint_limit,
            joint_speed,
            feet_apart,
            rest_stance,
            rest,
            rest_drift,
            effort,
        )
    }
)
"""All terms by name."""


def total(m: Motion, weights: Mapping[str, float], penalty_level: Any, dt: float) -> tuple[Any, dict[str, Any]]:
    """Reward of a step, (N,), and each term's weighted share of it per second, (N,) each.

    The sum is floored at zero, so that a hard-pressed robot never gains by falling early.
    """
    xp = namespace(m.velocity)
    shares = {}
    for name, weight in weights.items():
        scale = weight * penalty_level if weight < 0.0 else weight
        shares[name] = TERMS[name](m) * scale
    return xp.clip(sum(shares.values()), 0.0, None) * dt, shares
