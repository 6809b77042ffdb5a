"""The pictures of a report, from the trials and sample traces of a result.

What was not measured is left out, and the report says so.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from asimov_gym.evaluation.aggregate import Group, select
from asimov_gym.evaluation.bars import terrain_figure
from asimov_gym.evaluation.plot_data import ScenarioFigures, TorqueUse, scenario_figures, torques
from asimov_gym.evaluation.plot_style import (
    BLUE,
    GREY,
    LEFT,
    ORANGE,
    PALE,
    RED,
    RIGHT,
    SEQUENTIAL,
    Plot,
    finish,
    new_figure,
    save,
)
from asimov_gym.evaluation.push_plot import push_map
from asimov_gym.evaluation.results import ScenarioInfo, SuiteResult
from asimov_gym.evaluation.trace_plots import gait_diagram, square_paths

Draw = Callable[[SuiteResult, Path], "Figure | str"]
"""Draws a result whose traces lie in a folder; a text instead of a figure says why there is none."""


@dataclass(frozen=True)
class Kind:
    """A kind of plot: its file's name, what it is called, what is seen, and how it is drawn."""

    name: str
    title: str
    caption: str
    draw: Draw


def draw_plots(result: SuiteResult, folder: Path) -> list[Plot]:
    """Draw every plot that the result has the figures for.

    Args:
        result: of a suite.
        folder: its run folder: traces are read from it, `<name>.png` are written into it.

    Returns:
        One entry for each kind of plot, in the order of a report.
    """
    plots = []
    for kind in KINDS:
        drawn = kind.draw(result, folder)
        if isinstance(drawn, str):
            plots.append(Plot(kind.name, kind.title, kind.caption, None, drawn))
        else:
            plots.append(Plot(kind.name, kind.title, kind.caption, save(drawn, folder / f"{kind.name}.png")))
    return plots


# -- error grid ------------------------------------------------------------------------------------


def error_grid(result: SuiteResult, folder: Path) -> Figure | str:
    """Velocity errors of the command grid: a map of vx and yaw rate for each vy, planar error above yaw rate error."""
    return draw_error_grid(scenario_figures(result)) or "the suite has no command grid"


def draw_error_grid(scenarios: Sequence[ScenarioFigures]) -> Figure | None:
    """The maps of those scenarios that belong to the grid; None of fewer than two."""
    cells = {tuple(one.command): one for one in scenarios if one.config == "grid" and one.trials}
    if len(cells) < 2:
        return None
    vys = sorted({vy for _, vy, _ in cells})
    vxs, wzs = sorted({vx for vx, _, _ in cells}), sorted({wz for _, _, wz in cells})
    rows = (("velocity_error_m_s", "velocity error, m/s"), ("yaw_rate_error_rad_s", "yaw rate error, rad/s"))
    figure = new_figure(1.6 + max(2.6, 0.62 * len(wzs)) * len(vys), 1.2 + 2.0 * max(1.3, 0.36 * len(vxs)))
    axes = figure.subplots(2, len(vys), squeeze=False, sharex=True, sharey=True)
    for row, (metric, label) in enumerate(rows):
        means = {command: one.mean(metric) for command, one in cells.items()}
        top = max((mean for mean in means.values() if mean is not None), default=0.0) or 1.0
        image: Any = None
        for axis, vy in zip(axes[row], vys, strict=True):
            values = np.full((len(vxs), len(wzs)), np.nan)
            for (vx, y, wz), mean in means.items():
                if y == vy and mean is not None:
                    values[vxs.index(vx), wzs.index(wz)] = mean
            axis.set_facecolor(PALE)
            image = axis.imshow(values, cmap=SEQUENTIAL, vmin=0.0, vmax=top, origin="lower", aspect="auto")
            for command, one in cells.items():
                if command[1] == vy:
                    _cell_text(axis, (wzs.index(command[2]), vxs.index(command[0])), one, means[command], top)
            axis.set_xticks(range(len(wzs)), [f"{wz:g}" for wz in wzs], fontsize=8)
            axis.set_yticks(range(len(vxs)), [f"{vx:g}" for vx in vxs], fontsize=8)
            if row == 0:
                axis.set_title(f"vy = {vy:+g} m/s" if vy else "vy = 0", fontsize=10)
            else:
                axis.set_xlabel("yaw rate asked, rad/s", fontsize=9)
            if vy == vys[0]:
                axis.set_ylabel("vx asked, m/s", fontsize=9)
        bar = figure.colorbar(image, ax=list(axes[row]), pad=0.01)
        bar.set_label(label, fontsize=9)
        bar.ax.tick_params(labelsize=8)
    return figure


def _cell_text(axis: Axes, place: tuple[int, int], one: ScenarioFigures, mean: float | None, top: float) -> None:
    fell = one.trials - one.survived
    dark = mean is not None and mean > 0.55 * top
    text = "" if mean is None else f"{mean:.3f}"
    axis.text(*place, text, ha="center", va="center", fontsize=7, color="white" if dark else "black")
    if fell:
        mark = f"✕ {fell} of {one.trials}"
        axis.text(
            place[0], place[1] - 0.32, mark, ha="center", va="center", fontsize=6.5, color="white" if dark else RED
        )


# -- survival and error against a condition --------------------------------------------------------


@dataclass(frozen=True)
class _Sweep:
    config: str
    label: str
    value: Callable[[ScenarioInfo], float | None]


def _condition(name: str, factor: float = 1.0) -> Callable[[ScenarioInfo], float | None]:
    def value(info: ScenarioInfo) -> float | None:
        found = info.conditions.get(name)
        return factor * float(found) if isinstance(found, int | float) else None

    return value


def _terrain(kind: str, factor: float = 1.0) -> Callable[[ScenarioInfo], float | None]:
    def value(info: ScenarioInfo) -> float | None:
        figure = terrain_figure(info, kind)
        return None if figure is None else factor * figure

    return value


_SWEEPS = (
    _Sweep("delay", "action delay, ms", _condition("delay")),
    _Sweep("friction", "foot friction", _condition("foot_friction")),
    _Sweep("ground", "slope, degrees", _terrain("slope")),
    _Sweep("ground", "rough ground, cm", _terrain("rough", 100.0)),
    _Sweep("ground", "steps, cm", _terrain("steps", 100.0)),
    _Sweep("noise", "sensor noise, times the training's", _condition("noise")),
    _Sweep("payload", "payload, kg", _condition("payload_kg")),
    _Sweep("weak_motors", "motor strength, share", _condition("motor_strength")),
)
"""Conditions that suites vary: category, axis label, and the value of a scenario."""
_COLUMNS = 4


def sweeps(result: SuiteResult, folder: Path) -> Figure | str:
    """Survival, and velocity error of those that survived, against each condition that the suite varies."""
    found = [(sweep, points) for sweep in _SWEEPS if len(points := _points(result, sweep)) > 1]
    if not found:
        return "the suite varies no condition such as delay or friction"
    bands = -(-len(found) // _COLUMNS)
    columns = min(len(found), _COLUMNS)
    figure = new_figure(max(5.0, 2.9 * columns), 4.8 * bands)
    axes = figure.subplots(2 * bands, columns, squeeze=False)
    for place, (sweep, points) in enumerate(found):
        band, column = divmod(place, columns)
        _draw_sweep(axes[2 * band, column], axes[2 * band + 1, column], points)
        finish(axes[2 * band, column], y="survival, %" if column == 0 else "")
        finish(axes[2 * band + 1, column], sweep.label, "velocity error, m/s" if column == 0 else "")
    errors = axes[1::2].ravel()
    top = max(axis.get_ylim()[1] for axis in errors[: len(found)])
    for axis in errors:
        axis.set_ylim(0.0, top)
    for place in range(len(found), bands * columns):
        band, column = divmod(place, columns)
        axes[2 * band, column].set_axis_off()
        axes[2 * band + 1, column].set_axis_off()
    return figure


def _draw_sweep(upper: Axes, lower: Axes, points: list[tuple[float, Group]]) -> None:
    """Survival above, velocity error below."""
    x = [value for value, _ in points]
    shares = [group.survival for _, group in points]
    values = np.array([100.0 * share.passed / share.whole for share in shares])
    spread = np.abs(100.0 * np.array([share.interval for share in shares]) - values[:, None]).T
    upper.errorbar(x, values, spread, fmt="o-", color=BLUE, ms=4, lw=1.2, capsize=3, elinewidth=0.9)
    upper.set_ylim(-4.0, 104.0)
    known = [(value, mean) for value, group in points if (mean := group.mean("velocity_error_m_s")) is not None]
    for value, mean in known:
        if mean.low is not None and mean.high is not None:
            lower.plot([value, value], [mean.low, mean.high], color=ORANGE, lw=0.9)
    lower.plot([value for value, _ in known], [mean.value for _, mean in known], "s-", color=ORANGE, ms=4, lw=1.2)
    lower.set_xlim(upper.get_xlim())


def _points(result: SuiteResult, sweep: _Sweep) -> list[tuple[float, Group]]:
    """Trials of a sweep by the value of its condition."""
    values = {
        info.id: value
        for info in result.scenarios
        if info.config == sweep.config
        and info.conditions.get("fall") == "firmware"  # not the benchmark's rows, which add pushes
        and (value := sweep.value(info)) is not None
    }
    groups = [(v, select(result, "", lambda info, v=v: values.get(info.id) == v)) for v in sorted(set(values.values()))]
    return [(value, group) for value, group in groups if group.trials]


# -- joint torques ---------------------------------------------------------------------------------


def torque_use(result: SuiteResult, folder: Path) -> Figure | str:
    """RMS and peak torque of every joint as a share of its limit."""
    return draw_torques(torques(result)) or "no trial has joint torques"


def draw_torques(use: TorqueUse) -> Figure | None:
    """The bars of every joint; None of none."""
    if not use.joints:
        return None
    names = [torque.joint for torque in use.joints]
    kinds = list(dict.fromkeys(name.removeprefix("left_").removeprefix("right_") for name in names))
    figure = new_figure(8.2, 0.9 + 0.42 * len(kinds))
    axis = figure.subplots()
    labelled: set[str] = set()
    for torque in use.joints:
        side = _side(torque.joint)
        row = kinds.index(torque.joint.removeprefix("left_").removeprefix("right_"))
        y = row + {"left": -0.19, "right": 0.19, "": 0.0}[side]
        colour = {"left": LEFT, "right": RIGHT, "": GREY}[side]
        label = None if side in labelled else side or "middle"
        labelled.add(side)
        axis.barh(y, 100.0 * torque.peak, height=0.34, color=colour, alpha=0.3, lw=0)
        axis.barh(y, 100.0 * torque.rms, height=0.34, color=colour, lw=0, label=label)
        axis.plot(100.0 * torque.largest, y, "d", color="black", ms=3.5)
    axis.plot([], [], "d", color="black", ms=3.5, ls="", label="largest peak of the whole suite")
    axis.axvline(100.0, color=RED, lw=1.2, ls="--")
    axis.text(100.0, -0.62, " limit", color=RED, fontsize=8, va="bottom")
    axis.set_yticks(range(len(kinds)), [kind.removesuffix("_joint").replace("_", " ") for kind in kinds])
    axis.set_ylim(len(kinds) - 0.4, -0.7)
    axis.set_xlim(0.0, 112.0)
    finish(
        axis, f"torque, % of the joint's limit ({use.where}: solid RMS, pale peak of a trial, both means over trials)"
    )
    figure.legend(fontsize=8, loc="outside lower center", ncols=4, frameon=False)
    return figure


def _side(joint: str) -> str:
    side = joint.split("_")[0]
    return side if side in ("left", "right") else ""


KINDS: Sequence[Kind] = (
    Kind(
        "error_grid",
        "Velocity error over the command grid",
        "Error of the velocity averaged over a gait cycle after 2 s, mean of the repeats that did not fall. "
        "✕ counts falls; grey cells were not asked.",
        error_grid,
    ),
    Kind(
        "pushes",
        "Pushes",
        "Left: horizontal pushes by direction, seen from above with the robot facing up; a mark lies on the side that "
        "the force pushes to (bodies are set apart a little). Lines: largest force that every repeat survived. Marks: "
        "pushes of the benchmark, filled where every repeat passed. Right: vertical pushes.",
        push_map,
    ),
    Kind(
        "gait",
        "Gait",
        "Bars: a foot carries. Pale: the gait clock asks it to carry. Lines: height of the soles.",
        gait_diagram,
    ),
    Kind(
        "torque",
        "Joint torques",
        "Torque of each joint as a share of its limit.",
        torque_use,
    ),
    Kind(
        "sweeps",
        "Survival against conditions",
        "Above: share of trials without a fall, with Wilson 95 % intervals. Below: velocity error over a gait cycle of "
        "those that did not fall, with bootstrap 95 % intervals.",
        sweeps,
    ),
    Kind(
        "square",
        "100 m square",
        "Way of the pelvis (repeat 0), and the way that the commands add up to (dashed). The dotted line is the drift "
        "at the end.",
        square_paths,
    ),
)
