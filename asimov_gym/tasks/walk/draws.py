"""How uniform random numbers become the figures of the walking task."""

from __future__ import annotations

from typing import Any

from asimov_gym.physics import DECIMATION, TIMESTEP
from asimov_gym.robot.array_library import integer, namespace

DT = TIMESTEP * DECIMATION
"""Policy step, s."""


def between(draw: Any, interval: tuple[float, float]) -> Any:
    """Numbers in an interval from draws in [0, 1)."""
    return interval[0] + (interval[1] - interval[0]) * draw


def steps_between(draw: Any, seconds: tuple[float, float]) -> Any:
    """Whole policy steps from draws in [0, 1), for a time in an interval of seconds."""
    xp = namespace(draw)
    return xp.astype(xp.round(between(draw, seconds) / DT), integer(xp))
