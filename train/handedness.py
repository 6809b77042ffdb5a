"""A hand for robots that stand: what lets networks that are symmetric by construction break a tie.

A symmetric network in a symmetric stance, pushed straight ahead, can only hop with both feet: whatever speaks for a
step with the left foot speaks as much for the right one. While it walks, the gait clock breaks the tie; at rest the
clock shows (0, 0), which is its own mirror image. `handed` puts a constant there instead, whose mirror image is its
negative, inside the network: file, contract and observation stay as they are. Walking is as symmetric as before.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from asimov_gym.robot.observation import observation_layout

HAND = 0.5
"""What stands for the clock's cosine at rest. At 1 it would be the clock of a robot about to lift its left foot."""

_CLOCK = observation_layout("asimov-80").slices["clock"].start
"""The clock's place, in what actors see and in what critics see."""


def hand(width: int) -> np.ndarray:
    """What an observation of this width gets at rest, (width,), float32. The mirror negates it."""
    entries = np.zeros(width, dtype=np.float32)
    entries[_CLOCK] = HAND
    return entries


def handed(rows: Any, entries: Any) -> Any:
    """Observations (..., width) with a hand where the clock rests.

    Args:
        rows: of torch or JAX.
        entries: `hand(width)` as an array of that library.
    """
    cosine, sine = rows[..., _CLOCK : _CLOCK + 1], rows[..., _CLOCK + 1 : _CLOCK + 2]
    rest = 1.0 - cosine * cosine - sine * sine  # 1 at rest, 0 while the clock runs
    return rows + rest * entries
