"""Proximal policy optimisation of the walking policy with rsl-rl."""

from __future__ import annotations

import io
from collections.abc import Generator
from contextlib import redirect_stdout
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from rsl_rl.algorithms import PPO
from rsl_rl.models import MLPModel
from rsl_rl.modules.distribution import GaussianDistribution
from rsl_rl.storage import RolloutStorage
from rsl_rl.utils import resolve_class
from tensordict import TensorDict

from asimov_gym.envs.walk_batch import WalkBatch
from asimov_gym.robot.joints import POLICY_JOINT_NAMES
from asimov_gym.robot.mirror import Mirror, mirror_policy
from asimov_gym.robot.observation import ObservationLayout
from train.advantages import GroupPpo
from train.config import LearnerConfig
from train.linear import use_onednn
from train.ranks import Ranks
from train.symmetry import SymmetricGaussian, SymmetricModel

if TYPE_CHECKING:
    from train.functional_batch import FunctionalBatch


def tensor(array: Any, device: str = "cpu") -> torch.Tensor:
    """An array of NumPy or JAX as a tensor, without a copy where it is on that device already."""
    rows = torch.from_numpy(array) if isinstance(array, np.ndarray) else torch.from_dlpack(array)
    return rows if device == "cpu" and rows.device.type == "cpu" else rows.to(device)


def views(observation: Any, privileged: Any, device: str = "cpu") -> TensorDict:
    """Observation groups as rsl-rl takes them."""
    groups = {"actor": tensor(observation, device), "critic": tensor(privileged, device)}
    return TensorDict(groups, batch_size=[len(observation)])


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
    if config.symmetric:
        settings |= {
            "class_name": SymmetricModel,
            "view": view,
            "output": output,
            "handed": config.symmetry == "handed",
        }
    return settings


def _actor(config: LearnerConfig, view: Mirror) -> dict[str, Any]:
    kind = SymmetricGaussian if config.symmetric else GaussianDistribution
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


class KeptMinibatches(RolloutStorage):
    """rsl-rl's storage, which hands out the same minibatches in every epoch and gathers them anew each time; here they
    are gathered once."""

    def mini_batch_generator(self, num_mini_batches: int, num_epochs: int = 8) -> Generator[Any, None, None]:
        """As rsl-rl's; see there."""
        kept = list(super().mini_batch_generator(num_mini_batches, 1))
        for _ in range(num_epochs):
            yield from kept


class PairedAdam(torch.optim.Adam):
    """Adam for an actor, whose rate PPO adapts, and a critic with a rate of its own."""

    def __init__(self, actor: torch.nn.Module, critic: torch.nn.Module, rate: float, critic_rate: float) -> None:
        groups = [{"params": list(actor.parameters())}, {"params": list(critic.parameters()), "own_rate": critic_rate}]
        super().__init__(groups, lr=rate)

    def step(self, closure: Any = None) -> Any:
        """A step, with the rates as they are to be: rsl-rl sets one for all groups."""
        for group in self.param_groups:
            group["lr"] = group.get("own_rate", group["lr"])
        return super().step(closure)


def set_learning_rate(algorithm: PPO, rate: float) -> None:
    """Set what the learning rate adapts from."""
    algorithm.learning_rate = rate
    for group in algorithm.optimizer.param_groups:
        group["lr"] = rate


def build_ppo(
    batch: WalkBatch | FunctionalBatch, config: LearnerConfig, observations: TensorDict, ranks: Ranks | None = None
) -> GroupPpo:
    """The algorithm with fresh networks for a batch of robots.

    Args:
        batch: this rank's robots.
        config: settings.
        observations: of the batch, on the rank's device.
        ranks: processes that learn together; they get the networks of rank 0.
    """
    ranks = ranks or Ranks()
    settings: dict[str, Any] = {
        "num_steps_per_env": config.steps,
        "obs_groups": {"actor": ["actor"], "critic": ["critic"]},
        "multi_gpu": ranks.multi_gpu(),
        "actor": _actor(config, batch.task.layout.mirror),
        "critic": _model(config, batch.task.privileged_mirror, None),
        "algorithm": {
            "class_name": GroupPpo,
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
        algorithm: GroupPpo = PPO.construct_algorithm(observations, _Sizes(batch.copies), settings, ranks.device)  # type: ignore[arg-type]
    size = [len(POLICY_JOINT_NAMES)]
    algorithm.storage = KeptMinibatches("rl", batch.copies, config.steps, observations, size, ranks.device)
    if config.critic_rate is not None:
        rates = config.learning_rate, config.critic_rate
        algorithm.optimizer = PairedAdam(algorithm.actor, algorithm.critic, *rates)
    for model in (algorithm.actor, algorithm.critic):
        use_onednn(model)
    if ranks.count > 1:
        algorithm.broadcast_parameters()
    algorithm.train_mode()
    return algorithm
