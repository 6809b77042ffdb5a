"""The training loop that all learners share: rounds, curves, checkpoints; interrupted at any time and resumed.

With several ranks each runs this loop over its own robots; see `train.ranks`.
"""

from __future__ import annotations

import abc
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table
from torch.utils.tensorboard import SummaryWriter

from train.averaging import WeightAverage
from train.config import PpoConfig
from train.ranks import Ranks
from train.run_folder import RunFolder
from train.weights import NetworkWeights, with_exploration

CAUTIOUS_RATE = 1e-5
"""Learning rate from which an actor that was held begins: its optimiser knows nothing yet of how far a step goes, and a
large first one would undo what the actor can."""


@dataclass
class Progress:
    """How far a run is; part of a checkpoint."""

    samples: int = 0
    """Of all ranks together."""
    iteration: int = 0
    seconds: float = 0.0


class Interrupt:
    """Remembers the first Ctrl-C, so that the loop can finish its iteration, save and leave; the second one kills."""

    def __init__(self, console: Console) -> None:
        self.wanted = False
        self._console = console

    @contextmanager
    def listening(self) -> Iterator[Interrupt]:
        """Listen while the loop runs."""

        def remember(number: int, frame: Any) -> None:
            if self.wanted:
                raise KeyboardInterrupt
            self.wanted = True
            self._console.print("stopping after this iteration; once more to stop at once")

        before = {number: signal.signal(number, remember) for number in (signal.SIGINT, signal.SIGTERM)}
        try:
            yield self
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)


class TrainingLoop(abc.ABC):
    """One training run; what a learner adds is how a round is collected and learned from.

    Args:
        config: settings; the same on all ranks.
        folder: of the run. Only rank 0 reads and writes it, but for the states of diverged copies.
        ranks: the processes that train together; a single one by default.
    """

    def __init__(self, config: PpoConfig, folder: RunFolder, ranks: Ranks | None = None) -> None:
        self.config, self.folder, self.ranks = config, folder, ranks or Ranks()
        # In a notebook too as plain lines.
        self.console = Console(soft_wrap=True, quiet=not self.ranks.first, highlight=False, force_jupyter=False)
        self.progress = Progress()
        self.average = WeightAverage(config.learner.averaged_rounds)

    # -- a learner's part ----------------------------------------------------------------------------------------------

    @abc.abstractmethod
    def iterate(self) -> dict[str, float]:
        """Collect one round of steps, learn from it, and return the figures to report."""

    @abc.abstractmethod
    def learned(self) -> dict[str, Any]:
        """The part of a checkpoint that is the same on all ranks: networks, normaliser, optimiser, learning rate."""

    @abc.abstractmethod
    def actor_weights(self) -> NetworkWeights:
        """The actor as it is now."""

    @abc.abstractmethod
    def own(self) -> dict[str, Any]:
        """This rank's part of a checkpoint: robots and random numbers."""

    @abc.abstractmethod
    def restore(self, learned: dict[str, Any], own: dict[str, Any]) -> None:
        """Continue from both parts of a checkpoint."""

    @abc.abstractmethod
    def warm_start(self, other: RunFolder) -> None:
        """Begin with the networks of another run's newest checkpoint; its environment and counters stay behind."""

    @abc.abstractmethod
    def begin_with(self, actor: NetworkWeights) -> None:
        """Begin with this actor and a new critic."""

    @abc.abstractmethod
    def untaught_shares(self) -> dict[str, float]:
        """Mean share of each reward term per second over a few steps, from which nothing is learned."""

    @abc.abstractmethod
    def close(self) -> None:
        """Stop the physics threads."""

    # -- checkpoints ---------------------------------------------------------------------------------------------------

    def resume(self) -> None:
        """Continue from the newest checkpoint of the folder.

        Raises:
            FileNotFoundError: there is none.
            ValueError: it was written by another number of ranks.
        """
        parts: list[dict[str, Any]] = []

        def common() -> dict[str, Any]:
            state = self.folder.load_checkpoint()
            parts.extend(state.pop("ranks"))
            if len(parts) != self.ranks.count:
                raise ValueError(
                    f"{self.folder.path} was trained by {len(parts)} processes and continues with as many, got "
                    f"{self.ranks.count}: see docs/multi_device.md, or start a new run with --warm-start"
                )
            return state

        state = self.ranks.from_first(common)
        own = self.ranks.handed_out(parts)
        self.progress = Progress(**state["progress"])
        self.average.restore(state.get("average"))
        self.restore(state["learner"], own)

    def save(self) -> None:
        """Write a checkpoint; everything needed to continue is in it, of all ranks."""
        parts = self.ranks.gathered(self.own())
        if parts is not None:
            state = {"learner": self.learned(), "progress": vars(self.progress), "ranks": parts}
            state["average"] = self.average.snapshot()
            self.folder.save_checkpoint(self.progress.samples, state, self.config.keep_checkpoints)

    # -- the run -------------------------------------------------------------------------------------------------------

    def run(self) -> bool:
        """Train to the end or to an interrupt of any rank; True when the run is complete."""
        writer = self._curves() if self.ranks.first else None
        started, saved, told, stop = time.monotonic(), time.monotonic(), 0.0, False
        first_samples, before = self.progress.samples, self.progress.seconds
        with Interrupt(self.console).listening() as interrupt:
            while self.progress.samples < self.config.samples and not stop:
                figures = self.iterate()
                if self.average.rounds > 1:
                    self.average.add(self.actor_weights())
                now = time.monotonic()
                self.progress.seconds = before + now - started
                rate = (self.progress.samples - first_samples) / (now - started)
                if writer is not None:
                    for name, value in figures.items():
                        writer.add_scalar(name, value, self.progress.samples)
                    writer.add_scalar("speed/samples_per_s", rate, self.progress.samples)
                if now - told > 10.0 or self.progress.samples >= self.config.samples:
                    told = now
                    self.console.print(_line(self.progress, self.config.samples, rate, figures), highlight=False)
                due = self.ranks.first and now - saved > self.config.checkpoint_s
                stop, due = self.ranks.raised(interrupt.wanted, due)
                if due and not stop:
                    saved = now
                    self.save()
            self.save()
        if writer is not None:
            writer.close()
        self.close()
        return self.progress.samples >= self.config.samples

    def _curves(self) -> SummaryWriter:
        """Where the curves go on. What a killed process wrote after its last checkpoint does not count."""
        purged = self.progress.samples + 1 if self.progress.samples else None
        return SummaryWriter(str(self.folder.path / "curves"), purge_step=purged)

    def reward_table(self) -> Table:
        """Shares of the reward terms under the untrained policy, to catch a term that drowns the others."""
        shares = self.untaught_shares()
        whole = sum(abs(value) for value in shares.values()) or 1.0
        table = Table(title="Reward terms at the start", title_justify="left")
        for column in ("term", "weight", "per second", "share"):
            table.add_column(column, justify="left" if column == "term" else "right")
        for name, weight in self.config.walk.rewards.items():
            value = shares[name]
            table.add_row(name, f"{weight:g}", f"{value:+.3f}", f"{abs(value) / whole:.0%}")
        return table

    def count_round(self) -> None:
        """Add a round to the progress."""
        self.progress.iteration += 1
        self.progress.samples += self.ranks.count * self.config.copies * self.config.learner.steps

    def dump_folder(self) -> Path:
        """Where this rank writes the states of diverged copies."""
        folder = self.folder.path / "diverged"
        return folder if self.ranks.first else folder / f"rank_{self.ranks.rank}"


def checkpoint_of(
    other: RunFolder, ranks: Ranks, warm_std: tuple[float, float] | None = None
) -> tuple[str, dict[str, Any]]:
    """The learner of a run, and what it had learned at its newest checkpoint; for all ranks.

    Args:
        other: the run.
        ranks: that all get it.
        warm_std: see `train.config.LearnerConfig`.

    Raises:
        FileNotFoundError: it is not a run, or has no checkpoint.
    """

    def read() -> tuple[str, dict[str, Any]]:
        return other.config().library or "rsl_rl", with_exploration(other.load_checkpoint()["learner"], warm_std)

    return ranks.from_first(read)


def _line(progress: Progress, total: int, rate: float, figures: dict[str, float]) -> str:
    left = max(0, total - progress.samples) / max(rate, 1.0)
    return (
        f"{progress.samples / 1e6:7.2f}M of {total / 1e6:.1f}M  {rate:6.0f}/s  ETA {left / 60:4.0f} min  "
        f"episode {figures['episode/length_s']:5.1f} s  reward {figures['episode/reward']:5.2f}/s  "
        f"falls {figures['episode/falls_per_min']:6.2f}/min  error {figures['error/velocity']:.3f} m/s "
        f"{figures['error/yaw_rate']:.3f} rad/s  std {figures['policy/std']:.2f}  "
        f"lift {figures['reward/foot_height']:.2f}  "
        f"levels {figures['curriculum/penalty']:.2f} {figures['curriculum/kick']:.2f}  "
        f"[{figures['speed/collect_s']:.2f}+{figures['speed/learn_s']:.2f} s]"
    )
