"""Proximal policy optimisation of the walking policy with rsl-rl on C physics."""

from __future__ import annotations

import io
from contextlib import redirect_stdout
from typing import Any

import numpy as np
import torch
from rsl_rl.algorithms import PPO
from rsl_rl.models import MLPModel
from rsl_rl.storage import RolloutStorage
from tensordict import TensorDict

from asimov_gym.envs.walk_batch import WalkBatch
from asimov_gym.robot.joints import POLICY_JOINT_NAMES
from asimov_gym.robot.mirror import Mirror, mirror_policy
from train.config import LearnerConfig


class MirrorSamples:
    """Teaches left and right alike: before each update a random half of the collected samples becomes its mirror image.

    A mirrored sample keeps its likelihood at the time it was drawn, as rsl-rl's symmetry extension has it: of a policy
    still lopsided, a mirrored action may be so unlikely that a ratio to anything else explodes. The distribution that the
    adaptive learning rate compares with is computed anew, else the lopsidedness would count as a large step of the policy
    and the rate would collapse. Mirroring half of the samples costs half of what that extension's doubling does.
    """

    def __init__(self, actor_view: Mirror, critic_view: Mirror) -> None:
        self._actor, self._critic, self._action = map(_TorchMirror, (actor_view, critic_view, mirror_policy))

    @torch.no_grad()
    def __call__(self, algorithm: PPO) -> None:
        """Mirror about half of the algorithm's storage, in place; to be called after the returns are known."""
        storage: RolloutStorage = algorithm.storage
        flip = torch.rand(storage.rewards.shape) < 0.5
        views = storage.observations
        for name, mirror in (("actor", self._actor), ("critic", self._critic)):
            views[name].copy_(torch.where(flip, mirror(views[name]), views[name]))
        storage.actions.copy_(torch.where(flip, self._action(storage.actions), storage.actions))
        flat = views.flatten(0, 1)
        shape = storage.rewards.shape
        algorithm.actor(flat, stochastic_output=True)
        fresh = algorithm.actor.output_distribution_params
        storage.distribution_params = tuple(p.reshape(*shape[:2], -1).clone() for p in fresh)
        storage.values.copy_(algorithm.critic(flat).view(shape))


class _TorchMirror:
    def __init__(self, mirror: Mirror) -> None:
        self._indices = torch.as_tensor(np.asarray(mirror.indices), dtype=torch.long)
        self._signs = torch.as_tensor(mirror.signs, dtype=torch.float32)

    def __call__(self, rows: torch.Tensor) -> torch.Tensor:
        return rows[..., self._indices] * self._signs


def views(observation: np.ndarray, privileged: np.ndarray) -> TensorDict:
    """Observation groups as rsl-rl takes them."""
    return TensorDict(
        {"actor": torch.from_numpy(observation), "critic": torch.from_numpy(privileged)}, batch_size=[len(observation)]
    )


class _Sizes:
    """The little that rsl-rl asks of an environment to build its models."""

    def __init__(self, copies: int) -> None:
        self.num_envs, self.num_actions = copies, len(POLICY_JOINT_NAMES)


def _network(config: LearnerConfig) -> dict[str, Any]:
    return {"hidden_dims": list(config.hidden), "activation": "elu", "obs_normalization": True}


def _exploration(config: LearnerConfig) -> dict[str, Any]:
    return {"class_name": "GaussianDistribution", "init_std": config.initial_std, "std_type": "log"}


def load_actor(config: LearnerConfig, width: int, weights: dict[str, Any]) -> MLPModel:
    """The actor of a checkpoint, normaliser inside, evaluating.

    Args:
        config: settings of the run.
        width: width of the actor's observation.
        weights: the checkpoint's `actor_state_dict`.
    """
    sample = TensorDict({"actor": torch.zeros(1, width)}, batch_size=[1])
    actor = MLPModel(
        sample,
        {"actor": ["actor"]},
        "actor",
        len(POLICY_JOINT_NAMES),
        **_network(config),
        distribution_cfg=_exploration(config),
    )
    actor.load_state_dict(weights)
    return actor.eval()


def build_ppo(batch: WalkBatch, config: LearnerConfig, observations: TensorDict) -> PPO:
    """The algorithm with fresh networks for a batch of robots."""
    settings: dict[str, Any] = {
        "num_steps_per_env": config.steps,
        "obs_groups": {"actor": ["actor"], "critic": ["critic"]},
        "multi_gpu": None,
        "actor": {"class_name": "MLPModel", **_network(config), "distribution_cfg": _exploration(config)},
        "critic": {"class_name": "MLPModel", **_network(config)},
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
