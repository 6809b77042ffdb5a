"""Teaching left and right alike: networks that are symmetric by construction, or mirrored samples.

A symmetric network answers the mirror image of an observation with the mirror image of its action, exactly: it is the
mean of a plain network and that network's reflection. Every sample then teaches both sides, and the policy cannot limp.
"""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import torch
from rsl_rl.algorithms import PPO
from rsl_rl.models import MLPModel
from rsl_rl.modules.distribution import GaussianDistribution
from rsl_rl.storage import RolloutStorage
from tensordict import TensorDict
from torch import nn

from asimov_gym.robot.mirror import Mirror, mirror_policy
from train.handedness import hand, handed


class TorchMirror(nn.Module):
    """A mirror of the last axis as a module."""

    indices: torch.Tensor
    signs: torch.Tensor

    def __init__(self, mirror: Mirror) -> None:
        super().__init__()
        indices, signs = np.asarray(mirror.indices), mirror.signs
        self.register_buffer("indices", torch.as_tensor(indices, dtype=torch.long), persistent=False)
        self.register_buffer("signs", torch.as_tensor(signs, dtype=torch.float32), persistent=False)

    def forward(self, rows: torch.Tensor) -> torch.Tensor:
        return rows.index_select(-1, self.indices) * self.signs


class TorchHand(nn.Module):
    """A hand for observations at rest, as a module."""

    entries: torch.Tensor

    def __init__(self, width: int) -> None:
        super().__init__()
        self.register_buffer("entries", torch.as_tensor(hand(width)), persistent=False)

    def forward(self, rows: torch.Tensor) -> torch.Tensor:
        return handed(rows, self.entries)


class SymmetricNetwork(nn.Module):
    """Mean of a network and its reflection: `(f(x) + M f(M x)) / 2`, the outer M being the output's mirror.

    Args:
        hand: what makes x of the observation; the identity keeps the network symmetric.
    """

    is_recurrent = False

    def __init__(
        self, hand: nn.Module, normaliser: nn.Module, network: nn.Module, view: TorchMirror, output: nn.Module
    ) -> None:
        super().__init__()
        self.hand, self.normaliser, self.network, self.view, self.output = hand, normaliser, network, view, output

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        x = self.hand(x)
        both = self.network(self.normaliser(torch.cat([x, self.view(x)], dim=0)))
        half = x.shape[0]
        return 0.5 * (both[:half] + self.output(both[half:]))


class SymmetricModel(MLPModel):
    """rsl-rl's model, symmetric by construction.

    Args:
        view: mirror of the concatenated observation.
        output: mirror of the output; None where the mirror leaves it as it is (a value).
        handed: whether it has a hand at rest; see `train.handedness`.
    """

    def __init__(self, *args: Any, view: Mirror, output: Mirror | None, handed: bool = False, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.hand = TorchHand(view.size) if handed else nn.Identity()
        self.view_mirror = TorchMirror(view)
        self.output_mirror = nn.Identity() if output is None else TorchMirror(output)

    def forward(
        self,
        obs: TensorDict,
        masks: torch.Tensor | None = None,
        hidden_state: Any = None,
        stochastic_output: bool = False,
    ) -> torch.Tensor:
        """As rsl-rl's; see there."""
        rows = torch.cat([obs[group] for group in self.obs_groups], dim=-1)
        mean = self._symmetric()(rows)
        if self.distribution is None:
            return mean
        if stochastic_output:
            self.distribution.update(mean)
            return self.distribution.sample()
        return self.distribution.deterministic_output(mean)

    def as_onnx(self, verbose: bool) -> nn.Module:
        """The deterministic network for export."""
        return copy.deepcopy(self._symmetric())

    def _symmetric(self) -> SymmetricNetwork:
        # Assembled on the fly, so that its parts stay registered under rsl-rl's own names.
        return SymmetricNetwork(self.hand, self.obs_normalizer, self.mlp, self.view_mirror, self.output_mirror)


class SymmetricGaussian(GaussianDistribution):
    """A Gaussian whose deviations are the same for a joint and its counterpart."""

    def update(self, mlp_output: torch.Tensor) -> None:
        """Take the means; the deviations are averaged over each pair in log space."""
        pairs = torch.as_tensor(np.asarray(mirror_policy.indices), device=mlp_output.device)
        log_std = 0.5 * (self.log_std_param + self.log_std_param[pairs])
        std = torch.exp(log_std.clamp(*self.log_std_range))
        self._distribution = torch.distributions.Normal(mlp_output, std.expand_as(mlp_output))


class MirrorSamples:
    """Before each update a random half of the collected samples becomes its mirror image.

    A mirrored sample keeps its likelihood at the time it was drawn, as rsl-rl's symmetry extension has it: of a policy
    still lopsided, a mirrored action may be so unlikely that a ratio to anything else explodes. The distribution that
    the adaptive learning rate compares with is computed anew, else the lopsidedness would count as a large step of the
    policy and hold the rate down. Mirroring half of the samples costs half of what that extension's doubling does.
    """

    def __init__(self, actor_view: Mirror, critic_view: Mirror) -> None:
        self._actor, self._critic, self._action = map(TorchMirror, (actor_view, critic_view, mirror_policy))

    @torch.no_grad()
    def __call__(self, algorithm: PPO) -> None:
        """Mirror about half of the algorithm's storage, in place; to be called after the returns are known."""
        storage: RolloutStorage = algorithm.storage
        device = storage.rewards.device
        for mirror in (self._actor, self._critic, self._action):
            mirror.to(device)
        flip = torch.rand(storage.rewards.shape, device=device) < 0.5
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
