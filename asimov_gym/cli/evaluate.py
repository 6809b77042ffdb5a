"""`asimov eval`: how good a policy is, by a suite of scenarios, alone or beside another policy."""

from __future__ import annotations

import re
import sys
from dataclasses import asdict, dataclass
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import tyro

if TYPE_CHECKING:
    from rich.console import Console

    from asimov_gym.evaluation.results import SuiteResult
    from asimov_gym.evaluation.suite import Suite

_STOPPED = 130


@dataclass(frozen=True)
class Evaluate:
    """Judge a policy by a suite: velocity tracking, standing, pushes, ground, delays. Stopped runs can be continued."""

    policy: tyro.conf.Positional[Path | None] = None
    """ONNX file; the shipped policy when omitted."""
    suite: str = "quick"
    """Name of a suite, or a YAML file with one; `--suites` lists the names."""
    rows: Path | None = None
    """Run the rows of this file, in the format of the robot maker's benchmark, instead of a suite."""
    out: Path | None = None
    """Run folder: results as they come, then the report; `runs/` with date, policy and suite when omitted."""
    resume: bool = False
    """Continue the run in `--out`."""
    repeats: int | None = None
    """Repeats of every scenario, instead of the suite's own."""
    threads: int | None = None
    """Physics threads; as many as the machine has cores when omitted."""
    compare: tuple[Path, Path] | None = None
    """Two policies, or run folders of policies that were judged, to be put side by side."""
    allow_different: bool = False
    """Also compare results of different suites, where they have trials in common."""
    require_pass: bool = False
    """Exit with 1 when a bar is missed."""
    suites: bool = False
    """List the suites and end."""

    def run(self) -> int:
        from rich.console import Console

        console = Console(soft_wrap=True)
        try:
            if self.suites:
                return _list_suites(console)
            self._check()
            if self.compare is not None:
                return self._run_comparison(console, *self.compare)
            return self._run_one(console)
        except (FileNotFoundError, ModuleNotFoundError, ValueError) as error:
            print(f"asimov eval: {error}", file=sys.stderr)
            return 2

    def _check(self) -> None:
        if self.resume and self.out is None:
            raise ValueError("--resume needs --out, the folder of the run to continue")
        if self.repeats is not None and not 1 <= self.repeats <= 10_000:
            raise ValueError(f"--repeats must lie in [1, 10000], got {self.repeats}")
        if self.threads is not None and self.threads < 1:
            raise ValueError(f"--threads must be at least 1, got {self.threads}")
        if self.compare is not None and self.policy is not None:
            raise ValueError("--compare names both policies; leave out the policy before it")

    def _suite(self) -> Suite:
        from asimov_gym.evaluation.suite import load_suite, suite_of_rows

        if self.rows is not None:
            return suite_of_rows(self.rows, self.repeats or 5)
        suite = load_suite(self.suite)
        return suite if self.repeats is None else suite.with_repeats(self.repeats)

    def _run_one(self, console: Console) -> int:
        from asimov_gym.assets import asset_path
        from asimov_gym.evaluation.bars import judge
        from asimov_gym.evaluation.report import summary, write_report

        suite = self._suite()
        file = self.policy or asset_path("policies", "asimov_walk.onnx")
        folder = self.out or _new_folder(file.stem, suite.name)
        result = self._measure(console, file, suite, folder, self.resume)
        if result is None:
            return _STOPPED
        page = write_report(result, folder)
        console.print(summary(result), highlight=False, markup=False)
        console.print(f"\nreport: {page}", highlight=False, markup=False)
        missed = any(bar.verdict == "missed" and not bar.aim for bar in judge(result))
        return 1 if self.require_pass and missed else 0

    def _measure(self, console: Console, file: Path, suite: Suite, folder: Path, resume: bool) -> SuiteResult | None:
        """The result of a policy; None where it was stopped."""
        from asimov_gym.cli.machine import Machine
        from asimov_gym.evaluation.runner import SuiteRun
        from asimov_gym.policy import load_policy

        machine = asdict(Machine.this())
        machine.pop("packages")
        policy = load_policy(file)
        run = SuiteRun(policy, suite, folder, resume=resume, threads=self.threads, machine=machine)
        try:
            with _Bars(console) as bars:
                return run.execute(bars.show)
        except KeyboardInterrupt:
            run.result().save(folder)
            console.print(f"stopped; continue with:  {self._again(file, folder)}", highlight=False, markup=False)
            return None

    def _again(self, file: Path, folder: Path) -> str:
        flags = f"--rows {self.rows}" if self.rows is not None else f"--suite {self.suite}"
        if self.repeats is not None:
            flags += f" --repeats {self.repeats}"
        if self.compare is not None:
            return f"asimov eval --compare {self.compare[0]} {self.compare[1]} {flags} --out {folder.parent} --resume"
        return f"asimov eval {file} {flags} --out {folder} --resume"

    def _run_comparison(self, console: Console, first: Path, second: Path) -> int:
        from asimov_gym.evaluation.compare import compare, write_comparison
        from asimov_gym.evaluation.report import write_report
        from asimov_gym.evaluation.results import SuiteResult

        folder = self.out or _new_folder(f"{first.stem}_and_{second.stem}", "compare")
        results: list[SuiteResult] = []
        for place, path in (("first", first), ("second", second)):
            if path.suffix != ".onnx":
                results.append(SuiteResult.load(path))
                continue
            part = folder / place
            console.print(f"{place}: {path}", highlight=False, markup=False)
            result = self._measure(console, path, self._suite(), part, self.resume and (part / "run.json").is_file())
            if result is None:
                return _STOPPED
            write_report(result, part)
            results.append(result)
        comparison = compare(results[0], results[1], allow_different=self.allow_different)
        page = write_comparison(comparison, folder)
        console.print(comparison.table().markdown(), highlight=False, markup=False)
        console.print(f"\nreport: {page}", highlight=False, markup=False)
        return 0


class _Bars:
    """Progress by stage: bars on a terminal, else a line for every tenth."""

    def __init__(self, console: Console) -> None:
        from rich.progress import Progress

        from asimov_gym.evaluation.progress import PrintedProgress

        self._lines = PrintedProgress(10, lambda line: console.print(line, highlight=False))
        self._bars = Progress(console=console, transient=True) if console.is_terminal else None
        self._tasks: dict[str, Any] = {}

    def __enter__(self) -> _Bars:
        if self._bars is not None:
            self._bars.start()
        return self

    def __exit__(self, *exception: object) -> None:
        if self._bars is not None:
            self._bars.stop()

    def show(self, stage: str, done: float, whole: float) -> None:
        """How far a stage is, robot-seconds."""
        if self._bars is None:
            self._lines(stage, done, whole)
            return
        if stage not in self._tasks:
            self._tasks[stage] = self._bars.add_task(stage, total=whole)
        self._bars.update(self._tasks[stage], completed=done)


def _list_suites(console: Console) -> int:
    from asimov_gym.evaluation.suite import load_suite, suite_names

    suites = sorted((load_suite(name) for name in suite_names()), key=lambda suite: suite.robot_seconds)
    for suite in suites:
        searches = f" and {len(suite.push_limits)} push limits" if suite.push_limits else ""
        console.print(
            f"{suite.name:<9} {suite.description}\n"
            f"          {len(suite.scenarios)} scenarios, {len(suite.trials)} trials, "
            f"{_robot_time(suite.robot_seconds)}{searches}",
            highlight=False,
            markup=False,
        )
    return 0


def _robot_time(seconds: float) -> str:
    return f"{seconds:.0f} robot-seconds" if seconds < 3600.0 else f"{seconds / 3600.0:.1f} robot-hours"


def _new_folder(*words: str) -> Path:
    name = re.sub(r"[^A-Za-z0-9_.-]+", "_", "_".join(("eval", *words)))
    return Path("runs") / f"{datetime.now():%Y-%m-%d_%H-%M-%S}_{name}"
