"""Proximal policy optimisation of the walking policy with rsl-rl on C physics."""

from __future__ import annotations

import io
from contextlib import redirect_stdout
from typing import Any

import numpy as np
import torch
from rsl_rl.algorithms import PPO
from rsl_rl.models import MLPModel
from rsl_rl.modules.distribution import GaussianDistribution
from rsl_rl.utils import resolve_class
from tensordict import TensorDict

from asimov_gym.envs.walk_batch import WalkBatch
from asimov_gym.robot.joints import POLICY_JOINT_NAMES
from asimov_gym.robot.mirror import Mirror, mirror_policy
from asimov_gym.robot.observation import ObservationLayout
from train.config import LearnerConfig
from train.symmetry import SymmetricGaussian, SymmetricModel


def views(observation: np.ndarray, privileged: np.ndarray) -> TensorDict:
    """Observation groups as rsl-rl takes them."""
    return TensorDict(
        {"actor": torch.from_numpy(observation), "critic": torch.from_numpy(privileged)}, batch_size=[len(observation)]
    )


class _Sizes:
    """The little that rsl-rl asks of an environment to build its models."""

    def __init__(self, copies: int) -> None:
        self.num_envs, self.num_actions = copies, len(POLICY_JOINT_NAMES)


def _model(config: LearnerConfig, view: Mirror, output: Mirror | None) -> dict[str, Any]:
    """Settings of a network whose input has the mirror `view`."""
    settings: dict[str, Any] = {
        "class_name": MLPModel,
        "hidden_dims": list(config.hidden),
        "activation": "elu",
        "obs_normalization": True,
    }
    if config.symmetry == "network":
        settings |= {"class_name": SymmetricModel, "view": view, "output": output}
    return settings


def _actor(config: LearnerConfig, view: Mirror) -> dict[str, Any]:
    kind = SymmetricGaussian if config.symmetry == "network" else GaussianDistribution
    exploration = {"class_name": kind, "init_std": config.initial_std, "std_type": "log"}
    return _model(config, view, mirror_policy) | {"distribution_cfg": exploration}


def load_actor(config: LearnerConfig, layout: ObservationLayout, weights: dict[str, Any]) -> MLPModel:
    """The actor of a checkpoint, normaliser inside, evaluating.

    Args:
        config: settings of the run.
        layout: of the actor's observation.
        weights: the checkpoint's `actor_state_dict`.
    """
    sample = TensorDict({"actor": torch.zeros(1, layout.width)}, batch_size=[1])
    kind, settings = resolve_class(_actor(config, layout.mirror))
    actor: MLPModel = kind(sample, {"actor": ["actor"]}, "actor", len(POLICY_JOINT_NAMES), **settings)
    actor.load_state_dict(weights)
    return actor.eval()


def build_ppo(batch: WalkBatch, config: LearnerConfig, observations: TensorDict) -> PPO:
    """The algorithm with fresh networks for a batch of robots."""
    settings: dict[str, Any] = {
        "num_steps_per_env": config.steps,
        "obs_groups": {"actor": ["actor"], "critic": ["critic"]},
        "multi_gpu": None,
        "actor": _actor(config, batch.task.layout.mirror),
        "critic": _model(config, batch.task.privileged_mirror, None),
        "algorithm": {
            "class_name": "PPO",
            "num_learning_epochs": config.epochs,
            "num_mini_batches": config.minibatches,
            "gamma": config.gamma,
            "lam": config.lam,
            "learning_rate": config.learning_rate,
            "schedule": "adaptive",
            "desired_kl": config.desired_kl,
            "clip_param": config.clip,
            "entropy_coef": config.entropy[0],
            "use_clipped_value_loss": True,
            "rnd_cfg": None,
            "symmetry_cfg": None,
        },
    }
    with redirect_stdout(io.StringIO()):  # rsl-rl prints its networks
        algorithm = PPO.construct_algorithm(observations, _Sizes(batch.copies), settings, "cpu")  # type: ignore[arg-type]
    algorithm.train_mode()
    return algorithm
