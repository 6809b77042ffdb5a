"""How sure a figure is: intervals of shares and means, and tests of paired outcomes. All random draws are seeded."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

Z_95 = 1.959964
"""Half width of the central 95 % of the standard normal distribution."""
DRAWS = 2000
"""Resamples of a bootstrap."""
SEED = 20_250


@dataclass(frozen=True)
class Share:
    """So many of so many."""

    passed: int
    whole: int

    @property
    def value(self) -> float | None:
        """The share; None of nothing."""
        return self.passed / self.whole if self.whole else None

    @property
    def interval(self) -> tuple[float, float]:
        """Its 95 % interval by Wilson's formula, which is sound for shares near 0 and 1 and for few trials."""
        return wilson(self.passed, self.whole)


@dataclass(frozen=True)
class Mean:
    """Mean of a figure with its 95 % interval."""

    value: float
    low: float | None
    """None where every scenario has one trial alone: nothing says how much another would differ."""
    high: float | None
    count: int
    """Trials that have the figure."""


def wilson(passed: int, whole: int) -> tuple[float, float]:
    """95 % interval of a share (E. B. Wilson, 1927); (0, 1) of nothing.

    Raises:
        ValueError: `passed` is not within 0 and `whole`.
    """
    if not 0 <= passed <= whole:
        raise ValueError(f"passed must be within 0 and whole = {whole}, got {passed}")
    if whole == 0:
        return 0.0, 1.0
    share, spread = passed / whole, Z_95 * Z_95 / whole
    middle = (share + spread / 2.0) / (1.0 + spread)
    half = Z_95 * math.sqrt(share * (1.0 - share) / whole + spread / (4.0 * whole)) / (1.0 + spread)
    return (0.0 if passed == 0 else middle - half), (1.0 if passed == whole else middle + half)


def bootstrap_mean(groups: Sequence[Sequence[float]], seed: int = SEED, draws: int = DRAWS) -> Mean | None:
    """Mean of all values, and its 95 % percentile interval from resampling within each group.

    A group is one scenario's repeats: what is random is the seed, the list of scenarios is not.

    Args:
        groups: values of each scenario.
        seed: of the resampling.
        draws: resamples.

    Returns:
        The mean; None without values.
    """
    arrays = [np.asarray(group, dtype=np.float64) for group in groups if len(group)]
    count = sum(map(len, arrays))
    if not count:
        return None
    value = sum(float(array.sum()) for array in arrays) / count
    if all(len(array) == 1 for array in arrays):
        return Mean(value, None, None, count)
    rng = np.random.default_rng(seed)
    total = np.zeros(draws)
    for array in arrays:
        total += array[rng.integers(len(array), size=(draws, len(array)))].sum(axis=1)
    low, high = np.percentile(total / count, [2.5, 97.5])
    return Mean(value, float(low), float(high), count)


def mcnemar(only_first: int, only_second: int) -> float:
    """Exact two-sided p-value that paired yes-or-no outcomes differ by chance (McNemar, binomial form).

    Args:
        only_first: pairs of which only the first passed.
        only_second: pairs of which only the second passed.
    """
    n, least = only_first + only_second, min(only_first, only_second)
    tail = sum(math.comb(n, k) for k in range(least + 1))
    return min(1.0, 2 * tail / 2**n)
