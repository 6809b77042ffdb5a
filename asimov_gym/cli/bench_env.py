"""`asimov bench env`: speed of the walking environment as a share of the bare physics under it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from typing import Any, Literal

from asimov_gym.cli.machine import BUSY, Machine, cores, load_average, peak_memory_mb

NAMES = ("batch", "gym", "jax-c", "jax-mjx", "jax-warp")
"""Environments that can be measured; see `ENVIRONMENTS`."""
ENVIRONMENTS = {
    "batch": "trainer, C physics",
    "gym": "Gymnasium, C physics",
    "jax-c": "JAX, C physics by callback",
    "jax-mjx": "JAX, MJX",
    "jax-warp": "JAX, MJX on warp",
}
"""What each one is."""
FIRST_STEP_GOAL = 1.5
"""Seconds that the first step may take after the import."""
SECOND_START_GOAL = 0.2
"""The most that a start with kept programs may take, as a share of the first."""
_FIRST_STEP = """
import json, sys, time
began = time.perf_counter()
import gymnasium, asimov_gym
imported = time.perf_counter()
if len(sys.argv) == 1:
    env = gymnasium.make("Asimov-Walk-v0")
else:
    env = gymnasium.make_vec("Asimov-Walk-v0", num_envs=int(sys.argv[2]), physics=sys.argv[1])
env.reset(seed=0)
env.step(env.action_space.sample())
print(json.dumps([imported - began, time.perf_counter() - imported]))
"""
"""What a fresh process does, as a user would; with the engine and the number of copies for a vector environment."""
_CACHE_SETTINGS = ("JAX_COMPILATION_CACHE", "JAX_ENABLE_COMPILATION_CACHE", "JAX_PERSISTENT_CACHE")
_WITH_FIRST_STEP = ("gym", "jax-mjx", "jax-warp")


@dataclass(frozen=True)
class Throughput:
    """An environment at one number of copies."""

    environment: str
    """One of `NAMES`."""
    copies: int
    steps_per_s: float
    """Environment steps, all copies together; median over the repeats."""
    physics_steps_per_s: float
    """The same number where only the bare engine runs."""
    share: float
    """The one over the other, each time measured one after the other; median."""
    spread: float
    """Largest less smallest share of the repeats."""
    compile_s: float | None
    """Of the environment; None where nothing is compiled."""
    peak_memory_mb: float | None
    """The most that the process has held until then."""


@dataclass(frozen=True)
class FirstStep:
    """A fresh process until its first step; medians."""

    import_s: float
    step_s: float
    """From after the import to the end of the first `env.step`: making, resetting and compiling included."""
    cached_s: float | None = None
    """The same in a second process that finds what the first one compiled, median; None where nothing is compiled."""


@dataclass(frozen=True)
class BenchEnv:
    """Measure the walking environment (observation, reward, randomised bodies, noise, kicks, restarts) against the bare
    physics engine on the same models, states and controls, one after the other several times.

    Exit code 0 when all was measured, 2 when something cannot be.
    """

    copies: tuple[int, ...] = (64, 256, 1024)
    """Robots simulated together, ascending."""
    environments: tuple[Literal["batch", "gym", "jax-c", "jax-mjx", "jax-warp"], ...] = ("batch", "gym")
    """What to measure: batch (NumPy, as the trainer uses it), gym (Gymnasium vector environment), jax-c, jax-mjx,
    jax-warp (JAX functions on C physics, MJX, MJX on warp)."""
    threads: int | None = None
    """Physics threads; one for each core by default."""
    steps: int = 20
    """Policy steps of a measurement."""
    repeats: int = 7
    """Measurements of each; the median counts."""
    first_step: bool = True
    """Also time fresh processes until their first step."""
    json: Path | None = None
    """Write the figures and what machine this is to this file, or into this folder under the machine's name."""

    def run(self) -> int:
        """Measure, print a table."""
        for name in ("steps", "repeats"):
            if getattr(self, name) < 1:
                return _refuse(f"--{name} must be at least 1, got {getattr(self, name)}")
        if not self.copies or min(self.copies) < 1:
            return _refuse(f"--copies must be numbers of at least 1, got {list(self.copies)}")
        if self.threads is not None and self.threads < 1:
            return _refuse(f"--threads must be at least 1, got {self.threads}")
        load = warn_if_busy("env")
        rows = []
        for copies in sorted(self.copies):
            for name in self.environments:
                try:
                    rows.append(self.throughput(name, copies))
                except (ModuleNotFoundError, ValueError, MemoryError) as error:
                    return _refuse(f"{name} with {copies} copies: {error or 'the batch does not fit in memory'}")
        timed = [name for name in self.environments if self.first_step and name in _WITH_FIRST_STEP]
        first = {name: self._first(name) for name in timed}
        _print(rows, first)
        settings = {"threads": self._threads(), "steps": self.steps, "repeats": self.repeats, "profile": "training"}
        results = {"throughput": [asdict(row) for row in rows], "first_step": {k: asdict(v) for k, v in first.items()}}
        write_json(self.json, "env", load, settings, results)
        return 0

    def throughput(self, name: str, copies: int) -> Throughput:
        """Measure one environment.

        Raises:
            ModuleNotFoundError: what it needs is not installed.
            ValueError: its engine cannot run here.
        """
        from asimov_gym.cli.bench_subjects import SUBJECTS

        subject = SUBJECTS[name](copies, self._threads(), self.steps)
        try:
            pairs = [
                (subject.environment_seconds(self.steps), subject.physics_seconds(self.steps))
                for _ in range(self.repeats)
            ]
        finally:
            subject.close()
        count, shares = copies * self.steps, [bare / whole for whole, bare in pairs]
        return Throughput(
            environment=name,
            copies=copies,
            steps_per_s=median(count / whole for whole, _ in pairs),
            physics_steps_per_s=median(count / bare for _, bare in pairs),
            share=median(shares),
            spread=max(shares) - min(shares),
            compile_s=subject.compile_seconds,
            peak_memory_mb=peak_memory_mb(),
        )

    def _threads(self) -> int:
        return self.threads or cores()

    def _first(self, name: str) -> FirstStep:
        if name == "gym":
            runs = [_fresh_process() for _ in range(3)]
            return FirstStep(median(imported for imported, _ in runs), median(step for _, step in runs))
        with tempfile.TemporaryDirectory(prefix="asimov-bench-") as cache:
            engine, copies = name.removeprefix("jax-"), str(max(self.copies))
            imported, step = _fresh_process(engine, copies, cache=cache)
            again = median(_fresh_process(engine, copies, cache=cache)[1] for _ in range(3))
        return FirstStep(imported, step, again)


def _fresh_process(*arguments: str, cache: str | None = None) -> tuple[float, float]:
    """Seconds of the import, and from there to the end of the first step."""
    # With the settings of someone who has made none, and an empty cache folder.
    variables = {name: value for name, value in os.environ.items() if not name.startswith(_CACHE_SETTINGS)}
    variables["PYTHONPATH"] = os.pathsep.join(entry or os.getcwd() for entry in sys.path)
    if cache is not None:
        variables["XDG_CACHE_HOME"] = cache
    done = subprocess.run(
        [sys.executable, "-c", _FIRST_STEP, *arguments],
        capture_output=True,
        text=True,
        env=variables,
        check=True,
    )
    imported, step = json.loads(done.stdout.splitlines()[-1])
    return imported, step


def _refuse(words: str) -> int:
    print(f"asimov bench env: {words}", file=sys.stderr)
    return 2


# -- shared with the other benchmarks of throughput --------------------------------------------------------------------


def warn_if_busy(subject: str) -> float | None:
    """The load average; says so where other programs disturb the measurement."""
    load = load_average()
    if load is not None and load > BUSY:
        print(
            f"asimov bench {subject}: other programs keep {load:.1f} cores busy; ratios are rough and speeds low",
            file=sys.stderr,
        )
    return load


def write_json(
    path: Path | None, subject: str, load: float | None, settings: dict[str, Any], results: dict[str, Any]
) -> None:
    """Write figures with the machine they are from; into a folder under the machine's name."""
    if path is None:
        return
    machine = Machine.this()
    if path.is_dir():
        path = path / f"{machine.name}_{subject}.json"
    content = {"subject": subject, "machine": asdict(machine), "load_before": load, "settings": settings, **results}
    path.write_text(json.dumps(_rounded(content), indent=1) + "\n", encoding="utf-8")
    print(f"written: {path}")


def _rounded(value: Any) -> Any:
    """Numbers to four significant digits: more would be noise."""
    if isinstance(value, float):
        return float(f"{value:.4g}")
    if isinstance(value, dict):
        return {key: _rounded(entry) for key, entry in value.items()}
    return [_rounded(entry) for entry in value] if isinstance(value, list | tuple) else value


def _print(rows: Iterable[Throughput], first: dict[str, FirstStep]) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(box=None, pad_edge=False, title="Asimov-Walk-v0, environment steps per second", title_justify="left")
    for column in ("environment", "copies", "env", "bare physics", "share", "±", "compile", "memory"):
        table.add_column(column, justify="left" if column == "environment" else "right")
    for row in rows:
        table.add_row(
            ENVIRONMENTS[row.environment],
            str(row.copies),
            f"{row.steps_per_s:,.0f}",
            f"{row.physics_steps_per_s:,.0f}",
            f"{row.share:.3f}",
            f"{row.spread / 2:.3f}",
            "" if row.compile_s is None else f"{row.compile_s:.1f} s",
            "" if row.peak_memory_mb is None else f"{row.peak_memory_mb:,.0f} MB",
        )
    console = Console()
    console.print(table, highlight=False)
    for name, step in first.items():
        again = f" (goal: {FIRST_STEP_GOAL:g} s)"
        if step.cached_s is not None:
            share = step.cached_s / step.step_s
            again = f", {step.cached_s:.2f} s the second time: {share:.0%} (goal: {SECOND_START_GOAL:.0%})"
        console.print(
            f"first step after the import ({ENVIRONMENTS[name]}): {step.step_s:.2f} s{again}; "
            f"the import {step.import_s:.2f} s",
            highlight=False,
        )
