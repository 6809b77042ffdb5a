"""The weights of an actor or critic as plain arrays, to carry them between rsl-rl's and Brax's networks.

Both learners have the same layers, the same normaliser `(x - mean) / (std + NORMALISER_EPSILON)` and the same
logarithmic deviations of the exploration; they differ in names and in the orientation of the matrices only.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

NORMALISER_EPSILON = 1e-2
"""Added to the deviation of each entry of an observation, as rsl-rl's `EmpiricalNormalization` has it."""
VIEWS = {"actor": "state", "critic": "privileged_state"}
"""What each network sees, by its name in functional environments."""


@dataclass(frozen=True)
class NetworkWeights:
    """One network with its normaliser; float32."""

    layers: tuple[tuple[np.ndarray, np.ndarray], ...]
    """Matrix (outputs, inputs) and bias (outputs,) of each layer, from the observation on."""
    mean: np.ndarray
    """Of each entry of the observation, (width,)."""
    variance: np.ndarray
    """(width,)."""
    samples: int
    """How many observations the normaliser has seen."""
    log_std: np.ndarray | None = None
    """Logarithmic deviation of each action, (23,); None for a critic."""

    @classmethod
    def from_torch(cls, state: Mapping[str, torch.Tensor]) -> NetworkWeights:
        """From the state of a model of rsl-rl."""
        places = sorted(
            int(name.split(".")[1]) for name in state if name.startswith("mlp.") and name.endswith("weight")
        )
        layers = tuple((_array(state[f"mlp.{i}.weight"]), _array(state[f"mlp.{i}.bias"])) for i in places)
        log_std = state.get("distribution.log_std_param")
        return cls(
            layers,
            _array(state["obs_normalizer._mean"])[0],
            _array(state["obs_normalizer._var"])[0],
            int(state["obs_normalizer.count"]),
            None if log_std is None else _array(log_std),
        )

    def to_torch(self) -> dict[str, torch.Tensor]:
        """The state of a model of rsl-rl, with ELU layers between the linear ones."""
        state = {
            "obs_normalizer._mean": torch.tensor(self.mean[None]),
            "obs_normalizer._var": torch.tensor(self.variance[None]),
            "obs_normalizer._std": torch.tensor(np.sqrt(self.variance)[None]),
            "obs_normalizer.count": torch.tensor(self.samples, dtype=torch.long),
        }
        for place, (matrix, bias) in enumerate(self.layers):
            state |= {f"mlp.{2 * place}.weight": torch.tensor(matrix), f"mlp.{2 * place}.bias": torch.tensor(bias)}
        if self.log_std is not None:
            state["distribution.log_std_param"] = torch.tensor(self.log_std)
        return state

    @classmethod
    def from_brax(cls, learned: Mapping[str, Any], name: str) -> NetworkWeights:
        """From what Brax has learned (see `train.brax_ppo`).

        Args:
            learned: the learner's part of a checkpoint.
            name: `actor` or `critic`.
        """
        arrays, view = learned["networks"], VIEWS[name]
        kernels = sorted((k for k in arrays if k.startswith(f"{name}.") and k.endswith("kernel")), key=_place)
        layers = tuple((np.ascontiguousarray(arrays[k].T), arrays[k.removesuffix("kernel") + "bias"]) for k in kernels)
        return cls(
            layers,
            arrays[f"normaliser.mean.{view}"],
            arrays[f"normaliser.variance.{view}"],
            (int(arrays["normaliser.samples.hi"]) << 32) + int(arrays["normaliser.samples.lo"]),
            arrays.get(f"{name}.log_std"),
        )

    def to_brax(self, name: str) -> dict[str, np.ndarray]:
        """Entries of `networks` in the Brax learner's part of a checkpoint."""
        view = VIEWS[name]
        arrays = {
            f"normaliser.mean.{view}": self.mean,
            f"normaliser.variance.{view}": self.variance,
            f"normaliser.std.{view}": np.sqrt(self.variance),
            "normaliser.samples.hi": np.asarray(self.samples >> 32),
            "normaliser.samples.lo": np.asarray(self.samples & 0xFFFFFFFF),
        }
        for place, (matrix, bias) in enumerate(self.layers):
            arrays |= {f"{name}.hidden_{place}.kernel": matrix.T, f"{name}.hidden_{place}.bias": bias}
        if self.log_std is not None:
            arrays[f"{name}.log_std"] = self.log_std
        return arrays


def with_exploration(learned: Mapping[str, Any], bounds: tuple[float, float] | None) -> dict[str, Any]:
    """The learner's part of a checkpoint of either library, the deviations of its actions within these bounds."""
    if bounds is None:
        return dict(learned)
    low, high = (float(np.log(bound)) for bound in bounds)
    if "actor_state_dict" in learned:
        name = "distribution.log_std_param"
        actor = {**learned["actor_state_dict"], name: learned["actor_state_dict"][name].clamp(low, high)}
        return {**learned, "actor_state_dict": actor}
    networks = learned["networks"]
    bounded = np.clip(networks["actor.log_std"], np.float32(low), np.float32(high))
    return {**learned, "networks": {**networks, "actor.log_std": bounded}}


def _array(tensor: torch.Tensor) -> np.ndarray:
    return tensor.detach().cpu().numpy().copy()


def _place(name: str) -> int:
    """Number of a layer, from a name such as `actor.hidden_2.kernel`."""
    return int(name.split("_")[1].split(".")[0])
