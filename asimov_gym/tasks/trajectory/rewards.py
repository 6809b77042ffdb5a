"""Reward terms of the trajectory task: plain functions of what happened in a step, each (N,) and without its weight."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from asimov_gym.physics import Reading
from asimov_gym.robot.array_library import namespace
from asimov_gym.robot.joints import EFFORT


@dataclass(frozen=True)
class Tracking:
    """What a step did, for N copies. Joint order."""

    reading: Reading
    reference: Any
    """Where the motion is at the end of the step, rad, (N, 25)."""
    reference_velocity: Any
    """rad/s, (N, 25)."""
    target: Any
    """This step's joint targets and the last one's, rad, (N, 2, 25)."""


def track_position(t: Tracking) -> Any:
    """Be where the motion is; half lost at a root mean square error of 0.08 rad."""
    xp = namespace(t.reference)
    error = t.reading.joint_position - t.reference
    return xp.exp(-xp.mean(error * error, axis=-1) / 0.01)


def track_velocity(t: Tracking) -> Any:
    """Move as the motion does; half lost at a root mean square error of 0.8 rad/s."""
    xp = namespace(t.reference)
    error = t.reading.joint_velocity - t.reference_velocity
    return xp.exp(-xp.mean(error * error, axis=-1))


def upright(t: Tracking) -> Any:
    """Keep the pelvis from tipping over; half lost at a tilt of 50 degrees sideways or forward."""
    xp = namespace(t.reference)
    return xp.exp(-xp.sum(t.reading.gravity[:, 0:2] ** 2, axis=-1) / 0.85)


def alive(t: Tracking) -> Any:
    """One for every step not fallen."""
    return namespace(t.reference).ones_like(t.reference[:, 0])


def target_rate(t: Tracking) -> Any:
    """Squared change of the targets from step to step, rad², summed."""
    xp = namespace(t.reference)
    return xp.sum((t.target[:, 0] - t.target[:, 1]) ** 2, axis=-1)


def effort(t: Tracking) -> Any:
    """Mean squared torque, each joint against its limit."""
    xp = namespace(t.reference)
    load = t.reading.joint_torque / xp.asarray(EFFORT, dtype=t.reading.joint_torque.dtype)
    return xp.mean(load * load, axis=-1)


TERMS: Mapping[str, Callable[[Tracking], Any]] = MappingProxyType(
    {term.__name__: term for term in (track_position, track_velocity, upright, alive, target_rate, effort)}
)
"""All terms by name."""


def total(t: Tracking, weights: Mapping[str, float], dt: float) -> tuple[Any, dict[str, Any]]:
    """Reward of a step, (N,), and each term's weighted share of it per second, (N,) each.

    The sum is floored at zero, so that a hard-pressed robot never gains by falling early.
    """
    xp = namespace(t.reference)
    shares = {name: TERMS[name](t) * weight for name, weight in weights.items()}
    return xp.clip(sum(shares.values(), xp.zeros_like(t.reference[:, 0])), 0.0, None) * dt, shares
