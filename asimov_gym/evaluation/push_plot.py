"""The push map: what force in which direction, at which height, standing and walking."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from asimov_gym.evaluation.aggregate import PushRow
from asimov_gym.evaluation.plot_data import Pushes, pushes
from asimov_gym.evaluation.plot_style import BLUE, GREEN, GREY, ORANGE, PINK, SKY, finish, new_figure
from asimov_gym.evaluation.results import PushLimit, SuiteResult

_COLOURS = (BLUE, ORANGE, GREEN, PINK, SKY, GREY)
_MARKERS = {"reasonable": "o", "beyond": "^"}
_TIERS = {"reasonable": "must pass", "beyond": "stretch"}
_APART = 0.09
"""Marks of different bodies in one direction are set apart by this angle, rad."""
VERTICAL = 0.7
"""A push whose direction's vertical part is larger is drawn beside the map."""


def push_map(result: SuiteResult, folder: Path) -> Figure | str:
    """Polar maps of horizontal pushes, standing and walking, and the vertical ones beside them."""
    return draw_pushes(pushes(result)) or "the suite has no pushes"


def draw_pushes(shown: Pushes) -> Figure | None:
    """The map of pushes; None of none."""
    rows = [(row, False) for row in shown.standing] + [(row, True) for row in shown.walking]
    limits = [(limit, limit.speed != 0.0) for limit in shown.limits]
    if not rows and not limits:
        return None
    bodies = sorted({row.push.body for row, _ in rows} | {limit.body for limit, _ in limits}, key=_height_order)
    colours = {body: _COLOURS[place % len(_COLOURS)] for place, body in enumerate(bodies)}
    states = [walks for walks in (False, True) if any(w == walks for _, w in (*rows, *limits))]
    flat = [row.push.force for row, _ in rows if not _is_vertical(row.push.direction)]
    reach = max([*flat, *(limit.largest_survived_n for limit, _ in limits), 100.0])
    upright = [(row, walks) for row, walks in rows if _is_vertical(row.push.direction)]
    width = 4.3 * len(states) + (3.2 if upright else 0.6)
    figure = new_figure(width, 5.0)
    grid = figure.add_gridspec(1, len(states) + bool(upright), width_ratios=[4.3] * len(states) + [2.6] * bool(upright))
    for column, walks in enumerate(states):
        axis: Any = figure.add_subplot(grid[0, column], projection="polar")
        _polar(axis, reach, "walking" if walks else "standing")
        _draw_limits(axis, [limit for limit, w in limits if w == walks], colours)
        _draw_rows(axis, [row for row, w in rows if w == walks and not _is_vertical(row.push.direction)], colours)
    if upright:
        _draw_vertical(figure.add_subplot(grid[0, len(states)]), upright, colours)
    figure.legend(
        handles=_legend(rows, bool(limits), colours), loc="outside lower center", ncols=4, fontsize=8, frameon=False
    )
    return figure


def _polar(axis: Any, reach: float, title: str) -> None:
    """An axis with the front at the top and the left at the left."""
    axis.set_theta_zero_location("N")
    axis.set_theta_direction(1)
    axis.set_thetagrids(range(0, 360, 45), ["front", "", "left", "", "back", "", "right", ""], fontsize=8)
    axis.set_ylim(0.0, 1.08 * reach)
    axis.set_rlabel_position(112.5)
    axis.yaxis.set_major_formatter(lambda value, _: f"{value:g} N")
    axis.tick_params(axis="y", labelsize=7)
    axis.set_title(title, fontsize=10, pad=12)
    axis.grid(color="#cccccc", lw=0.6)


def _draw_limits(axis: Any, limits: list[PushLimit], colours: dict[str, str]) -> None:
    for body, colour in colours.items():
        mine = sorted(
            (limit for limit in limits if limit.body == body and not _is_vertical(limit.direction)),
            key=lambda limit: _angle(limit.direction),
        )
        if not mine:
            continue
        angles = np.array([_angle(limit.direction) for limit in mine])
        forces = np.array([limit.largest_survived_n for limit in mine])
        if len(mine) > 2:  # a closed outline
            angles, forces = np.append(angles, angles[0] + 2.0 * math.pi), np.append(forces, forces[0])
        axis.plot(angles, forces, "-", color=colour, lw=1.8)
        axis.fill(angles, forces, color=colour, alpha=0.08, lw=0)
        open_ended = [limit.smallest_failed_n is None for limit in mine]
        for angle, force, unbounded in zip(angles, forces, open_ended, strict=False):
            axis.plot(angle, force, "*" if unbounded else ".", color=colour, ms=9 if unbounded else 5)


def _draw_rows(axis: Any, rows: list[PushRow], colours: dict[str, str]) -> None:
    bodies = list(dict.fromkeys(row.push.body for row in rows))
    for row in rows:
        angle = _angle(row.push.direction) + _APART * (bodies.index(row.push.body) - 0.5 * (len(bodies) - 1))
        _mark(axis, angle, row, colours)


def _mark(axis: Any, x: float, row: PushRow, colours: dict[str, str]) -> None:
    colour = colours[row.push.body]
    marker = _MARKERS[row.push.tier or "reasonable"]
    axis.plot(x, row.push.force, marker, mfc=colour if row.passed else "white", mec=colour, mew=1.4, ms=7)


def _draw_vertical(axis: Axes, rows: list[tuple[PushRow, bool]], colours: dict[str, str]) -> None:
    """Vertical pushes: a place on the x axis for each body and state."""
    places = list(dict.fromkeys((walks, row.push.body, row.push.direction[2] > 0.0) for row, walks in rows))
    for row, walks in rows:
        _mark(axis, places.index((walks, row.push.body, row.push.direction[2] > 0.0)), row, colours)
    names = [
        f"{_short(body)} {'up' if up else 'down'}\n{'walking' if walks else 'standing'}" for walks, body, up in places
    ]
    finish(axis, y="vertical force, N")
    axis.set_xticks(range(len(places)), names, fontsize=7, rotation=60, ha="right")
    axis.set_xlim(-0.6, len(places) - 0.4)
    axis.set_ylim(0.0, 1.1 * max(row.push.force for row, _ in rows))


def _legend(rows: list[tuple[PushRow, bool]], limits: bool, colours: dict[str, str]) -> list[Line2D]:
    handles = [Line2D([], [], color=colour, lw=3, label=_short(body)) for body, colour in colours.items()]
    for tier in dict.fromkeys(row.push.tier or "reasonable" for row, _ in rows):
        for passed in (True, False):
            handles.append(
                Line2D(
                    [],
                    [],
                    ls="",
                    marker=_MARKERS[tier],
                    mec=GREY,
                    mfc=GREY if passed else "white",
                    label=f"{_TIERS[tier]}, {'passed' if passed else 'not passed'}",
                )
            )
    if limits:
        handles.append(Line2D([], [], color=GREY, lw=1.8, marker=".", label="largest survived (✱: nothing felled it)"))
    return handles


def _angle(direction: tuple[float, float, float]) -> float:
    return math.atan2(direction[1], direction[0]) % (2.0 * math.pi)


def _is_vertical(direction: tuple[float, float, float]) -> bool:
    return abs(direction[2]) > VERTICAL


def _short(body: str) -> str:
    names = {"pelvis_link": "pelvis", "waist_yaw_link": "chest"}
    return names.get(body, body.removesuffix("_link").removesuffix("_pitch").replace("_", " "))


def _height_order(body: str) -> tuple[int, str]:
    """From the ground up, as far as bodies that are pushed go."""
    order = ("ankle", "knee", "hip", "pelvis", "waist", "shoulder", "neck")
    return next((place for place, part in enumerate(order) if part in body), len(order)), body
