"""Running a suite: trials packed into rollouts, results on the disk as they come, traces, push limits."""

from __future__ import annotations

import os
import platform
import re
import time
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from asimov_gym.evaluation.journal import TRACES_FOLDER, Journal
from asimov_gym.evaluation.metrics import trial_metrics
from asimov_gym.evaluation.push_limits import PushLimitSearch, find_push_limits
from asimov_gym.evaluation.pushes import push_outcomes
from asimov_gym.evaluation.results import SKIPPED, PushLimit, SuiteResult, TrialResult
from asimov_gym.evaluation.rollout import DT, ROW_BYTES, Trace, roll_out, shared_conditions
from asimov_gym.evaluation.scenario import Trial
from asimov_gym.evaluation.suite import Suite
from asimov_gym.evaluation.tracking import gait_period
from asimov_gym.policy import Policy, PolicyContract
from asimov_gym.policy.contract import DEFAULT_REVISION
from asimov_gym.robot.model import model_sha256
from asimov_gym.versions import installed_versions

MAX_BATCH_BYTES = 128e6
"""Of a rollout's record. The more robots, the better the cores are used; the fewer, the less is lost by a stop."""
SCENARIOS, PUSH_LIMITS = "scenarios", "push limits"
"""Stages of a run."""
RunProgress = Callable[[str, float, float], None]
"""Called with the stage, the robot-seconds simulated and those in all; for push limits the latter is the most."""
_PACKAGES = ("asimov-gym", "mujoco", "numpy", "onnxruntime", "jax", "mujoco-mjx")


class SuiteRun:
    """One policy's way through one suite.

    Args:
        policy: the network.
        suite: what it is asked.
        folder: run folder; nothing is kept on disk when None.
        resume: continue the run in the folder.
        threads: physics threads; the machine's cores when None.
        machine: description of the machine for the result; a short one when None.

    Raises:
        asimov_gym.evaluation.journal.RunFolderError: the folder does not fit.
    """

    def __init__(
        self,
        policy: Policy,
        suite: Suite,
        folder: Path | None = None,
        *,
        resume: bool = False,
        threads: int | None = None,
        machine: Mapping[str, Any] | None = None,
    ) -> None:
        self.suite = suite
        self._policy, self._threads = policy, threads
        self._header: dict[str, Any] = {
            "suite": suite.name,
            "suite_hash": suite.hash,
            "policy_name": getattr(policy, "name", "") or type(policy).__name__,
            "policy_hash": getattr(policy, "sha256", ""),
            "started": datetime.now(UTC).isoformat(timespec="seconds"),
            "wall_clock_s": 0.0,
        }
        self._machine = dict(machine) if machine is not None else _machine()
        self._journal = None if folder is None else Journal(folder, self._header, resume)
        if self._journal is not None:
            self._header = self._journal.header
        self._trials: dict[tuple[str, int], TrialResult] = {} if self._journal is None else self._journal.trials
        self._pushes: dict[tuple[str, float, int], bool] = {} if self._journal is None else self._journal.pushes
        self._skipped: dict[tuple[str, int], TrialResult] = {}
        self._limits: tuple[PushLimit, ...] | None = () if not suite.push_limits else None
        self._since = time.monotonic()

    # -- running -------------------------------------------------------------------------------------------------------

    def execute(self, progress: RunProgress | None = None) -> SuiteResult:
        """Run whatever is not finished yet.

        It may be stopped by any exception, such as KeyboardInterrupt: what is finished stays, `result` tells it, and a
        run folder can be continued.
        """
        self._since = time.monotonic()
        try:
            self._run_scenarios(progress)
            self._run_push_limits(progress)
        finally:
            self._note_time()
            if self._journal is not None:
                self._journal.close()
        return self.result()

    def result(self) -> SuiteResult:
        """What is known so far."""
        known = {**self._skipped, **self._trials}
        order = [known.get((trial.scenario.id, trial.repeat)) for trial in self.suite.trials]
        trials = tuple(result for result in order if result is not None)
        return SuiteResult(
            suite=self.suite.name,
            suite_hash=self.suite.hash,
            policy_name=self._header["policy_name"],
            policy_hash=self._header["policy_hash"],
            contract=contract_summary(self._policy.contract),
            machine=self._machine,
            versions=_versions(),
            started=self._header["started"],
            wall_clock_s=self._header["wall_clock_s"],
            scenarios=tuple(scenario.info() for scenario in self.suite.scenarios),
            trials=trials,
            push_limits=self._limits or (),
            complete=len(trials) == len(order) and self._limits is not None,
            traces=self._traces(),
        )

    def _run_scenarios(self, progress: RunProgress | None) -> None:
        whole = self.suite.robot_seconds
        left = [trial for trial in self.suite.trials if (trial.scenario.id, trial.repeat) not in self._trials]
        done = whole - sum(trial.scenario.duration_s for trial in left)
        report = None if progress is None else (lambda seconds: progress(SCENARIOS, seconds, whole))
        if report is not None and whole:
            report(done)
        for batch in batches(left):
            results = self._run_batch(batch, report, done)
            done += sum(trial.scenario.duration_s for trial in batch)
            # What this machine cannot run is not kept: a continued run tries it again.
            self._skipped |= {(r.scenario, r.repeat): r for r in results if not r.was_run}
            ran = [r for r in results if r.was_run]
            if self._journal is not None:
                self._journal.add_trials(ran)
            else:
                self._trials |= {(r.scenario, r.repeat): r for r in ran}
            self._note_time()
            if report is not None:
                report(done)

    def _run_batch(
        self, batch: Sequence[Trial], report: Callable[[float], None] | None, done: float
    ) -> list[TrialResult]:
        try:
            trace = self._roll_out(batch, report, done)
        except ModuleNotFoundError as error:
            return [_not_run(trial, f"{SKIPPED}{error}") for trial in batch]
        except ValueError as error:  # the contract, or a condition, does not fit
            return [_not_run(trial, str(error)) for trial in batch]
        self._keep_traces(trace, batch)
        period = gait_period(self._policy.contract.gait_frequency_hz)
        return [_trial_result(trace, i, trial, period) for i, trial in enumerate(batch)]

    def _roll_out(self, batch: Sequence[Trial], report: Callable[[float], None] | None, done: float) -> Trace:
        stepped = 0

        def count(robots: int) -> None:
            nonlocal stepped
            stepped += robots
            if report is not None:
                report(done + stepped * DT)

        return roll_out(self._policy, batch, threads=self._threads, progress=count)

    # -- push limits ---------------------------------------------------------------------------------------------------

    def _run_push_limits(self, progress: RunProgress | None) -> None:
        searches = self.suite.push_limits
        if not searches:
            return
        # One more than the rounds: at first it is tried whether the robot stays up without a push.
        whole = sum(s.scenario(0.0).duration_s * s.repeats * (s.rounds + 1) for s in searches)
        report = None if progress is None else (lambda seconds: progress(PUSH_LIMITS, seconds, whole))
        done = 0.0

        def survives(forces: Sequence[tuple[PushLimitSearch, float]]) -> list[bool]:
            nonlocal done
            self._try_pushes(forces, report, done)
            done += sum(search.scenario(force).duration_s * search.repeats for search, force in forces)
            return [all(self._pushes[search.id, force, r] for r in range(search.repeats)) for search, force in forces]

        self._limits = find_push_limits(searches, survives)
        if report is not None:
            report(whole)

    def _try_pushes(
        self, forces: Sequence[tuple[PushLimitSearch, float]], report: Callable[[float], None] | None, done: float
    ) -> None:
        asked = {
            (search.id, force, repeat): Trial.of(search.scenario(force), repeat, self.suite.seed)
            for search, force in forces
            for repeat in range(search.repeats)
        }
        left = {key: trial for key, trial in asked.items() if key not in self._pushes}
        keys = {id(trial): key for key, trial in left.items()}
        for batch in batches(list(left.values())):
            trace = self._roll_out(batch, report, done)
            done += sum(trial.scenario.duration_s for trial in batch)
            survived = [(*keys[id(trial)], bool(trace.survived[i])) for i, trial in enumerate(batch)]
            if self._journal is not None:
                self._journal.add_pushes(survived)
            else:
                self._pushes |= {(search, force, repeat): up for search, force, repeat, up in survived}
            self._note_time()

    # -- the run folder ------------------------------------------------------------------------------------------------

    def _keep_traces(self, trace: Trace, batch: Sequence[Trial]) -> None:
        if self._journal is None:
            return
        for i, trial in enumerate(batch):
            if trial.repeat == 0 and trial.scenario.id in self.suite.traces:
                path = self._journal.folder / _trace_file(trial.scenario.id)
                path.parent.mkdir(exist_ok=True)
                trace.save(path, i)

    def _traces(self) -> dict[str, str]:
        if self._journal is None:
            return {}
        files = {name: _trace_file(name) for name in self.suite.traces}
        return {name: file for name, file in files.items() if (self._journal.folder / file).is_file()}

    def _note_time(self) -> None:
        now = time.monotonic()
        self._header["wall_clock_s"] = round(self._header["wall_clock_s"] + now - self._since, 2)
        self._since = now
        if self._journal is not None:
            self._journal.save_header()


def run_suite(
    policy: Policy,
    suite: Suite,
    folder: Path | None = None,
    *,
    resume: bool = False,
    threads: int | None = None,
    progress: RunProgress | None = None,
) -> SuiteResult:
    """Run a suite to its end; the arguments are those of `SuiteRun` and `SuiteRun.execute`."""
    return SuiteRun(policy, suite, folder, resume=resume, threads=threads).execute(progress)


def batches(trials: Sequence[Trial]) -> list[list[Trial]]:
    """Trials in packs that can share a rollout and fit into memory, long trials first."""
    groups: dict[tuple[object, ...], list[Trial]] = {}
    for trial in trials:
        groups.setdefault(shared_conditions(trial), []).append(trial)
    packed: list[list[Trial]] = []
    for group in groups.values():
        group.sort(key=lambda trial: -trial.scenario.steps)
        while group:
            size = max(1, int(MAX_BATCH_BYTES / (ROW_BYTES * group[0].scenario.steps)))
            packed.append(group[:size])
            del group[:size]
    return packed


def contract_summary(contract: PolicyContract) -> dict[str, Any]:
    """What a reader of a result wants to know of a policy."""
    return {
        "layout": contract.observation.layout,
        "policy_rate_hz": contract.policy_rate_hz,
        "gait_frequency_hz": contract.gait_frequency_hz,
        "command_ranges": {
            axis: list(pair) for axis, pair in zip(("vx", "vy", "wz"), contract.command_ranges, strict=True)
        },
        "robot_revision": contract.robot_revision,
        "model_sha256": contract.model_sha256,
        "trained_commit": contract.trained_commit,
        "training": None if contract.training is None else dict(contract.training),
    }


def _trial_result(trace: Trace, i: int, trial: Trial, period_s: float) -> TrialResult:
    end, error = trace.end_s(i), trace.errors[i]
    return TrialResult(
        scenario=trial.scenario.id,
        config=trial.scenario.config,
        repeat=trial.repeat,
        seed=trial.seed,
        delay_ms=trial.delay_ms,
        survived=bool(trace.survived[i]),
        fall_s=None if error is not None or end is None else round(end, 3),
        events=push_outcomes(trial.scenario.pushes, end),
        metrics=trial_metrics(trace, i, trial.scenario, period_s),
        error=error,
    )


def _not_run(trial: Trial, reason: str) -> TrialResult:
    """The trial as failed at once."""
    return TrialResult(
        scenario=trial.scenario.id,
        config=trial.scenario.config,
        repeat=trial.repeat,
        seed=trial.seed,
        delay_ms=trial.delay_ms,
        survived=False,
        fall_s=None,
        events=push_outcomes(trial.scenario.pushes, 0.0),
        metrics={},
        error=reason,
    )


def _trace_file(scenario: str) -> str:
    return f"{TRACES_FOLDER}/{re.sub(r'[^A-Za-z0-9_+.-]+', '_', scenario)}.npz"


def _machine() -> dict[str, Any]:
    return {"system": platform.system(), "machine": platform.machine(), "cores": os.cpu_count()}


def _versions() -> dict[str, str]:
    versions = {"robot model": f"{DEFAULT_REVISION} {model_sha256(*DEFAULT_REVISION.split('/'))[:12]}"}
    versions["python"] = platform.python_version()
    return versions | installed_versions(_PACKAGES)
