"""Random numbers for a batch of robots: one stream for each copy."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

AHEAD = 2048
"""Numbers that a stream draws at once: asking a generator for a thousand costs little more than asking for six."""


class CopyStreams:
    """N independent streams of uniform numbers.

    What a copy draws depends on its own seed and its own history only. So copy i of a batch does exactly what a batch
    of one does with the same seed, whatever its neighbours do.

    Args:
        seeds: a seed for each copy, not negative.
    """

    def __init__(self, seeds: Sequence[int]) -> None:
        self._generators = [np.random.default_rng(seed) for seed in seeds]
        self._drawn = np.empty((len(self._generators), AHEAD), dtype=np.float32)
        self._next = np.full(len(self._generators), AHEAD)
        """Place of each copy's next number in its row of `_drawn`."""

    def draw(self, width: int, copies: np.ndarray | None = None) -> np.ndarray:
        """Uniform numbers in [0, 1), float32.

        Args:
            width: how many for each copy, at most `AHEAD`.
            copies: indices of the copies that draw; all when None.

        Returns:
            (n, width): a row for each copy that draws.

        Raises:
            ValueError: too many at once.
        """
        if width > AHEAD:
            raise ValueError(f"width must be at most {AHEAD}, got {width}")
        copies = np.arange(len(self._generators)) if copies is None else copies
        for copy in copies[self._next[copies] + width > AHEAD]:
            self._refill(copy)
        first = self._next[copies]
        self._next[copies] += width
        return sliding_window_view(self._drawn, width, axis=1)[copies, first]

    def _refill(self, copy: int) -> None:
        row, used = self._drawn[copy], self._next[copy]
        row[: AHEAD - used] = row[used:]
        self._generators[copy].random(out=row[AHEAD - used :], dtype=np.float32)
        self._next[copy] = 0
