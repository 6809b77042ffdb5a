"""The mean of an actor's weights over the last rounds: what a run exports where it is asked for.

Each round moves the weights by what its own samples happened to say. The mean over many rounds (Polyak and Juditsky
1992, SIAM J. Control Optim. 30) has learned the same with less of that chance in it. Learning itself goes on with the
weights as they are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from train.weights import NetworkWeights


class WeightAverage:
    """Exponentially weighted mean over about so many rounds; over all rounds while there are fewer.

    Args:
        rounds: at least 1, which keeps the last round alone.
    """

    def __init__(self, rounds: int) -> None:
        self.rounds = rounds
        self.weights: NetworkWeights | None = None
        self._seen = 0

    def add(self, weights: NetworkWeights) -> None:
        """Take in the weights after another round."""
        self._seen += 1
        share = 1.0 / min(self._seen, self.rounds)
        self.weights = weights if self.weights is None else _between(self.weights, weights, share)

    def snapshot(self) -> dict[str, Any] | None:
        """Everything needed to go on, as plain data; None where nothing was taken in."""
        return None if self.weights is None else {"seen": self._seen, "weights": dict(vars(self.weights))}

    def restore(self, snapshot: Mapping[str, Any] | None) -> None:
        """Go on from a snapshot."""
        self._seen = 0 if snapshot is None else snapshot["seen"]
        self.weights = averaged(snapshot)


def averaged(snapshot: Mapping[str, Any] | None) -> NetworkWeights | None:
    """The mean in a snapshot; None where there is none."""
    return None if snapshot is None else NetworkWeights(**snapshot["weights"])


def mean_of(actors: Sequence[NetworkWeights]) -> NetworkWeights:
    """The plain mean of one actor or several; the normaliser has seen as much as the last one's."""
    average = WeightAverage(len(actors))
    for weights in actors:
        average.add(weights)
    assert average.weights is not None
    return average.weights


def _between(old: NetworkWeights, new: NetworkWeights, share: float) -> NetworkWeights:
    """A mean of both with this share of the new one; counts are the new one's."""

    def mixed(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return a + np.asarray(share, dtype=a.dtype) * (b - a)

    layers = zip(old.layers, new.layers, strict=True)
    assert (old.log_std is None) == (new.log_std is None)
    return NetworkWeights(
        layers=tuple((mixed(a, b), mixed(c, d)) for (a, c), (b, d) in layers),
        mean=mixed(old.mean, new.mean),
        variance=mixed(old.variance, new.variance),
        samples=new.samples,
        log_std=None if old.log_std is None or new.log_std is None else mixed(old.log_std, new.log_std),
    )
