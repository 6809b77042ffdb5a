"""The part of the page "How good is it" that sets the maker's published figures beside ours."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from markers import Table, prose

from asimov_gym.evaluation import tracking
from asimov_gym.evaluation.card import CardFigures
from asimov_gym.evaluation.published import Published
from asimov_gym.evaluation.published_comparison import BEHIND, Comparison, PushComparison
from asimov_gym.evaluation.push_limits import PUSH_S
from asimov_gym.evaluation.rollout import DT
from asimov_gym.evaluation.scenario import DELAY_STEP_MS, DELAYS, FALL_RULES, scenario_of_row
from asimov_gym.evaluation.suite import shipped_rows
from asimov_gym.evaluation.table import MISSING, counted


def delays() -> str:
    """Delays of the actions that our suites draw from, in words."""
    return f"0 to {DELAY_STEP_MS * (DELAYS - 1):g} ms, by seed"


def tilt_degrees(gravity_z: float) -> float:
    """Tilt at which the body-frame gravity has this z, degrees."""
    return math.degrees(math.acos(-gravity_z))


def beside(
    card: CardFigures,
    theirs: Published,
    pushes: Sequence[PushComparison],
    others: Sequence[Comparison],
    table: Table,
) -> str:
    """The section of the page.

    Args:
        card: figures of our policy.
        theirs: what the maker published.
        pushes: push by push, ours against theirs.
        others: counts and walks, ours against theirs.
        table: writes a table.
    """
    documents = ", ".join(f"`{path}`" for path in theirs.documents.values())
    firmware, vendor = FALL_RULES["firmware"], FALL_RULES["vendor"]
    start = prose(
        f"""The robot's maker published figures of the walking policy that it released, `{theirs.policy}`
        ([repository]({theirs.repository}): {documents}). Nobody ran that policy here; its figures stand as they were
        reported. Both are simulations in MuJoCo, and the pushes and walks are the same rows, but the tests differ:"""
    )
    differences = (
        """The maker's simulation has its own model of the robot, contact settings and gains; ours runs under the
        conditions above.""",
        f"""In the maker's sweeps the delay of the actions was drawn without a seed, and in policy ticks by mistake:
        {_range(theirs.delay_ms)} ms, where {_range(theirs.trained_delay_ms)} ms were trained. Ours is {delays()}.""",
        f"""The maker raises the force until the robot falls; how many tries each force had is not stated. Ours is
        bisected to {_resolution(card)}, every repeat has to be survived, and a robot beyond
        {tilt_degrees(firmware.gravity_z):.0f}° has fallen there, where the maker lets it go to
        {tilt_degrees(vendor.gravity_z):.1f}°. The two forces of the benchmark's row, under the maker's rule, count too;
        where no bisection was made, they are all there is (*).""",
    )
    points = "\n".join(prose(f"- {words}", "  ") for words in differences)
    about_pushes = prose(
        f"""{PUSH_S:g} s each. Theirs: the first force that felled the robot in each of two sweeps; none to a force:
        nothing up to it did, and more was not tried. Ours: the largest force that every repeat survived, and the
        smallest that some repeat did not. Must-pass and stretch are the benchmark's two forces for the place, with the
        repeats passed."""
    )
    circle = prose(
        f"""A robot that walks the circle without any error would score {_perfect_circle():.2f} m/s in its vx, were that
        taken along an axis of the world instead of the robot's heading. The maker's figure for the velocity is near to
        this, so the two are not ranked."""
    )
    figures = table(["measure", "the maker's", "ours", "ours is", "note"], map(_cells, others))
    return (
        f"## Beside the maker's policy\n\n{start}\n\n{points}\n\n### Push by push\n\n{about_pushes}\n\n"
        f"{_push_table(pushes, table)}\n### Counts and walks\n\n{figures}\n{circle}\n"
    )


def _range(pair: tuple[float, float]) -> str:
    return f"{pair[0]:g} to {pair[1]:g}"


def _resolution(card: CardFigures) -> str:
    """Of the bisection, with its repeats."""
    found = {(limit.resolution_n, limit.repeats) for limit in card.pushes.limits}
    shown = sorted(f"{newtons:g} N with {counted(repeats, 'repeat')}" for newtons, repeats in found)
    return " or ".join(shown) or "nothing here"


def _push_table(pushes: Sequence[PushComparison], table: Table) -> str:
    columns = ["push", "while", "maker's: falls at, N", "ours: survives, N", "falls at, N", "must-pass", "stretch"]
    return table(
        [*columns, "ours is"],
        [
            [
                push.where,
                while_what(push),
                push.theirs,
                _survived(push) + ("" if push.bisected else " *"),
                push.ours,
                _row(push.must_pass),
                _row(push.stretch),
                _verdict(push.verdict),
            ]
            for push in pushes
        ],
    )


def _survived(push: PushComparison) -> str:
    if push.survived is not None:
        return f"{push.survived:g}"
    return f"below {push.felled:g}" if push.felled else MISSING


def while_what(push: PushComparison) -> str:
    """What the robot does when it is pushed."""
    return f"walking, {push.speed:g} m/s" if push.speed else "standing"


def _row(row: Any) -> str:
    return MISSING if row is None else f"{row.push.force:g} N: {row.outcomes.passed} of {row.outcomes.whole}"


def _cells(one: Comparison) -> list[str]:
    return [one.what, one.theirs, one.ours, _verdict(one.verdict), one.note]


def _verdict(verdict: str) -> str:
    return f"**{verdict}**" if verdict in BEHIND else verdict


def _perfect_circle() -> float:
    """RMS error of vx in the world frame, m/s, of a robot that does exactly what the circle's commands ask."""
    command = scenario_of_row(shipped_rows()["locomotion/circle"], None, 1).command_rows()
    _, heading = tracking.dead_reckoned_path(command, DT, np.zeros(2))
    along_x = np.cos(heading) * command[:, 0] - np.sin(heading) * command[:, 1]
    return float(np.sqrt(np.mean((along_x - command[:, 0]) ** 2)))
