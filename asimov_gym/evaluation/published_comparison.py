"""A card's figures beside those that the robot's maker published.

A comparison is never kinder to our own policy than the figures are: what one of their sweeps survived and ours did not
is behind, and where their test is not the same as ours it is not called better or worse.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from asimov_gym.evaluation.aggregate import PushRow, Share
from asimov_gym.evaluation.card import CardFigures
from asimov_gym.evaluation.metrics import metric
from asimov_gym.evaluation.plot_data import TIERS, ScenarioFigures
from asimov_gym.evaluation.published import SURVIVAL, Published, PublishedCount, PublishedFigure, Sweep
from asimov_gym.evaluation.results import PushLimit, Tier
from asimov_gym.evaluation.suite import shipped_rows
from asimov_gym.evaluation.table import MISSING, counted, figure, percent

Verdict = Literal[
    "better",
    "level",
    "worse",
    "worse than one sweep",
    "not worse, as far as tried",
    "not ranked",
    "not measured",
    "not published",
]
"""What our figure is beside theirs; `not ranked` where the tests are too different to say."""
BEHIND: tuple[Verdict, ...] = ("worse", "worse than one sweep")
"""Verdicts that say that ours is behind in some way."""


@dataclass(frozen=True)
class Comparison:
    """One figure of theirs beside ours."""

    what: str
    theirs: str
    ours: str
    verdict: Verdict
    note: str = ""


# -- pushes ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class PushComparison:
    """Pushes of one body in one direction, standing or walking."""

    where: str
    """Body and direction in words."""
    speed: float
    """Forward command while pushed, m/s; 0 stands."""
    sweeps: tuple[Sweep, ...]
    """Theirs; none where nothing is published."""
    tested: tuple[PushRow, ...]
    """Ours: the pushes of the benchmark's row."""
    limit: PushLimit | None
    """Ours, bisected; None where the suite does not look for it."""

    @property
    def theirs(self) -> str:
        """First force that felled theirs in each sweep, N."""
        words = [f"none to {one.holds:g}" if one.fails is None else f"{one.fails:g}" for one in self.sweeps]
        return " / ".join(words) or MISSING

    @property
    def ours(self) -> str:
        """Smallest force that felled ours, N."""
        if self.felled is not None:
            return f"{self.felled:g}"
        return MISSING if self.survived is None else f"none to {self.survived:g}"

    @property
    def bisected(self) -> bool:
        """Whether ours was looked for in small steps, and not only with the two forces of the row."""
        return self.limit is not None

    @property
    def must_pass(self) -> PushRow | None:
        """The push of the row that must be survived."""
        return self._of_tier("reasonable")

    @property
    def stretch(self) -> PushRow | None:
        """The push of the row that is beyond that."""
        return self._of_tier("beyond")

    def _of_tier(self, tier: Tier) -> PushRow | None:
        return next((one for one in self.tested if one.push.tier == tier), None)

    @property
    def survived(self) -> float | None:
        """Largest force below `felled` that every repeat of ours survived, N; None where none was tried or survived."""
        forces = [one.push.force for one in self.tested if one.passed]
        if self.limit is not None:
            forces.append(self.limit.largest_survived_n)
        felled = self.felled
        return max((force for force in forces if felled is None or force < felled), default=None)

    @property
    def felled(self) -> float | None:
        """Smallest force that felled ours in any repeat, N; None where none did."""
        forces = [one.push.force for one in self.tested if not one.passed]
        if self.limit is not None and self.limit.smallest_failed_n is not None:
            forces.append(self.limit.smallest_failed_n)
        return min(forces, default=None)

    @property
    def verdict(self) -> Verdict:
        """Worse where theirs survived what felled ours, better where ours survived what felled theirs."""
        if not self.sweeps:
            return "not published"
        felled, survived = self.felled, self.survived
        if felled is None and survived is None:
            return "not measured"
        if felled is not None:
            stronger = [_survives(sweep, felled) for sweep in self.sweeps]
            if any(stronger):
                return "worse" if all(stronger) else "worse than one sweep"
        if survived is not None and all(sweep.fails is not None and survived >= sweep.fails for sweep in self.sweeps):
            return "better"
        return "not worse, as far as tried" if felled is None else "level"


def _survives(sweep: Sweep, force: float) -> bool:
    """Whether theirs stood a force in this sweep; what is beyond the sweep's end is not known, and does not count."""
    if sweep.fails is not None:
        return force < sweep.fails
    return sweep.holds is not None and force <= sweep.holds


def compare_pushes(card: CardFigures, theirs: Published) -> tuple[PushComparison, ...]:
    """Every row of the benchmark that has a push of each tier, standing first."""
    sweeps = {row: push.sweeps for push in theirs.pushes for row in push.rows}
    found = []
    for name, row in shipped_rows().items():
        if {push.tier for push in row.events} != set(TIERS):
            continue
        push, speed = row.events[0], max(abs(command.vx) for command in row.commands)
        limit = next(
            (
                one
                for one in card.pushes.limits
                # Directions of a result are rounded to twelve decimals.
                if one.body == push.body
                and one.speed == speed
                and np.allclose(one.direction, push.direction, atol=1e-9)
            ),
            None,
        )
        where = push.label.rpartition(",")[0] or name
        found.append(PushComparison(where, speed, sweeps.get(name, ()), tuple(_tested(card, (name,))), limit))
    return tuple(sorted(found, key=lambda one: one.speed))


def _tested(card: CardFigures, rows: Sequence[str]) -> list[PushRow]:
    """The pushes of a card, of some rows or, without any, of all."""
    return [one for one in (*card.pushes.standing, *card.pushes.walking) if not rows or one.scenario in rows]


# -- counts and figures ----------------------------------------------------------------------------


def compare_counts(card: CardFigures, theirs: Published) -> tuple[Comparison, ...]:
    """Pushes passed of pushes tried, every repeat counted singly."""
    return tuple(_count(card, entry) for entry in theirs.counts)


def _count(card: CardFigures, entry: PublishedCount) -> Comparison:
    rows = [
        one
        for one in _tested(card, entry.rows)
        if entry.tier in (None, one.push.tier) and entry.force in (None, one.push.force)
    ]
    theirs = f"{entry.passed} of {entry.of}"
    single = Share(sum(one.outcomes.passed for one in rows), sum(one.outcomes.whole for one in rows))
    if single.value is None:
        return Comparison(entry.what, theirs, MISSING, "not measured", entry.note)
    whole = sum(one.passed for one in rows)
    ours = f"{single.passed} of {single.whole}; {whole} of {counted(len(rows), 'row')} in every repeat"
    share = entry.passed / entry.of
    verdict = _judged(single.value, share, share, higher=True) if entry.same_test else "not ranked"
    return Comparison(entry.what, theirs, ours, verdict, entry.note)


def compare_figures(card: CardFigures, theirs: Published) -> tuple[Comparison, ...]:
    """Figures of walks. One that no robot of ours has because all fell is worse than any."""
    return tuple(_figure(card, entry) for entry in theirs.figures)


def _figure(card: CardFigures, entry: PublishedFigure) -> Comparison:
    names = [entry.scenario] if entry.relative_to is None else [entry.scenario, entry.relative_to]
    found = [one for one in map(card.scenario, names) if one is not None and one.trials]
    low, high = _number(entry.low, entry), _number(entry.high, entry)
    theirs = _with_unit(low if low == high else f"{low} to {high}", entry)
    if len(found) < len(names):
        return Comparison(entry.what, theirs, MISSING, "not measured", entry.note)
    values = [_value(one, entry.metric) for one in found]
    value, base = values[0], values[1] if len(values) > 1 else 1.0
    verdict: Verdict
    if value is None or base is None:
        ours, verdict = _falls(found[0] if value is None else found[-1]), "worse"
    elif base == 0.0:
        ours, verdict = MISSING, "not measured"
    else:
        higher = entry.metric == SURVIVAL or metric(entry.metric).better == "higher"
        ours = _with_unit(_number(value / base, entry), entry)
        verdict = _judged(value / base, entry.low, entry.high, higher)
        if entry.metric != SURVIVAL and found[0].survived < found[0].trials:
            ours += f", {_falls(found[0])}"
    return Comparison(entry.what, theirs, ours, verdict if entry.same_test else "not ranked", entry.note)


def _falls(one: ScenarioFigures) -> str:
    return f"{one.trials - one.survived} of {one.trials} fell"


def _value(found: ScenarioFigures, name: str) -> float | None:
    return found.survived / found.trials if name == SURVIVAL else found.mean(name)


def _judged(value: float, low: float, high: float, higher: bool) -> Verdict:
    """Against a range of theirs; `higher`: more is better."""
    if low <= value <= high:
        return "level"
    return "better" if (value > high) == higher else "worse"


def _number(value: float, entry: PublishedFigure) -> str:
    return percent(value) if entry.metric == SURVIVAL else figure(value)


def _with_unit(text: str, entry: PublishedFigure) -> str:
    if entry.relative_to is not None:
        return f"× {text}"
    return text if entry.metric == SURVIVAL else f"{text} {metric(entry.metric).unit}".rstrip()
