"""Proximal policy optimisation of the walking policy with rsl-rl on C physics."""

from __future__ import annotations

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
    """Teaches left and right alike: a random half of each minibatch is replaced by its mirror image.

    It takes the place of rsl-rl's symmetry extension, which doubles each minibatch and so the cost of learning.
    """

    use_mirror_loss = False

    def __init__(self, actor_view: Mirror, critic_view: Mirror) -> None:
        self._actor, self._critic, self._action = map(_TorchMirror, (actor_view, critic_view, mirror_policy))

    def augment_batch(self, batch: RolloutStorage.Batch, original_batch_size: int) -> None:
        """Mirror about half of the rows, in observations, actions and the old distribution alike."""
        flip = torch.rand(original_batch_size, 1) < 0.5
        views = batch.observations
        assert views is not None and batch.actions is not None and batch.old_distribution_params is not None
        batch.observations = TensorDict(
            {
                "actor": torch.where(flip, self._actor(views["actor"]), views["actor"]),
                "critic": torch.where(flip, self._critic(views["critic"]), views["critic"]),
            },
            batch_size=views.batch_size,
        )
        batch.actions = torch.where(flip, self._action(batch.actions), batch.actions)
        mean, std = batch.old_distribution_params
        batch.old_distribution_params = (
            torch.where(flip, self._action(mean), mean),
            torch.where(flip, self._action.permute(std), std),
        )

    def compute_loss(self, actor: MLPModel, batch: RolloutStorage.Batch, original_batch_size: int) -> torch.Tensor:
        """No extra loss: the mirrored samples do the work."""
        return torch.zeros(())


class _TorchMirror:
    def __init__(self, mirror: Mirror) -> None:
        self._indices = torch.as_tensor(np.asarray(mirror.indices), dtype=torch.long)
        self._signs = torch.as_tensor(mirror.signs, dtype=torch.float32)

    def __call__(self, rows: torch.Tensor) -> torch.Tensor:
        return rows[:, self._indices] * self._signs

    def permute(self, rows: torch.Tensor) -> torch.Tensor:
        """Swap the entries without changing signs, as deviations need."""
        return rows[:, self._indices]


def views(observation: np.ndarray, privileged: np.ndarray) -> TensorDict:
    """Observation groups as rsl-rl takes them."""
    return TensorDict(
        {"actor": torch.from_numpy(observation), "critic": torch.from_numpy(privileged)}, batch_size=[len(observation)]
    )


class _Sizes:
    """The little that rsl-rl asks of an environment to build its models."""

    def __init__(self, copies: int) -> None:
        self.num_envs, self.num_actions = copies, len(POLICY_JOINT_NAMES)


def build_ppo(batch: WalkBatch, config: LearnerConfig, observations: TensorDict) -> PPO:
    """The algorithm with fresh networks for a batch of robots."""
    network = {"class_name": "MLPModel", "hidden_dims": list(config.hidden), "activation": "elu", "obs_normalization": True}
    settings: dict[str, Any] = {
        "num_steps_per_env": config.steps,
        "obs_groups": {"actor": ["actor"], "critic": ["critic"]},
        "multi_gpu": None,
        "actor": {
            **network,
            "distribution_cfg": {"class_name": "GaussianDistribution", "init_std": config.initial_std, "std_type": "scalar"},
        },
        "critic": dict(network),
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
    algorithm = PPO.construct_algorithm(observations, _Sizes(batch.copies), settings, "cpu")  # type: ignore[arg-type]
    if config.mirror:
        algorithm.symmetry = MirrorSamples(batch.task.layout.mirror, batch.task.privileged_mirror)  # type: ignore[assignment]
    algorithm.train_mode()
    return algorithm
