"""Random numbers for a batch of robots: one stream for each copy."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


class CopyStreams:
    """N independent streams of uniform numbers.

    What a copy draws depends on its own seed and its own history only. So copy i of a batch does exactly what a batch
    of one does with the same seed, whatever its neighbours do.

    Args:
        seeds: a seed for each copy, not negative.
    """

    def __init__(self, seeds: Sequence[int]) -> None:
        self._generators = [np.random.default_rng(seed) for seed in seeds]

    def draw(self, width: int, which: np.ndarray | None = None) -> np.ndarray:
        """Uniform numbers in [0, 1), float32.

        Args:
            width: how many for each copy.
            which: mask of the copies that draw, (N,) bool; all when None.

        Returns:
            (n, width): a row for each copy that draws.
        """
        chosen = self._generators if which is None else [self._generators[i] for i in np.flatnonzero(which)]
        rows = [generator.random(width, dtype=np.float32) for generator in chosen]
        return np.stack(rows) if rows else np.empty((0, width), dtype=np.float32)
