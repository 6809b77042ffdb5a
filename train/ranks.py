"""Training on several processes at once: who they are, and what they tell each other.

`torchrun` starts the processes and gives each its rank. All hold the same networks; each simulates robots of its own.
Gradients and the normaliser's figures are averaged by rsl-rl, the rest goes through `Ranks`. Without `torchrun` there
is one rank, and nothing here does anything.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import timedelta
from typing import Any, TypeVar

import numpy as np
import torch
import torch.distributed as dist

T = TypeVar("T")

PATIENCE = timedelta(minutes=10)
"""How long a rank waits for the others before it gives up."""


class RankLost(ConnectionError):
    """Another rank has ended, or does not answer."""


@dataclass(frozen=True)
class Ranks:
    """The processes of a run, seen from one of them."""

    rank: int = 0
    """Own number, from 0; rank 0 owns the run's folder and speaks for all."""
    count: int = 1
    """All processes, on all machines."""
    local_rank: int = 0
    """Own number on this machine."""
    local_count: int = 1
    """Processes on this machine."""
    device: str = "cpu"
    """Where this process keeps its networks."""

    @property
    def first(self) -> bool:
        """Whether this is rank 0."""
        return self.rank == 0

    @classmethod
    @contextmanager
    def joined(cls) -> Iterator[Ranks]:
        """The ranks as `torchrun` has set them up, connected meanwhile; one where it has not.

        Raises:
            RankLost: another rank ended in the meantime.
        """
        rank, count, local_rank, local_count = (int(os.environ.get(*pair)) for pair in _ENVIRONMENT)
        ranks = cls(rank, count, local_rank, local_count)
        if ranks.count == 1:
            yield ranks
            return
        # Objects and CPU tensors go over gloo even where networks are on GPUs.
        backend = "cpu:gloo,cuda:nccl" if torch.cuda.is_available() else "gloo"
        dist.init_process_group(backend, timeout=PATIENCE)
        try:
            yield ranks
        except RuntimeError as error:
            if not _is_loss(error):
                raise
            lost = f"rank {ranks.rank} stops: another of the {ranks.count} has ended or does not answer; "
            lost += f"continue from the last checkpoint with:  {ranks.command} resume RUN"
            raise RankLost(lost) from error
        # Not after an error: closing waits for ranks that may be gone.
        dist.destroy_process_group()

    def on(self, device: str) -> Ranks:
        """The same with networks on `cpu` or `cuda`; there each process of a machine takes a GPU of its own.

        Raises:
            ValueError: there is no GPU for this process.
        """
        if device == "cpu":
            return replace(self, device=device)
        seen = torch.cuda.device_count()
        if seen == 0:
            raise ValueError("device cuda: torch sees no NVIDIA GPU here; use --device cpu")
        if self.local_rank >= seen:
            raise ValueError(
                f"device cuda: torch sees {seen} GPUs here, none is left for process {self.local_rank} of this "
                f"machine; start at most {seen} (--nproc_per_node), or use --device cpu"
            )
        torch.cuda.set_device(self.local_rank)
        return replace(self, device=f"cuda:{self.local_rank}")

    @property
    def command(self) -> str:
        """How the trainer is started with as many processes."""
        if self.count == 1:
            return "python -m train"
        if self.count == self.local_count:
            return f"torchrun --standalone --nproc_per_node {self.count} -m train"
        return f"torchrun [for {self.count} processes, as before] -m train"

    def threads(self, wanted: int | None) -> int:
        """Threads for this process: as wanted, or its share of the machine's cores."""
        return wanted or max(1, (os.cpu_count() or 1) // self.local_count)

    def seed(self, seed: int) -> int:
        """A seed of this rank's own; rank 0 keeps the given one."""
        if self.first:
            return seed
        return int(np.random.SeedSequence(seed, spawn_key=(self.rank,)).generate_state(1)[0])

    def multi_gpu(self) -> dict[str, int] | None:
        """The ranks as rsl-rl wants to have them described, whatever the device; None for one."""
        if self.count == 1:
            return None
        return {"global_rank": self.rank, "local_rank": self.local_rank, "world_size": self.count}

    # -- every rank must call each of these, in the same order ---------------------------------------------------------

    def from_first(self, make: Callable[[], T]) -> T:
        """What rank 0 makes, for all. When it cannot, it raises the error, and the others leave quietly."""
        if self.count == 1:
            return make()
        outcome: list[Any] = [None, False]
        if not self.first:
            dist.broadcast_object_list(outcome, src=0, device=torch.device("cpu"))
            if not outcome[1]:
                raise SystemExit(2)
            return outcome[0]
        try:
            outcome = [make(), True]
        finally:
            dist.broadcast_object_list(outcome, src=0, device=torch.device("cpu"))
        return outcome[0]

    def gathered(self, own: T) -> list[T] | None:
        """What each rank hands in, by rank, on rank 0; None on the others."""
        if self.count == 1:
            return [own]
        everything: list[Any] | None = [None] * self.count if self.first else None
        dist.gather_object(own, everything, dst=0)
        return everything

    def handed_out(self, everything: Sequence[T]) -> T:
        """The part of this rank of what rank 0 has, by rank; the others may hand in anything."""
        if self.count == 1:
            return everything[0]
        own: list[Any] = [None]
        dist.scatter_object_list(own, list(everything) if self.first else None, src=0)
        return own[0]

    def mean(self, values: Mapping[str, float]) -> dict[str, float]:
        """The mean over the ranks of figures that all of them have, by name."""
        if self.count == 1:
            return dict(values)
        total = torch.tensor([values[name] for name in sorted(values)], dtype=torch.float64)
        dist.all_reduce(total)
        return dict(zip(sorted(values), (total / self.count).tolist(), strict=True))

    def raised(self, *flags: bool) -> tuple[bool, ...]:
        """For each flag, whether any rank has set it."""
        if self.count == 1:
            return flags
        highest = torch.tensor(flags, dtype=torch.int32)
        dist.all_reduce(highest, op=dist.ReduceOp.MAX)
        return tuple(bool(flag) for flag in highest.tolist())


_ENVIRONMENT = (("RANK", "0"), ("WORLD_SIZE", "1"), ("LOCAL_RANK", "0"), ("LOCAL_WORLD_SIZE", "1"))
_LOSSES = ("gloo", "NCCL", "Connection closed by peer", "Connection reset by peer", "Timed out", "Broken pipe")


def _is_loss(error: RuntimeError) -> bool:
    """Whether an error of a collective says that another rank is gone. Gloo has no class of errors for it."""
    return isinstance(error, dist.DistError) or any(words in str(error) for words in _LOSSES)
