"""How uniform random numbers become the figures of the walking task."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from asimov_gym.physics import DECIMATION, TIMESTEP
from asimov_gym.robot.array_library import integer, namespace

DT = TIMESTEP * DECIMATION
"""Policy step, s."""


def between(draw: Any, interval: tuple[float, float]) -> Any:
    """Numbers in an interval from draws in [0, 1)."""
    return interval[0] + (interval[1] - interval[0]) * draw


def corners(draws: Any, intervals: Sequence[tuple[float, float]]) -> Any:
    """The least, nothing or the largest of each of K intervals around zero, with the same chance, from draws (N, K)."""
    xp = namespace(draws)
    low, high = (xp.asarray([interval[end] for interval in intervals], dtype=draws.dtype) for end in (0, 1))
    third = xp.floor(3.0 * draws)
    return xp.where(third == 1.0, xp.zeros_like(draws), xp.where(third > 1.0, high, low))


def steps_between(draw: Any, seconds: tuple[float, float]) -> Any:
    """Whole policy steps from draws in [0, 1), for a time in an interval of seconds."""
    xp = namespace(draw)
    return xp.astype(xp.round(between(draw, seconds) / DT), integer(xp))
