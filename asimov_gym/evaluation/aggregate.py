"""From trials to tables: survival with Wilson intervals, means with bootstrap intervals, pushes by tier, failed rows.

Nothing is dropped on the way: a trial that could not be run counts as not survived, and one that is missing is listed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from asimov_gym.evaluation.intervals import Mean, Share, bootstrap_mean
from asimov_gym.evaluation.metrics import METRICS
from asimov_gym.evaluation.results import PushOutcome, ScenarioInfo, SuiteResult, Tier, TrialResult


@dataclass(frozen=True)
class Group:
    """Scenarios that are judged together: one alone, a category, or what a bar asks about."""

    name: str
    scenarios: tuple[ScenarioInfo, ...]
    trials: tuple[TrialResult, ...]
    """Those that were run."""
    skipped: tuple[TrialResult, ...] = ()
    """Those that this machine could not run."""

    @property
    def planned(self) -> int:
        """Trials that the suite asks for."""
        return sum(info.repeats for info in self.scenarios)

    @property
    def is_complete(self) -> bool:
        """Whether every trial was run."""
        return len(self.trials) >= self.planned > 0

    @property
    def survival(self) -> Share:
        """Trials without a fall, of those run."""
        return Share(sum(trial.survived for trial in self.trials), len(self.trials))

    @property
    def errors(self) -> int:
        """Trials that could not be run to their end."""
        return sum(trial.error is not None for trial in self.trials)

    def values(self, metric: str) -> list[list[float]]:
        """A figure of the trials that have it, by scenario."""
        by_scenario: dict[str, list[float]] = {info.id: [] for info in self.scenarios}
        for trial in self.trials:
            value = trial.metrics.get(metric)
            if value is not None:
                by_scenario[trial.scenario].append(value)
        return list(by_scenario.values())

    def mean(self, metric: str) -> Mean | None:
        """Mean of a figure over the trials that have it, with its 95 % interval."""
        return bootstrap_mean(self.values(metric))

    def mean_value(self, metric: str) -> float | None:
        """The mean alone."""
        values = [value for group in self.values(metric) for value in group]
        return sum(values) / len(values) if values else None

    def largest(self, metric: str) -> float | None:
        """Largest value of a figure."""
        return max((value for group in self.values(metric) for value in group), default=None)

    @cached_property
    def metrics(self) -> tuple[str, ...]:
        """The figures of `METRICS` that some trial has."""
        return tuple(name for name in METRICS if any(trial.metrics.get(name) is not None for trial in self.trials))


def select(result: SuiteResult, name: str, wanted: Callable[[ScenarioInfo], bool]) -> Group:
    """The scenarios that a predicate accepts."""
    scenarios = tuple(info for info in result.scenarios if wanted(info))
    known = {info.id for info in scenarios}
    return _group(name, scenarios, [trial for trial in result.trials if trial.scenario in known])


def _group(name: str, scenarios: tuple[ScenarioInfo, ...], trials: Iterable[TrialResult]) -> Group:
    ran: list[TrialResult] = []
    skipped: list[TrialResult] = []
    for trial in trials:
        (ran if trial.was_run else skipped).append(trial)
    return Group(name, scenarios, tuple(ran), tuple(skipped))


def by_scenario(result: SuiteResult) -> list[Group]:
    """One group for each scenario, in the suite's order."""
    trials: dict[str, list[TrialResult]] = {info.id: [] for info in result.scenarios}
    for trial in result.trials:
        trials[trial.scenario].append(trial)
    return [_group(info.id, (info,), trials[info.id]) for info in result.scenarios]


def by_config(result: SuiteResult) -> list[Group]:
    """One group for each category, in the suite's order."""
    configs = dict.fromkeys(info.config for info in result.scenarios)
    return [select(result, config, lambda info, config=config: info.config == config) for config in configs]


# -- pushes ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class PushRow:
    """One push of a scenario over all repeats."""

    scenario: str
    config: str
    push: PushOutcome
    """As it was asked; its outcome is that of the first repeat."""
    outcomes: Share
    """Repeats that passed. A push that was skipped because the robot lay on the ground is not passed."""

    @property
    def passed(self) -> bool:
        """A row passes only if all its repeats do."""
        return 0 < self.outcomes.whole == self.outcomes.passed


def push_rows(result: SuiteResult) -> list[PushRow]:
    """Every push of every scenario, in order of time. Repeats with an error before the push count as not passed."""
    rows: list[PushRow] = []
    for group in by_scenario(result):
        events = next((trial.events for trial in group.trials if trial.events), ())
        for place, push in enumerate(events):
            passed = sum(len(t.events) > place and t.events[place].outcome == "passed" for t in group.trials)
            rows.append(PushRow(group.name, group.scenarios[0].config, push, Share(passed, len(group.trials))))
    return rows


@dataclass(frozen=True)
class PushTally:
    """Pushes of a category and tier."""

    config: str
    tier: Tier | None
    trials: Share
    """Single pushes that were passed: `push_pass_rate` of the robot maker's benchmark."""
    rows: Share
    """Rows of which every repeat passed."""
    max_force_survived_n: float | None
    """Largest force of a row that passed; None where none did."""


def push_tallies(rows: Iterable[PushRow]) -> list[PushTally]:
    """Pass rates by category and tier."""
    groups: dict[tuple[str, Tier | None], list[PushRow]] = {}
    for row in rows:
        groups.setdefault((row.config, row.push.tier), []).append(row)
    return [
        PushTally(
            config,
            tier,
            Share(sum(row.outcomes.passed for row in group), sum(row.outcomes.whole for row in group)),
            Share(sum(row.passed for row in group), len(group)),
            max((row.push.force for row in group if row.passed), default=None),
        )
        for (config, tier), group in groups.items()
    ]


@dataclass(frozen=True)
class VendorFigures:
    """The figures of the robot maker's benchmark, for one category."""

    config: str
    upright_rate: float
    """Trials that ended upright."""
    push_pass_rate: float | None
    max_force_survived_n: float | None
    velocity_rmse_m_s: float | None
    drift_final_m: float | None


def vendor_figures(result: SuiteResult) -> list[VendorFigures]:
    """Figures in the terms of the robot maker's benchmark, by category; of categories with a trial."""
    rows = push_rows(result)
    figures = []
    for group in by_config(result):
        upright = group.survival.value
        if upright is None:
            continue
        mine = [row for row in rows if row.config == group.name]
        single = Share(sum(row.outcomes.passed for row in mine), sum(row.outcomes.whole for row in mine))
        figures.append(
            VendorFigures(
                group.name,
                upright,
                single.value,
                max((row.push.force for row in mine if row.passed), default=None),
                group.mean_value("velocity_rmse_m_s"),
                group.mean_value("drift_final_m"),
            )
        )
    return figures


# -- what went wrong -------------------------------------------------------------------------------


@dataclass(frozen=True)
class Failure:
    """A trial that did not pass, or is missing, and why."""

    scenario: str
    repeat: int
    seed: int | None
    delay_ms: float | None
    reason: str


def failures(result: SuiteResult) -> list[Failure]:
    """Every trial that fell, failed a push, could not be run or was not run, in the suite's order."""
    listed: list[Failure] = []
    for group in by_scenario(result):
        trials = {trial.repeat: trial for trial in (*group.trials, *group.skipped)}
        for repeat in range(group.scenarios[0].repeats):
            trial = trials.get(repeat)
            if trial is None:
                listed.append(Failure(group.name, repeat, None, None, "not run"))
            elif (reason := failure_reason(trial)) is not None:
                listed.append(Failure(group.name, repeat, trial.seed, trial.delay_ms, reason))
    return listed


def failure_reason(trial: TrialResult) -> str | None:
    """Why a trial did not pass; None where it did."""
    if trial.error is not None:
        return trial.error
    lost = next((push for push in trial.events if push.outcome == "failed"), None)
    after = "" if lost is None else f", after the push {lost.label or lost.body} of {lost.force:g} N at {lost.at_s:g} s"
    if not trial.survived:
        return ("fell" if trial.fall_s is None else f"fell at {trial.fall_s:.2f} s") + after
    return None if lost is None else "failed" + after.removeprefix(", after")


def worst_joint(metrics: Mapping[str, float | None] | Sequence[Mapping[str, float | None]], name: str) -> str | None:
    """The joint with the largest of a joint's figures, such as `torque_peak_share`; over one trial or several."""
    several = [metrics] if isinstance(metrics, Mapping) else metrics
    found = [
        (value, key.partition("/")[2])
        for one in several
        for key, value in one.items()
        if key.startswith(f"{name}/") and value is not None
    ]
    return max(found)[1] if found else None
