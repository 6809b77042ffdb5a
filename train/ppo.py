"""The training loop: collect, learn, report, save; interrupted at any time and resumed.

With several ranks each runs this loop over its own robots; see `train.ranks`.
"""

from __future__ import annotations

import signal
import time
from collections import defaultdict
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from rich.console import Console
from rich.table import Table
from torch.utils.tensorboard import SummaryWriter

from asimov_gym.envs.walk_batch import Curriculum, WalkBatch, WalkStep
from train.config import PpoConfig
from train.learner import build_ppo, views
from train.ranks import Ranks
from train.run_folder import RunFolder
from train.symmetry import MirrorSamples


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
    def listening(self) -> Any:
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


class Trainer:
    """One training run.

    Args:
        config: settings; the same on all ranks.
        folder: of the run. Only rank 0 reads and writes it, but for the states of diverged copies.
        ranks: the processes that train together; a single one by default.
    """

    def __init__(self, config: PpoConfig, folder: RunFolder, ranks: Ranks | None = None) -> None:
        self.config, self.folder, self.ranks = config, folder, ranks or Ranks()
        self.console = Console(soft_wrap=True, quiet=not self.ranks.first)
        diverged = folder.path / "diverged"
        torch.manual_seed(config.seed)
        self.batch = WalkBatch(
            config.walk,
            config.copies,
            config.profile,
            self.ranks.threads(config.threads),
            self.ranks.seed(config.seed),
            curriculum=True,
            stagger=True,
            dump_dir=diverged if self.ranks.first else diverged / f"rank_{self.ranks.rank}",
        )
        self.observations = views(*self.batch.reset(), self.ranks.device)
        self.ppo = build_ppo(self.batch, config.learner, self.observations, self.ranks)
        if not self.ranks.first:
            torch.manual_seed(self.ranks.seed(config.seed))  # the networks are equal, the exploration is not
        task = self.batch.task
        mirror = MirrorSamples(task.layout.mirror, task.privileged_mirror)
        self.mirror = mirror if config.learner.symmetry == "samples" else None
        self.progress = Progress()

    def warm_start(self, other: RunFolder) -> None:
        """Begin with the networks of another run's newest checkpoint; its environment and counters stay behind."""
        wanted = {"actor": True, "critic": True, "optimizer": True, "iteration": False, "rnd": False}
        self.ppo.load(self.ranks.from_first(lambda: other.load_checkpoint()["learner"]), wanted, True)

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
        self.ppo.load(state["learner"], None, True)
        self.progress = Progress(**state["progress"])
        self.batch.restore(own["batch"])
        self.observations = own["observations"].to(self.ranks.device)
        torch.set_rng_state(own["torch_rng"])
        if own["device_rng"] is not None:
            torch.cuda.set_rng_state(own["device_rng"], self.ranks.device)

    def save(self) -> None:
        """Write a checkpoint; everything needed to continue is in it, of all ranks."""
        device = self.ranks.device
        own = {
            "batch": self.batch.snapshot(),
            "observations": self.observations.cpu(),
            "torch_rng": torch.get_rng_state(),
            "device_rng": None if device == "cpu" else torch.cuda.get_rng_state(device),
        }
        parts = self.ranks.gathered(own)
        if parts is not None:
            state = {"learner": self.ppo.save(), "progress": vars(self.progress), "ranks": parts}
            self.folder.save_checkpoint(self.progress.samples, state, self.config.keep_checkpoints)

    def run(self) -> bool:
        """Train to the end or to an interrupt of any rank; True when the run is complete."""
        writer = SummaryWriter(str(self.folder.path / "curves")) if self.ranks.first else None
        started, saved, told, stop = time.monotonic(), time.monotonic(), 0.0, False
        first_samples, before = self.progress.samples, self.progress.seconds
        with Interrupt(self.console).listening() as interrupt:
            while self.progress.samples < self.config.samples and not stop:
                figures = self.iterate()
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
        self.batch.close()
        return self.progress.samples >= self.config.samples

    def iterate(self) -> dict[str, float]:
        """Collect one round of steps, learn from it, and return the figures to report."""
        figures: dict[str, list[float]] = defaultdict(list)
        device, began = self.ranks.device, time.monotonic()
        with torch.inference_mode():
            for _ in range(self.config.learner.steps):
                action = self.ppo.act(self.observations)
                step = self.batch.step(action.cpu().numpy())
                self.batch.advance_curriculum()
                self.observations = views(step.observation, step.privileged, device)
                done = torch.from_numpy(step.terminated | step.truncated).to(device)
                time_outs = {"time_outs": torch.from_numpy(step.truncated).to(device)}
                self.ppo.process_env_step(self.observations, torch.from_numpy(step.reward).to(device), done, time_outs)
                _collect(figures, step, self.batch)
            collected = time.monotonic()
            self.ppo.compute_returns(self.observations)
        self.batch.curriculum = Curriculum(**self.ranks.mean(vars(self.batch.curriculum)))
        if self.mirror is not None:
            self.mirror(self.ppo)
        self.ppo.entropy_coef = self.config.learner.entropy_at(self.progress.samples)
        losses = self.ppo.update()
        self.progress.iteration += 1
        self.progress.samples += self.ranks.count * self.config.copies * self.config.learner.steps
        result = {name: float(np.mean(values)) for name, values in figures.items()}
        result |= {f"loss/{name}": float(value) for name, value in losses.items()}
        curriculum = self.batch.curriculum
        result |= {
            "policy/std": float(self.ppo.get_policy().output_std.detach().mean()),
            "policy/learning_rate": self.ppo.learning_rate,
            "episode/length_s": curriculum.mean_length * 0.02,
            "curriculum/penalty": curriculum.penalty,
            "curriculum/kick": curriculum.kick,
            "speed/collect_s": collected - began,
            "speed/learn_s": time.monotonic() - collected,
        }
        result = self.ranks.mean(result)
        result["physics/diverged"] *= self.ranks.count  # a number of copies
        return result

    def step_untaught(self) -> WalkStep:
        """A step of the robots from which nothing is learned."""
        with torch.inference_mode():
            action = self.ppo.get_policy()(self.observations, stochastic_output=True)
            step = self.batch.step(action.cpu().numpy())
            self.observations = views(step.observation, step.privileged, self.ranks.device)
        return step

    def reward_table(self, steps: int = 8) -> Table:
        """Shares of the reward terms under the untrained policy, to catch a term that drowns the others."""
        sums: dict[str, float] = defaultdict(float)
        for _ in range(steps):
            for name, share in self.step_untaught().shares.items():
                sums[name] += float(share.mean()) / steps
        whole = sum(abs(value) for value in sums.values()) or 1.0
        table = Table(title="Reward terms at the start", title_justify="left")
        for column in ("term", "weight", "per second", "share"):
            table.add_column(column, justify="left" if column == "term" else "right")
        for name, value in sums.items():
            weight = self.config.walk.rewards[name]
            table.add_row(name, f"{weight:g}", f"{value:+.3f}", f"{abs(value) / whole:.0%}")
        return table


def _collect(figures: dict[str, list[float]], step: WalkStep, batch: WalkBatch) -> None:
    """Gather the figures of a step."""
    figures["episode/reward"].append(float(step.reward.mean()) / 0.02)
    figures["episode/falls_per_min"].append(float(step.terminated.mean()) * 3000.0)
    error = batch.state.mean_velocity - batch.state.command
    figures["error/velocity"].append(float(np.linalg.norm(error[:, :2], axis=1).mean()))
    figures["error/yaw_rate"].append(float(np.abs(error[:, 2]).mean()))
    figures["physics/diverged"].append(float(batch.physics.diverged.sum()))
    for name, share in step.shares.items():
        figures[f"reward/{name}"].append(float(share.mean()))


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
