"""Makes the page "How good is it", its pictures and the table in the README from the card of the shipped policy."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from how_good_pictures import FOLDER, NAMES, pictures
from how_good_published import beside, delays, tilt_degrees, while_what
from markers import Table, prose

from asimov_gym.assets import asset_path
from asimov_gym.evaluation import tracking
from asimov_gym.evaluation.bars import BarResult
from asimov_gym.evaluation.card import CardFigures, OldCardError
from asimov_gym.evaluation.plots import KINDS
from asimov_gym.evaluation.published import published
from asimov_gym.evaluation.published_comparison import (
    BEHIND,
    Comparison,
    PushComparison,
    compare_counts,
    compare_figures,
    compare_pushes,
)
from asimov_gym.evaluation.scenario import FALL_RULES, FOOT_FRICTION
from asimov_gym.evaluation.suite import load_suite
from asimov_gym.evaluation.table import MISSING, counted

SUITE = "standard"
"""The suite that measures all that the page shows."""
COMMAND = f"asimov eval --suite {SUITE} --out RUN_FOLDER"
README_BARS = (
    "survival, every command of the grid, 60 s, 20 seeds",
    "velocity error over a gait cycle, grid",
    "yaw rate error over a gait cycle, grid",
    "standing: drift over 10 s",
    "must-pass pushes, every row and repeat",
    "stretch pushes",
    "100 m square, heading held: drift",
    "survival, friction 0.3–1.2",
)
"""Bars in the README, by name."""
_BEGIN, _END = "<!-- how good: made by docs/generate.py -->\n", "<!-- end of how good -->\n"


@dataclass(frozen=True)
class Shipped:
    """A policy and its card."""

    policy: Path
    """ONNX file."""
    card: CardFigures | None
    why_not: str = ""
    """Why there are no figures, where there are none."""

    @classmethod
    def load(cls, policy: Path | None = None) -> Shipped:
        """The shipped policy, or another with its card beside it.

        Raises:
            FileNotFoundError: there is no card.
            ValueError: the card cannot be read; names the file and what is wrong. One of an earlier version is no
                error: the pages say so.
        """
        policy = policy or asset_path("policies", "asimov_walk.onnx")
        try:
            return cls(policy, CardFigures.load(policy.with_suffix(".json")))
        except OldCardError as error:
            return cls(policy, None, str(error))

    @property
    def warnings(self) -> list[str]:
        """What a reader of the figures must know first."""
        if self.card is None:
            return []
        found = []
        if self.card.suite != SUITE:
            found.append(f"Measured by the suite `{self.card.suite}`, which lacks a part of what `{SUITE}` asks.")
        elif self.card.suite_hash != load_suite(SUITE).hash:
            found.append(f"Measured by another form of the suite `{SUITE}` than the one that is here now.")
        if not self.card.complete:
            found.append("The run was stopped before its end.")
        if hashlib.sha256(self.policy.read_bytes()).hexdigest() != self.card.policy_hash:
            found.append(f"Measured with another file than the `{self.policy.name}` that lies here.")
        return found


# -- the page --------------------------------------------------------------------------------------


def page(shipped: Shipped, table: Table, header: str) -> str:
    """`how_good_is_it.md`."""
    if shipped.card is None:
        return f"{header}\n# How good is it\n\n{_nothing_yet(shipped)}"
    card, theirs = shipped.card, published()
    pushes, others = compare_pushes(card, theirs), [*compare_counts(card, theirs), *compare_figures(card, theirs)]
    shown = {picture.name for picture in pictures(shipped.card)}
    parts = [
        f"{header}\n# How good is it\n",
        *(f"**{warning}**\n" for warning in shipped.warnings),
        _what_is_measured(shipped, card),
        _conditions(card, table),
        "## The bars\n\n" + prose(f"What a policy worth shipping must reach. {_tally(card.bars)}") + "\n",
        _bars(card.bars, table),
        *(_picture(kind.name, kind.title, kind.caption, kind.name in shown) for kind in KINDS if kind.name in NAMES),
        _hand_over(card, table),
        beside(card, theirs, pushes, others, table),
        _worse(card.bars, pushes, others, table),
        _LIMITS,
    ]
    return "\n".join(parts)


def readme(shipped: Shipped, table: Table, text: str) -> str:
    """The README with its table as it is now.

    Raises:
        ValueError: it lacks one of the two comments around the table.
    """
    head, begin, rest = text.partition(_BEGIN)
    _, end, tail = rest.partition(_END)
    if not begin or not end:
        raise ValueError(f"README.md must have the lines {_BEGIN.strip()!r} and {_END.strip()!r}")
    return head + begin + _summary(shipped, table) + end + tail


def _summary(shipped: Shipped, table: Table) -> str:
    if shipped.card is None:
        return _nothing_yet(shipped)
    by_name = {bar.name: bar for bar in shipped.card.bars}
    rows = [_bar_cells(by_name[name])[:4] for name in README_BARS if name in by_name]
    words = prose(_tally(shipped.card.bars) + _training(shipped.card))
    warnings = "".join(f"**{warning}**\n\n" for warning in shipped.warnings)
    return f"{warnings}{table(_BAR_COLUMNS[:4], rows)}\n{words}\n"


def _nothing_yet(shipped: Shipped) -> str:
    words = (
        f"The shipped policy has not been measured by the suite `{SUITE}` yet ({shipped.why_not}). This measures it:"
    )
    return f"{prose(words)}\n\n```sh\n{COMMAND}\n```\n"


def _what_is_measured(shipped: Shipped, card: CardFigures) -> str:
    trials, up = sum(one.trials for one in card.scenarios), sum(one.survived for one in card.scenarios)
    rule, vendor = FALL_RULES["firmware"], FALL_RULES["vendor"]
    measured = prose(
        f"""The shipped policy, `{shipped.policy.name}`, went through the suite `{card.suite}`: {len(card.scenarios)}
        scenarios, {trials:,} trials, {up:,} of them without a fall. The suite also asks for what may not be possible:
        ice, stairs, weak motors, pushes beyond what the robot's maker holds reasonable. All of it is simulation, under
        the evaluation conditions: all bodies collide, elliptic friction cone, dry joint friction, soles with friction
        {FOOT_FRICTION:g}, no rope; joint targets arrive late by {delays()}. A robot has fallen when it is tilted by
        more than {tilt_degrees(rule.gravity_z):.0f}° or its pelvis is lower than {rule.height:g} m; the rows of the
        maker's benchmark keep the maker's tilt, {tilt_degrees(vendor.gravity_z):.1f}°. Errors are those after the first
        {tracking.SETTLE_S:g} s; over a gait cycle means that the velocity is averaged over one. The seed of every trial
        follows from the suite, so the same versions give the same figures:"""
    )
    where = prose(
        f"""Measured on {_machine(card.machine)} in {card.wall_clock_s / 60.0:.0f} minutes, {card.started[:10]}, with
        {_versions(card)}; policy `{card.policy_hash[:12]}`, suite `{card.suite_hash[:12]}`.{_training(card)} This page
        is made from the figures beside the policy, `{shipped.policy.stem}.json`; none of them is typed by hand."""
    )
    return f"{measured}\n\n```sh\n{COMMAND.replace(SUITE, card.suite)}\n```\n\n{where}\n"


def _machine(machine: Mapping[str, Any]) -> str:
    gpus = ", ".join(map(str, machine.get("gpus") or ())) or "no GPU"
    return f"{machine.get('cpu', 'a machine')}, {counted(int(machine.get('cores', 1)), 'core')}, {gpus}"


def _versions(card: CardFigures) -> str:
    return ", ".join(f"{name} {version}" for name, version in card.versions.items())


def _training(card: CardFigures) -> str:
    """A sentence, with a space before it; nothing where the policy does not say."""
    training = card.contract.get("training")
    if not isinstance(training, Mapping):
        return ""
    stages = [*training.get("after", ()), training]
    samples, seconds = (sum(float(stage.get(name, 0.0)) for stage in stages) for name in ("samples", "seconds"))
    time = f"{seconds / 60.0:.0f} minutes" if seconds < 7200.0 else f"{seconds / 3600.0:.1f} hours"
    made = f" Training took {time}: {samples / 1e6:.0f} million samples in {counted(len(stages), 'stage')}."
    if (calibration := training.get("calibration")) is not None:
        made += (
            " Its commands are calibrated: how fast it walks was measured under these "
            f"conditions, at {calibration['commands']} commands drawn at random, and the file corrects them."
        )
    return made


def _conditions(card: CardFigures, table: Table) -> str:
    tables = "\n".join(f"{one.title}:\n\n{table(one.columns, one.rows)}" for one in card.conditions)
    return f"<details><summary>Every condition</summary>\n\n{tables}\n</details>\n"


# -- bars ------------------------------------------------------------------------------------------

_BAR_COLUMNS = ("measure", "bar", "ours", "", "measured on")


def _bars(bars: Sequence[BarResult], table: Table) -> str:
    return table(_BAR_COLUMNS, map(_bar_cells, bars))


def _bar_cells(bar: BarResult) -> list[str]:
    verdict = bar.verdict if bar.verdict == "met" else f"**{bar.verdict}**"
    return [_bar_name(bar), bar.asked, bar.shown, verdict, bar.detail]


def _bar_name(bar: BarResult) -> str:
    return bar.name + (" (aim)" if bar.aim else "")


def _tally(bars: Sequence[BarResult]) -> str:
    met = sum(bar.verdict == "met" for bar in bars)
    parts = [f"Bars met: {met} of {len(bars)}."]
    for verdict in ("missed", "not measured"):
        names = [_bar_name(bar) for bar in bars if bar.verdict == verdict]
        parts += [f"{verdict.capitalize()}: {'; '.join(names)}."] if names else []
    return " ".join(parts)


def _picture(name: str, title: str, caption: str, there: bool) -> str:
    if not there:
        return f"## {title}\n\nThe card does not hold what this picture shows.\n"
    return f"## {title}\n\n![{title}]({FOLDER}/{name}.png)\n\n{prose(caption)}\n"


def _hand_over(card: CardFigures, table: Table) -> str:
    title, walks = "## From a walk to STAND\n\n", [one for one in card.scenarios if one.config == "hand_over"]
    if not walks:
        return f"{title}The suite did not ask for it.\n"
    text = prose(
        """A walk, a stop, two seconds of rest, and the mode STAND takes over, on the ground and without a rope. STAND
        drives the joints to its pose and does not balance: the policy has to come to rest in a stance that can be left
        to it."""
    )
    columns = ["walk", "upright", "one foot before the other, cm", "largest, cm", "largest tilt in STAND"]
    rows = []
    for one in walks:
        stagger, tilt = one.figures.get("stance_stagger_m"), one.figures.get("stand_tilt_max_rad")
        feet = [MISSING] * 2 if stagger is None else [f"{100.0 * x:.1f}" for x in (stagger.mean, stagger.high)]
        tipped = MISSING if tilt is None else f"{math.degrees(tilt.high):.0f}°"
        rows.append([one.id.partition("/")[2], f"{one.survived} of {one.trials}", *feet, tipped])
    return f"{title}{text}\n\n{table(columns, rows)}"


# -- where ours is behind --------------------------------------------------------------------------


def _worse(
    bars: Sequence[BarResult], pushes: Sequence[PushComparison], others: Sequence[Comparison], table: Table
) -> str:
    rows = [[_bar_name(bar), bar.shown, f"bar: {bar.asked}", bar.detail] for bar in bars if bar.verdict == "missed"]
    for push in pushes:
        if push.verdict in BEHIND:
            words = "" if push.verdict == "worse" else "behind one of the two sweeps"
            name = f"push, {push.where}, {while_what(push)}: first force that fells it"
            rows.append([name, f"{push.ours} N", f"the maker's: {push.theirs} N", words])
    rows += [[one.what, one.ours, f"the maker's: {one.theirs}", one.note] for one in others if one.verdict in BEHIND]
    text = "Every measure above that misses its bar or is behind the maker's figure.\n\n"
    body = text + table(["measure", "ours", "against", ""], rows) if rows else "No measure above is behind.\n"
    unknown = [_bar_name(bar) for bar in bars if bar.verdict == "not measured"]
    unknown += [f"push, {push.where}, {while_what(push)}" for push in pushes if push.verdict == "not measured"]
    unknown += [one.what for one in others if one.verdict == "not measured"]
    if unknown:
        body += "\n" + prose(f"Not measured, so neither better nor worse: {'; '.join(unknown)}.") + "\n"
    return f"## Where we are worse\n\n{body}"


_LIMITS = """## What simulation does not tell

- This policy has never run on hardware. The maker reports walks of its own policies on several robots.
- The model: gear friction, play and bending of real joints are known only roughly. The suite varies payload, motor
  strength, friction, delays and sensor noise, and nothing else of the robot.
- Sensors: noise and offsets are drawn as in training; the drift of a real gyro and its filter is not simulated.
- Heat and battery: torques are compared with the limits, but no trial lasts until a motor is hot or a cell empty.
- Ground: slopes, steps and rough ground are hard. Carpet, grass and gravel give way.
- Pushes act at the centre of a body and for a set time. A hand, a door or a wall does neither.

[Taking it to the robot](taking_it_to_the_robot.md) has the order in which to find out.
"""
