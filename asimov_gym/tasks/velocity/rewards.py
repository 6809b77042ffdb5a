"""Reward terms of the waypoint task: plain functions of what happened in a step, each (N,) and without its weight."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from asimov_gym.robot.array_library import namespace


@dataclass(frozen=True)
class Advance:
    """What a step did, for N copies."""

    before: Any
    """Distance to the waypoint aimed at, at the start of the step, m, (N,)."""
    after: Any
    """Distance to the same waypoint at its end, m, (N,)."""
    reached: Any
    """Whether it was reached, (N,) bool."""
    fallen: Any
    """(N,) bool."""
    command: Any
    """This step's command and the one before, (N, 2, 3)."""


def progress(a: Advance) -> Any:
    """How much closer the waypoint has come, m."""
    return a.before - a.after


def reached(a: Advance) -> Any:
    """One for a waypoint reached."""
    return namespace(a.before).astype(a.reached, a.before.dtype)


def fall(a: Advance) -> Any:
    """One for a fall, which ends the episode."""
    return namespace(a.before).astype(a.fallen, a.before.dtype)


def time(a: Advance) -> Any:
    """One for every step."""
    return namespace(a.before).ones_like(a.before)


def command_rate(a: Advance) -> Any:
    """Squared change of the command."""
    xp = namespace(a.before)
    return xp.sum((a.command[:, 0] - a.command[:, 1]) ** 2, axis=-1)


TERMS: Mapping[str, Callable[[Advance], Any]] = MappingProxyType(
    {term.__name__: term for term in (progress, reached, fall, time, command_rate)}
)
"""All terms by name."""


def total(a: Advance, weights: Mapping[str, float]) -> tuple[Any, dict[str, Any]]:
    """Reward of a step, (N,), and each term's weighted share of it, (N,) each."""
    shares = {name: TERMS[name](a) * weight for name, weight in weights.items()}
    return sum(shares.values(), namespace(a.before).zeros_like(a.before)), shares
