"""What a walking policy worth shipping must reach, as data, and whether a result reaches it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from asimov_gym.evaluation.aggregate import Group, push_rows, select
from asimov_gym.evaluation.results import ScenarioInfo, SuiteResult, Tier
from asimov_gym.evaluation.table import Table, counted, number, percent
from asimov_gym.evaluation.tracking import SETTLE_S

Verdict = Literal["met", "missed", "not measured"]
Relation = Literal["≥", "≤", "<"]


@dataclass(frozen=True)
class Measured:
    """What a result says about a bar."""

    value: float | None
    """None where the figure could not be had although trials were run, as the drift of a robot that fell."""
    detail: str
    complete: bool = True
    """Whether all trials that the suite asks for are in it."""


@dataclass(frozen=True)
class Bar:
    """One measure and the bound that it must keep."""

    name: str
    relation: Relation
    bound: float
    unit: str
    """`%` for shares, which are 0 to 1 in the value and the bound."""
    measure: Callable[[SuiteResult], Measured | str]
    """From a result; a text where the result does not hold what is needed, saying why."""
    aim: bool = False
    """To be reached as far as possible; missing it does not fail the policy."""

    def judge(self, result: SuiteResult) -> BarResult:
        """Whether a result keeps the bound. One that is not complete can miss a bar, but not meet it."""
        measured = self.measure(result)
        if isinstance(measured, str):
            return BarResult(self.name, None, self.relation, self.bound, self.unit, "not measured", measured, self.aim)
        value = measured.value
        kept = value is not None and (
            value >= self.bound
            if self.relation == "≥"
            else value <= self.bound
            if self.relation == "≤"
            else value < self.bound
        )
        verdict: Verdict = "missed" if not kept else "met" if measured.complete else "not measured"
        detail = measured.detail if measured.complete else f"{measured.detail}, not complete"
        return BarResult(self.name, value, self.relation, self.bound, self.unit, verdict, detail, self.aim)


@dataclass(frozen=True)
class BarResult:
    """A bar, and what a result says about it."""

    name: str
    value: float | None
    relation: Relation
    bound: float
    unit: str
    verdict: Verdict
    detail: str
    aim: bool

    @property
    def shown(self) -> str:
        """The value with its unit."""
        return _shown(self.value, self.unit)

    @property
    def asked(self) -> str:
        """The bound with its unit."""
        return f"{self.relation} {_shown(self.bound, self.unit)}"


def judge(result: SuiteResult) -> list[BarResult]:
    """Every bar of `BARS`."""
    return [bar.judge(result) for bar in BARS]


def bars_table(results: list[BarResult]) -> Table:
    """The bars as a table."""
    rows = tuple(
        (bar.name + (" (aim)" if bar.aim else ""), bar.shown, bar.asked, bar.verdict, bar.detail) for bar in results
    )
    return Table("Bars", ("measure", "value", "bar", "verdict", "measured on"), rows)


def _shown(value: float | None, unit: str) -> str:
    if unit == "%":
        return percent(value)
    if value is None:
        return number(value)
    return f"{value:.3g} {unit}".rstrip()


# -- what the bars measure -------------------------------------------------------------------------

Select = Callable[[ScenarioInfo], bool]


def _group(result: SuiteResult, wanted: Select) -> Group | str:
    group = select(result, "", wanted)
    if not group.scenarios:
        return "no such scenario in this suite"
    if not group.trials:
        return str(group.skipped[0].error) if group.skipped else "not run"
    return group


def _measured(value: float | None, group: Group, extra: str = "") -> Measured:
    ran = len(group.trials)
    trials = counted(ran, "trial") if group.is_complete else f"{ran} of {counted(group.planned, 'trial')}"
    fallen = group.survival.whole - group.survival.passed
    notes = [trials, f"{fallen} fell" if fallen else "", extra]
    return Measured(value, ", ".join(note for note in notes if note), group.is_complete)


def _survival(wanted: Select) -> Callable[[SuiteResult], Measured | str]:
    def measure(result: SuiteResult) -> Measured | str:
        group = _group(result, wanted)
        return group if isinstance(group, str) else _measured(group.survival.value, group)

    return measure


def _mean(metric: str, wanted: Select) -> Callable[[SuiteResult], Measured | str]:
    """Mean over the robots that did not fall; no value where a scenario felled all, since it would be left out."""

    def measure(result: SuiteResult) -> Measured | str:
        group = _group(result, wanted)
        if isinstance(group, str):
            return group
        ran = {trial.scenario for trial in group.trials}
        infos = zip(group.scenarios, group.values(metric), strict=True)
        without = [info.id for info, values in infos if info.id in ran and not values]
        if without:
            return _measured(None, group, f"no robot has the figure in {', '.join(without)}")
        return _measured(group.mean_value(metric), group)

    return measure


def _worst(metric: str, wanted: Select) -> Callable[[SuiteResult], Measured | str]:
    """The worst trial; no value where one fell, since it has none."""

    def measure(result: SuiteResult) -> Measured | str:
        group = _group(result, wanted)
        if isinstance(group, str):
            return group
        fell = group.survival.passed < group.survival.whole
        return _measured(None if fell else group.largest(metric), group, "worst trial")

    return measure


PUSHES_PER_TIER = 18
"""In the robot maker's benchmark; a suite with fewer of them can miss the bar, but not meet it."""


def _pushes(tier: Tier) -> Callable[[SuiteResult], Measured | str]:
    def measure(result: SuiteResult) -> Measured | str:
        rows = [row for row in push_rows(result) if row.push.tier == tier]
        if not rows:
            return "no such push in this suite, or not run"
        names = {row.scenario for row in rows}
        group = select(result, "", lambda info: info.id in names)
        passed = sum(row.passed for row in rows)
        repeats = sum(row.outcomes.passed for row in rows), sum(row.outcomes.whole for row in rows)
        detail = f"{passed} of {len(rows)} pushes in every repeat, {repeats[0]} of {repeats[1]} singly"
        # Planned but never run: a push scenario without a single trial is not among the rows.
        planned = [info for info in result.scenarios if info.config in {row.config for row in rows}]
        complete = group.is_complete and {info.id for info in planned} <= {trial.scenario for trial in result.trials}
        return Measured(passed / len(rows), detail, complete and len(rows) >= PUSHES_PER_TIER)

    return measure


def _same_survival(physics: str, reference: str) -> Callable[[SuiteResult], Measured | str]:
    """Difference of the survival under other physics from that of the same walks under the reference."""

    def measure(result: SuiteResult) -> Measured | str:
        other = _group(result, lambda info: info.conditions.get("physics") == physics)
        if isinstance(other, str):
            return other
        walks = {_walk(info) for info in other.scenarios}
        standard = _group(result, lambda info: info.conditions.get("physics") == reference and _walk(info) in walks)
        if isinstance(standard, str):
            return f"nothing to compare with: {standard}"
        mine, theirs = other.survival, standard.survival
        # Rounded, or 100 of 100 against 99 would be 0.010000000000000009.
        difference = round(abs(mine.passed / mine.whole - theirs.passed / theirs.whole), 12)
        detail = f"{mine.passed} of {mine.whole} against {theirs.passed} of {theirs.whole}"
        return Measured(difference, detail, other.is_complete and standard.is_complete)

    return measure


def _walk(info: ScenarioInfo) -> tuple[object, ...]:
    return info.config, info.commands, info.duration_s


GRID_SPAN = ((-0.5, 0.8), (-0.4, 0.4), (-0.8, 0.8))
"""What a command grid must reach in vx, vy (m/s) and yaw rate (rad/s) for its bars."""


def _grid(
    measure: Callable[[SuiteResult], Measured | str], seconds: float = 0.0, repeats: int = 1
) -> Callable[[SuiteResult], Measured | str]:
    """A measure on the grid, for suites whose grid spans `GRID_SPAN` with walks so long and so many repeats."""

    def of_whole_grid(result: SuiteResult) -> Measured | str:
        grid = [info for info in result.scenarios if _is_grid(info)]
        if not grid:
            return "no command grid in this suite"
        for axis, (name, (low, high)) in enumerate(zip(("vx", "vy", "yaw rate"), GRID_SPAN, strict=True), start=1):
            asked = [info.commands[-1][axis] for info in grid]
            if min(asked) > low or max(asked) < high:
                return f"the grid's {name} does not span {low:g} to {high:g}"
        shortest = min(info.duration_s for info in grid)
        fewest = min(info.repeats for info in grid)
        if shortest < seconds or fewest < repeats:
            return f"walks of {shortest:g} s and {counted(fewest, 'repeat')} are too little"
        return measure(result)

    return of_whole_grid


def _is_grid(info: ScenarioInfo) -> bool:
    return info.config == "grid"


def _stands(info: ScenarioInfo) -> bool:
    # Like tracking it is judged after two seconds: at first the robot, put down with joint angles that are off by up to
    # 0.02 rad, takes the policy's own stance.
    return info.config == "standing" and info.duration_s >= 10.0 + SETTLE_S


def _square(hold_heading: bool) -> Select:
    return lambda info: info.config == "distance" and bool(info.conditions.get("hold_heading")) == hold_heading


def _friction(low: float, high: float) -> Select:
    """Walks on a friction; not the benchmark's own rows, which add pushes and have their own rule of falls."""

    def wanted(info: ScenarioInfo) -> bool:
        ours = info.config == "friction" and info.conditions.get("fall") == "firmware"
        return ours and low <= float(info.conditions["foot_friction"]) <= high

    return wanted


def terrain_figure(info: ScenarioInfo, kind: str) -> float | None:
    """First figure of a scenario's terrain, as 6 of `slope:6`; None where it is of another kind or has none."""
    name, _, figures = str(info.conditions.get("terrain", "flat")).partition(":")
    return float(figures.partition(",")[0]) if name == kind and figures else None


def _ground(kind: str, low: float, high: float) -> Select:
    def wanted(info: ScenarioInfo) -> bool:
        figure = terrain_figure(info, kind)
        return figure is not None and low <= abs(figure) <= high

    return wanted


BARS: tuple[Bar, ...] = (
    Bar("survival, every command of the grid, 60 s, 20 seeds", "≥", 1.0, "%", _grid(_survival(_is_grid), 60.0, 20)),
    Bar("velocity error over a gait cycle, grid", "≤", 0.03, "m/s", _grid(_mean("velocity_error_m_s", _is_grid))),
    Bar("yaw rate error over a gait cycle, grid", "≤", 0.04, "rad/s", _grid(_mean("yaw_rate_error_rad_s", _is_grid))),
    Bar("velocity error, instantaneous RMS, grid", "≤", 0.07, "m/s", _grid(_mean("velocity_rmse_m_s", _is_grid))),
    Bar("yaw rate error, instantaneous RMS, grid", "≤", 0.20, "rad/s", _grid(_mean("yaw_rate_rmse_rad_s", _is_grid))),
    Bar("standing: drift over 10 s", "≤", 0.01, "m", _worst("standing_drift_settled_m", _stands)),
    Bar("standing: steps taken", "≤", 0.0, "", _worst("standing_steps", _stands)),
    Bar("must-pass pushes, every row and repeat", "≥", 1.0, "%", _pushes("reasonable")),
    Bar("stretch pushes", "≥", 1.0, "%", _pushes("beyond"), aim=True),
    Bar("100 m square, open loop: no fall", "≥", 1.0, "%", _survival(_square(False))),
    Bar("100 m square, open loop: drift", "<", 84.0, "m", _worst("drift_final_m", _square(False))),
    Bar("100 m square, heading held: no fall", "≥", 1.0, "%", _survival(_square(True))),
    Bar("100 m square, heading held: drift", "≤", 10.0, "m", _worst("drift_final_m", _square(True))),
    Bar("survival, friction 0.3–1.2", "≥", 0.95, "%", _survival(_friction(0.3, 1.2))),
    Bar("survival, slopes to 6°", "≥", 0.95, "%", _survival(_ground("slope", 0.0, 6.0))),
    Bar("survival, rough ground of 2–4 cm", "≥", 0.95, "%", _survival(_ground("rough", 0.02, 0.04))),
    Bar("half the time step: difference in survival", "≤", 0.01, "%", _same_survival("half_step", "evaluation")),
    Bar("other solver: difference in survival", "≤", 0.01, "%", _same_survival("cg", "evaluation")),
    Bar("MJX: difference in survival", "≤", 0.01, "%", _same_survival("mjx", "feet_only")),
)
"""In the order of the report. The suite `standard` measures all of them."""
