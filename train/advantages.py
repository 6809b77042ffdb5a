"""How advantages are scaled: over the samples of all ranks, and those of calm robots by themselves.

Scaled together, the advantages of a round say little about exact walking. Measured with the preset `exact`, where half
of the episodes are calm, 85 % of their summed squares are the disturbed robots', and a tenth of those robots' samples
hold 93 % of that. So where some episodes are calm (`WalkConfig.calm_share`), theirs are brought to unit variance by
themselves, and both lessons weigh as much as they have samples.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
import torch.distributed as dist
from rsl_rl.algorithms import PPO
from tensordict import TensorDict


class GroupPpo(PPO):
    """rsl-rl's algorithm with advantages scaled by groups of samples, each over all ranks.

    rsl-rl averages gradients, the KL divergence and the normaliser's figures over ranks, but scales the advantages of
    each rank by themselves. Here they are scaled as those of one large batch would be.
    """

    calm: torch.Tensor | None = None
    """Samples of calm episodes in the round, (steps, N) bool; None where none is."""

    def compute_returns(self, obs: TensorDict) -> None:
        """As rsl-rl's; see there."""
        super().compute_returns(obs)
        if self.calm is None and not self.is_multi_gpu:
            return
        raw = (self.storage.returns - self.storage.values).double()
        whole = torch.ones_like(raw, dtype=torch.bool)
        calm = None if self.calm is None else self.calm[..., None].to(raw.device)
        groups = [whole] if calm is None else [calm, ~calm]
        self.storage.advantages = scaled(raw, groups, self.is_multi_gpu).float()


def scaled(raw: torch.Tensor, groups: Sequence[torch.Tensor], of_all_ranks: bool) -> torch.Tensor:
    """Each group with mean 0 and variance 1; what is in none is 0.

    Args:
        raw: numbers of this rank, float64.
        groups: masks of their shape; no number is in two. A rank may have none of a group.
        of_all_ranks: whether mean and variance are those of all ranks' numbers.
    """
    result = torch.zeros_like(raw)
    for group in groups:
        own = raw[group]
        sums = torch.stack([own.sum(), own.new_tensor(float(own.numel()))])
        if of_all_ranks:
            dist.all_reduce(sums)
        mean = sums[0] / sums[1].clamp(min=1.0)
        spread = (own - mean).square().sum()
        if of_all_ranks:
            dist.all_reduce(spread)
        std = (spread / (sums[1] - 1.0).clamp(min=1.0)).sqrt()
        result[group] = (own - mean) / (std + 1e-8)
    return result
