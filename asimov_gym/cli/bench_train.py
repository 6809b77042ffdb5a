"""`asimov bench train`: samples per second of training, learning included, as a share of the bare physics."""

from __future__ import annotations

import importlib.util
import sys
import tempfile
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from statistics import median

from asimov_gym.cli.bench_env import warn_if_busy, write_json
from asimov_gym.cli.machine import cores, peak_memory_mb

WARM_UP = 2
"""Rounds before anything is measured."""
TAPE = 8
"""Policy steps on which the bare physics is measured, beside each round."""


@dataclass(frozen=True)
class TrainingSpeed:
    """Rounds of collecting and learning; medians."""

    copies: int
    samples: int
    """Of a round."""
    samples_per_s: float
    physics_steps_per_s: float
    """Environment steps per second where only the bare engine runs."""
    share: float
    """Samples per second over that, each time measured one after the other."""
    spread: float
    """Largest less smallest share of the rounds."""
    collect_s: float
    """Of a round: physics, environment and the networks' answers."""
    physics_s: float
    """The part of it that the bare physics would take."""
    learn_s: float
    """Of a round: the update of the networks."""
    peak_memory_mb: float | None


@dataclass(frozen=True)
class BenchTrain:
    """Measure training on C physics with a preset, from its start, against the bare physics on the same robots.

    Exit code 0 when it was measured, 2 when it could not be tried.
    """

    preset: str = "laptop"
    """Preset of `python -m train ppo`."""
    copies: int | None = None
    """Robots simulated together; the preset's by default."""
    threads: int | None = None
    """Threads of physics and learning; one for each core by default."""
    rounds: int = 7
    """Rounds of collecting and learning that are measured."""
    json: Path | None = None
    """Write the figures and what machine this is to this file, or into this folder under the machine's name."""

    def run(self) -> int:
        """Measure, print a table."""
        for package in ("torch", "rsl_rl", "tensorboard"):
            if importlib.util.find_spec(package) is None:
                return _refuse(f"{package} is not installed, which training needs: pip install 'asimov-gym[train]'")
        for name in ("copies", "threads", "rounds"):
            value = getattr(self, name)
            if value is not None and value < 1:
                return _refuse(f"--{name} must be at least 1, got {value}")
        load = warn_if_busy("train")
        try:
            speed = self.speed()
        except ValueError as error:
            return _refuse(str(error))
        _print(speed, self.preset)
        settings = {"preset": self.preset, "threads": self.threads or cores(), "rounds": self.rounds}
        write_json(self.json, "train", load, settings, {"training": asdict(speed)})
        return 0

    def speed(self) -> TrainingSpeed:
        """Measure.

        Raises:
            ValueError: the preset is unknown, or does not go with so few copies.
        """
        import torch

        from asimov_gym.cli.bench_subjects import RawPhysics
        from asimov_gym.envs.walk_batch import WalkBatch
        from train.config import load_preset
        from train.ppo import Trainer
        from train.run_folder import RunFolder

        threads = self.threads or cores()
        config = load_preset(self.preset)
        copies = self.copies or config.copies
        config = replace(config, library="rsl_rl", physics="c", copies=copies, threads=threads, device="cpu")
        before = torch.get_num_threads()
        torch.set_num_threads(threads)
        rounds: list[tuple[float, float, float]] = []
        with tempfile.TemporaryDirectory(prefix="asimov-bench-") as folder:
            trainer = Trainer(config, RunFolder.create(Path(folder), self.preset, config))
            for _ in range(WARM_UP):
                trainer.iterate()
            batch = trainer.batch
            assert isinstance(batch, WalkBatch)  # as on C physics
            raw = RawPhysics(batch, threads)
            for _ in range(self.rounds):
                figures = trainer.iterate()
                bare = raw.seconds(raw.record(TAPE, trainer.step_untaught))
                rounds.append((figures["speed/collect_s"], figures["speed/learn_s"], bare / TAPE))
            raw.close()
            trainer.batch.close()
        torch.set_num_threads(before)
        steps, samples = config.learner.steps, config.copies * config.learner.steps
        shares = [bare * steps / (collect + learn) for collect, learn, bare in rounds]
        return TrainingSpeed(
            copies=config.copies,
            samples=samples,
            samples_per_s=median(samples / (collect + learn) for collect, learn, _ in rounds),
            physics_steps_per_s=median(config.copies / bare for *_, bare in rounds),
            share=median(shares),
            spread=max(shares) - min(shares),
            collect_s=median(collect for collect, *_ in rounds),
            physics_s=median(bare * steps for *_, bare in rounds),
            learn_s=median(learn for _, learn, _ in rounds),
            peak_memory_mb=peak_memory_mb(),
        )


def _refuse(words: str) -> int:
    print(f"asimov bench train: {words}", file=sys.stderr)
    return 2


def _print(speed: TrainingSpeed, preset: str) -> None:
    from rich.console import Console
    from rich.table import Table

    title = f"Training with preset {preset}: {speed.copies} copies, {speed.samples:,} samples a round"
    table = Table(box=None, pad_edge=False, title=title, title_justify="left")
    table.add_column("")
    table.add_column("", justify="right")
    table.add_column("")
    around = speed.collect_s - speed.physics_s
    table.add_row("training", f"{speed.samples_per_s:,.0f}", "samples per second, learning included")
    table.add_row("bare physics", f"{speed.physics_steps_per_s:,.0f}", "environment steps per second")
    table.add_row("share", f"{speed.share:.3f}", f"± {speed.spread / 2:.3f}")
    table.add_row("a round", f"{speed.physics_s:.2f} s", "bare physics")
    table.add_row("", f"{around:.2f} s", "environment around it, and the networks' answers")
    table.add_row("", f"{speed.learn_s:.2f} s", "learning")
    if speed.peak_memory_mb is not None:
        table.add_row("memory", f"{speed.peak_memory_mb:,.0f} MB", "at most")
    Console().print(table, highlight=False)
