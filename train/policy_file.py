"""A policy file as the start of a run: its actor, and how it was made. The critic stayed where it was trained."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch

from asimov_gym.policy import load_policy
from asimov_gym.policy.network import PolicyNetwork, read_network
from asimov_gym.policy.runner import PolicyFileError, PolicyRunner
from asimov_gym.robot.observation import observation_layout
from train.calibration import CALIBRATION_LAYERS
from train.config import PpoConfig
from train.export import realistic_observations
from train.learner import load_actor
from train.weights import NORMALISER_EPSILON, NetworkWeights

_TOLERANCE = 1e-4
"""Largest difference between the file and the actor made of its weights, as a share of outputs beyond one."""


class PolicyFile:
    """A policy file that a run begins with.

    Args:
        path: an ONNX file that `python -m train` exported.

    Raises:
        FileNotFoundError: there is no such file.
        PolicyFileError: it is not a policy.
        ContractError: the robot cannot honour its contract.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._runner: PolicyRunner = load_policy(path)

    @cached_property
    def _network(self) -> PolicyNetwork:
        return read_network(self.path)

    def history(self) -> list[dict[str, Any]]:
        """Presets, commits and progress that led to it, oldest first; empty where the file does not say."""
        made = dict(self._runner.contract.training or {})
        if not {"preset", "samples", "seconds"} <= set(made):
            return []
        before = made.pop("after", None) or []
        return [*before, {"preset": made.pop("preset"), "commit": self._runner.contract.trained_commit, **made}]

    def actor(self, config: PpoConfig) -> NetworkWeights:
        """Its actor, for a run with these settings.

        Its command calibration, where it has one, stays behind: another actor needs another one.

        How widely it explored is not in the file: it is `learner.initial_std`, within `learner.warm_std`. Its
        normaliser has seen as much as the history says, so that it hardly moves any more.

        Raises:
            PolicyFileError: the settings are of another kind of network or of another task, named; or the file is not
                one of ours.
        """
        contract, walk = self._runner.contract, config.walk
        wanted: dict[str, tuple[object, object]] = {
            "walk.layout": (contract.observation.layout, walk.layout),
            "walk.action_scale": (set(contract.action_scale), {walk.action_scale}),
        }
        for name, (there, here) in wanted.items():
            if there != here:
                raise PolicyFileError(f"{self.path}: {name} is {there} there and {here} in the settings of the run")
        weights = self._weights(config)
        widths = tuple(len(bias) for _, bias in weights.layers[:-1])
        if widths != tuple(config.learner.hidden):
            raise PolicyFileError(
                f"{self.path}: the hidden layers are {widths} there, and learner.hidden is {config.learner.hidden}"
            )
        layout = observation_layout(walk.layout)
        actor = load_actor(config.learner, layout, weights.to_torch())
        observations = realistic_observations(contract, 200, 0)
        # At rest, where no calibration changes anything.
        for name in ("command", "clock"):
            observations[:, layout.slices.get(name, slice(0))] = 0.0
        with torch.inference_mode():
            answered = actor.as_onnx(verbose=False)(torch.from_numpy(observations)).numpy()
        expected = self._runner.infer(observations)
        if not np.all(np.abs(answered - expected) <= _TOLERANCE * np.maximum(1.0, np.abs(expected))):
            raise PolicyFileError(
                f"{self.path}: a network with learner.symmetry {config.learner.symmetry} answers otherwise than the "
                "file: it was trained with another symmetry, or not here"
            )
        return weights

    def _weights(self, config: PpoConfig) -> NetworkWeights:
        constants, nodes = self._network.constants, self._network.graph
        layers: list[tuple[np.ndarray, np.ndarray]] = []
        mean = scale = None
        for node in nodes:
            if any(CALIBRATION_LAYERS in name for name in node.input):
                continue
            known = [constants[name] for name in node.input if name in constants]
            if node.op_type == "Gemm" and len(known) == 2:
                straight = any(a.name == "transB" and a.i for a in node.attribute)
                layers.append((known[0] if straight else known[0].T, known[1]))
            elif not layers and node.op_type in ("Sub", "Div") and known and known[0].ndim == 2:
                # The normaliser, (x - mean) / scale; other constants before the first layer are not rows.
                mean, scale = (known[0], scale) if node.op_type == "Sub" else (mean, known[0])
        if not layers or mean is None or scale is None:
            raise PolicyFileError(f"{self.path}: its network is not a normaliser and layers, as those trained here are")
        log_std = np.full(len(layers[-1][1]), np.log(config.learner.initial_std), dtype=np.float32)
        if config.learner.warm_std is not None:
            low, high = np.log(np.asarray(config.learner.warm_std, dtype=np.float32))
            log_std = log_std.clip(low, high)
        return NetworkWeights(
            layers=tuple((np.ascontiguousarray(a), np.ascontiguousarray(b)) for a, b in layers),
            mean=mean[0],
            variance=np.square(scale[0] - np.float32(NORMALISER_EPSILON)),
            samples=max(1, sum(stage["samples"] for stage in self.history())),
            log_std=log_std,
        )
