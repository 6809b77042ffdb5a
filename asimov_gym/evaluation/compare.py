"""Two results of one suite side by side: what differs by more than chance, trial by trial.

Trials are paired where scenario, repeat and seed agree, so both policies met the same start, delay and pushes. A
difference of means has a bootstrap interval over the pairs, drawn within each scenario; survival and pushes are
compared by the pairs that only one of the two passed (McNemar). With many figures, about one in twenty differs by
chance alone.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from asimov_gym.evaluation.aggregate import by_config
from asimov_gym.evaluation.document import Block, Facts, Heading, Text, to_markdown
from asimov_gym.evaluation.html import to_html
from asimov_gym.evaluation.intervals import Share, bootstrap_mean, mcnemar
from asimov_gym.evaluation.metrics import METRICS
from asimov_gym.evaluation.results import PushLimit, SuiteResult, Tier, TrialResult, plain
from asimov_gym.evaluation.table import MISSING, Table, figure, number, percent, vector

JSON_FILE, HTML_FILE, MARKDOWN_FILE = "compare.json", "compare.html", "compare.md"
SIGNIFICANCE = 0.05
"""A survival that differs with a smaller p-value is flagged."""
Flag = Literal["better", "worse", "different", "no difference"]
"""Of the second result against the first; `different` where neither way is better."""
Pair = tuple[TrialResult, TrialResult]


class DifferentSuitesError(ValueError):
    """Two results of suites that do not ask for the same."""


@dataclass(frozen=True)
class OutcomeDifference:
    """How often each policy came through, in the same trials or the same pushes."""

    what: str
    """`survival`, or `pushes` with their tier."""
    config: str
    """`all` for the whole suite."""
    first: int
    second: int
    pairs: int
    only_first: int
    """Pairs that only the first policy passed."""
    only_second: int
    p_value: float
    flag: Flag


@dataclass(frozen=True)
class MetricDifference:
    """A figure of both policies, over the pairs in which both have it."""

    config: str
    metric: str
    unit: str
    first: float
    """Mean."""
    second: float
    difference: float
    """Second minus first."""
    low: float | None
    """95 % interval; None where every scenario has one pair alone."""
    high: float | None
    pairs: int
    flag: Flag


@dataclass(frozen=True)
class PushDifference:
    """The largest survived push of both policies."""

    scenario: str
    body: str
    direction: tuple[float, float, float]
    speed: float
    first_n: float
    second_n: float
    flag: Flag
    """By more than the resolution of the search."""


@dataclass(frozen=True)
class Comparison:
    """Two results side by side."""

    first: str
    second: str
    suites: tuple[str, str]
    """Names."""
    same_suite: bool
    pairs: int
    unpaired: int
    """Trials of either that the other lacks, or has with another seed."""
    outcomes: tuple[OutcomeDifference, ...]
    """Survival, and pushes by tier."""
    metrics: tuple[MetricDifference, ...]
    pushes: tuple[PushDifference, ...]

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return plain(asdict(self))

    def table(self) -> Table:
        """What differs, a row each; the whole in `tables`."""
        rows = [row for table in self.tables() for row in _flagged(table)]
        columns = ("what", "where", self.first, self.second, "difference", "second is")
        return Table("Differences", columns, tuple(rows) or ((MISSING,) * 5 + ("no difference",),))

    def tables(self) -> list[Table]:
        """Survival, push limits, and figures by category."""
        outcomes = tuple(
            (
                row.what,
                row.config,
                _share(row.first, row.pairs),
                _share(row.second, row.pairs),
                f"{row.only_second} gained, {row.only_first} lost, p = {row.p_value:.3g}",
                row.flag,
            )
            for row in self.outcomes
        )
        pushes = tuple(
            (
                f"largest push on {row.body} along {vector(row.direction, 2)}, N",
                "standing" if row.speed == 0.0 else f"walking at {row.speed:g} m/s",
                number(row.first_n, 0),
                number(row.second_n, 0),
                f"{row.second_n - row.first_n:+.0f}",
                row.flag,
            )
            for row in self.pushes
        )
        figures = tuple(
            (
                METRICS[row.metric].description + (f", {row.unit}" if row.unit else ""),
                row.config,
                figure(row.first),
                figure(row.second),
                f"{figure(row.difference)} ({figure(row.low)} … {figure(row.high)})",
                row.flag,
            )
            for row in self.metrics
        )
        columns = ("what", "where", self.first, self.second, "difference", "second is")
        tables = [Table("Survival and pushes", columns, outcomes), Table("Push limits", columns, pushes)]
        return [table for table in [*tables, Table("Figures", columns, figures)] if table.rows]


def compare(first: SuiteResult, second: SuiteResult, *, allow_different: bool = False) -> Comparison:
    """Pair the trials of two results and tell what differs.

    Args:
        first: the one to compare with.
        second: the one that is judged.
        allow_different: also compare results of different suites, where trials agree.

    Raises:
        DifferentSuitesError: the suites differ and `allow_different` is not set, or no trial agrees.
    """
    same = first.suite_hash == second.suite_hash
    if not same and not allow_different:
        raise DifferentSuitesError(
            f"the results are of different suites: {first.suite} ({first.suite_hash[:12]}) and {second.suite} "
            f"({second.suite_hash[:12]}); run both with one suite, or compare what they share with --allow-different"
        )
    pairs = _pairs(first, second)
    if not pairs:
        raise DifferentSuitesError(
            f"the results of {first.policy_name} and {second.policy_name} share no trial with the same seed"
        )
    configs = [group.name for group in by_config(first) if any(a.config == group.name for a, _ in pairs)]
    outcomes = [_survival("all", pairs)]
    metrics: list[MetricDifference] = []
    for config in configs:
        mine = [pair for pair in pairs if pair[0].config == config]
        outcomes += [_survival(config, mine), *_pushes_passed(config, mine)]
        metrics += [row for name in METRICS if (row := _metric(config, name, mine)) is not None]
    names = (first.policy_name, second.policy_name)
    if names[0] == names[1]:  # two trainings under one name, or one policy twice
        same_file = first.policy_hash == second.policy_hash
        marks = ("first", "second") if same_file else (first.policy_hash[:6], second.policy_hash[:6])
        names = (f"{names[0]} ({marks[0]})", f"{names[1]} ({marks[1]})")
    trials = sum(trial.was_run for result in (first, second) for trial in result.trials)
    return Comparison(
        first=names[0],
        second=names[1],
        suites=(first.suite, second.suite),
        same_suite=same,
        pairs=len(pairs),
        unpaired=trials - 2 * len(pairs),
        outcomes=tuple(outcomes),
        metrics=tuple(metrics),
        pushes=_push_limits(first.push_limits, second.push_limits),
    )


def write_comparison(comparison: Comparison, folder: Path) -> Path:
    """Write `compare.json`, `compare.md` and `compare.html`; the last is returned."""
    folder.mkdir(parents=True, exist_ok=True)
    data = json.dumps(comparison.to_json(), indent=1, allow_nan=False) + "\n"
    (folder / JSON_FILE).write_text(data, encoding="utf-8")
    title = f"{comparison.second} against {comparison.first}"
    blocks = _blocks(comparison)
    (folder / MARKDOWN_FILE).write_text(to_markdown(title, blocks), encoding="utf-8")
    page = folder / HTML_FILE
    page.write_text(to_html(title, blocks), encoding="utf-8")
    return page


def _blocks(comparison: Comparison) -> list[Block]:
    blocks: list[Block] = []
    if not comparison.same_suite:
        blocks.append(Text("The suites differ: only trials with the same seed are compared.", warning=True))
    facts = (
        ("first", comparison.first),
        ("second", comparison.second),
        ("suite", " and ".join(dict.fromkeys(comparison.suites))),
        ("pairs of trials", str(comparison.pairs)),
        ("trials without a partner", str(comparison.unpaired)),
    )
    blocks += [Facts(facts), Heading("What differs"), _untitled(comparison.table()), Heading("Everything")]
    note = (
        "Differences are second minus first. Survival and pushes: pairs that only one of the two passed, exact McNemar "
        "test. "
        "Figures: mean over pairs in which both policies have the figure, with a paired bootstrap 95 % interval. A row "
        "is flagged where chance alone would do it in less than one case in twenty; with this many rows, some will be."
    )
    return [*blocks, Text(note), *comparison.tables()]


def _untitled(table: Table) -> Table:
    return Table("Flagged rows", table.columns, table.rows)


def _flagged(table: Table) -> list[tuple[str, ...]]:
    return [row for row in table.rows if row[-1] != "no difference"]


def _share(passed: int, whole: int) -> str:
    return f"{passed} of {whole} ({percent(Share(passed, whole).value)})"


def _pairs(first: SuiteResult, second: SuiteResult) -> list[Pair]:
    """Trials that both ran from the same seed, in the first one's order."""
    others = {(trial.scenario, trial.repeat, trial.seed): trial for trial in second.trials if trial.was_run}
    keys = ((trial, (trial.scenario, trial.repeat, trial.seed)) for trial in first.trials if trial.was_run)
    return [(trial, others[key]) for trial, key in keys if key in others]


def _survival(config: str, pairs: Sequence[Pair]) -> OutcomeDifference:
    return _outcomes("survival", config, [(a.survived, b.survived) for a, b in pairs])


def _pushes_passed(config: str, pairs: Sequence[Pair]) -> list[OutcomeDifference]:
    """Single pushes, by tier; those that one result lacks are no pairs."""
    tiers: dict[Tier | None, list[tuple[bool, bool]]] = {}
    for a, b in pairs:
        for one, other in zip(a.events, b.events, strict=False):
            tiers.setdefault(one.tier, []).append((one.outcome == "passed", other.outcome == "passed"))
    return [_outcomes(f"pushes, {tier or 'no tier'}", config, passed) for tier, passed in tiers.items()]


def _outcomes(what: str, config: str, passed: Sequence[tuple[bool, bool]]) -> OutcomeDifference:
    only_first = sum(a and not b for a, b in passed)
    only_second = sum(b and not a for a, b in passed)
    p_value = mcnemar(only_first, only_second)
    flag: Flag = "no difference"
    if p_value < SIGNIFICANCE:
        flag = "better" if only_second > only_first else "worse"
    counts = sum(a for a, _ in passed), sum(b for _, b in passed)
    return OutcomeDifference(what, config, *counts, len(passed), only_first, only_second, p_value, flag)


def _metric(config: str, name: str, pairs: Sequence[Pair]) -> MetricDifference | None:
    """Difference of a figure; None where no pair has it twice."""
    groups: dict[str, list[tuple[float, float]]] = {}
    for a, b in pairs:
        left, right = a.metrics.get(name), b.metrics.get(name)
        if left is not None and right is not None:
            groups.setdefault(a.scenario, []).append((left, right))
    both = [pair for group in groups.values() for pair in group]
    if not both:
        return None
    mean = bootstrap_mean([[right - left for left, right in group] for group in groups.values()])
    assert mean is not None  # there are pairs
    flag: Flag = "no difference"
    if mean.low is not None and mean.high is not None and (mean.low > 0.0 or mean.high < 0.0):
        better = METRICS[name].better
        rises = mean.low > 0.0
        flag = "different" if better is None else "better" if rises == (better == "higher") else "worse"
    first, second = (sum(pair[k] for pair in both) / len(both) for k in (0, 1))
    return MetricDifference(
        config, name, METRICS[name].unit, first, second, mean.value, mean.low, mean.high, len(both), flag
    )


def _push_limits(first: Sequence[PushLimit], second: Sequence[PushLimit]) -> tuple[PushDifference, ...]:
    others = {limit.scenario: limit for limit in second}
    rows = []
    for limit in first:
        other = others.get(limit.scenario)
        if other is None:
            continue
        gained = other.largest_survived_n - limit.largest_survived_n
        flag: Flag = "no difference"
        if abs(gained) > max(limit.resolution_n, other.resolution_n):
            flag = "better" if gained > 0.0 else "worse"
        rows.append(
            PushDifference(
                limit.scenario,
                limit.body,
                limit.direction,
                limit.speed,
                limit.largest_survived_n,
                other.largest_survived_n,
                flag,
            )
        )
    return tuple(rows)
