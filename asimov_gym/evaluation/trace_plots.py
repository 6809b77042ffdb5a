"""Plots of single walks, from the sample traces in a run folder."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from asimov_gym.evaluation import gait, tracking
from asimov_gym.evaluation.plot_style import BLUE, GREEN, GREY, LEFT, ORANGE, PALE, PINK, RIGHT, SKY, finish, new_figure
from asimov_gym.evaluation.results import ScenarioInfo, SuiteResult
from asimov_gym.robot.feet import SOLE_DEPTH

SHOWN_S = 3.0
"""Length of a gait diagram."""
GAITS = 3
"""Walks in the gait diagram."""


def gait_diagram(result: SuiteResult, folder: Path) -> Figure | str:
    """When each foot carries, against the gait clock, for up to three walks."""
    walks = _traced(result, lambda info: _is_steady_walk(info))
    if not walks:
        return "no sample trace of a steady walk"
    of_grid = [info for info in walks if info.config == "grid"]
    # The plainest first: straight ahead, then what differs from it.
    chosen = sorted(of_grid or walks, key=lambda info: (info.commands[-1][1] <= 0.0, _extras(info)))[:GAITS]
    figure = new_figure(9.0, 0.5 + 2.1 * len(chosen))
    axes = figure.subplots(2 * len(chosen), 1, height_ratios=[1.0, 1.1] * len(chosen), squeeze=False)[:, 0]
    for place, info in enumerate(chosen):
        _draw_gait(axes[2 * place], axes[2 * place + 1], info, _load(result, folder, info))
        last = place == len(chosen) - 1
        axes[2 * place + 1].set_xlabel("time, s" if last else "", fontsize=9)
    return figure


def _draw_gait(bars, lines, info: ScenarioInfo, trace: dict[str, np.ndarray]) -> None:
    time, dt = trace["time"], float(np.median(np.diff(trace["time"])))
    begin = min(max(0, len(time) - round(SHOWN_S / dt)), round(2.0 * tracking.SETTLE_S / dt))
    rows = slice(begin, begin + round(SHOWN_S / dt))
    contact = gait.contacts(trace["foot_force"][rows, :, 2])
    height = 100.0 * (trace["foot_height"][rows] - SOLE_DEPTH)
    t, phase = time[rows], trace["phase"][rows]
    clock = np.ptp(phase) > 0.0
    for foot, (name, colour) in enumerate((("left", LEFT), ("right", RIGHT))):
        y = 1 - foot
        if clock:
            asked = np.sin(phase + np.pi * foot) <= 0.0
            bars.broken_barh(_spans(t, asked, dt), (y - 0.42, 0.84), color=PALE, lw=0)
        bars.broken_barh(_spans(t, contact[:, foot], dt), (y - 0.22, 0.44), color=colour, lw=0)
        lines.plot(t, height[:, foot], color=colour, lw=1.3, label=name)
    vx, vy, wz = info.commands[-1][1:]
    finish(bars, title=f"{info.id}: {vx:g} m/s ahead, {vy:g} m/s to the left, {wz:g} rad/s")
    bars.set_yticks([1, 0], ["left", "right"], fontsize=8)
    bars.set_ylim(-0.5, 1.5)
    bars.grid(axis="y", visible=False)
    bars.tick_params(labelbottom=False)
    finish(lines, y="sole, cm")
    for axis in (bars, lines):
        axis.set_xlim(t[0] - dt, t[-1])


def _spans(time: np.ndarray, mask: np.ndarray, dt: float) -> list[tuple[float, float]]:
    """Start and length of each stretch of True; a row holds for the step that ends with it."""
    return [(float(time[a]) - dt, (b - a) * dt) for a, b in gait.runs(mask)]


def square_paths(result: SuiteResult, folder: Path) -> Figure | str:
    """Paths of the long walks, against the one that the commands add up to."""
    walks = _traced(result, lambda info: info.config.startswith("distance"))
    if not walks:
        return "no sample trace of the 100 m square"
    figure = new_figure(6.6, 6.0)
    axis = figure.subplots()
    for place, info in enumerate(walks):
        trace = _load(result, folder, info)
        colour = (BLUE, ORANGE, GREEN, PINK, SKY)[place % 5]
        dt = float(np.median(np.diff(trace["time"])))
        start = trace["position"][0, :2]
        path, _ = tracking.dead_reckoned_path(np.asarray(trace["command"], dtype=np.float64), dt, start)
        axis.plot(*path.T, "--", color=GREY, lw=1.0, label="commands" if place == 0 else None, zorder=1)
        walked = trace["position"][:, :2]
        whole = len(walked) >= round(info.duration_s / dt)
        drift = float(np.linalg.norm(walked[-1] - path[-1]))
        end = f"{drift:.1f} m off at the end" if whole else f"fell after {len(walked) * dt:.0f} s"
        held = "heading held" if info.conditions.get("hold_heading") else "open loop"
        axis.plot(*walked.T, color=colour, lw=1.6, label=f"{held}: {end}", zorder=2)
        axis.plot(*np.stack([walked[-1], path[-1]]).T, ":", color=colour, lw=1.2)
        axis.plot(*walked[-1], "s" if whole else "X", color=colour, ms=7)
    axis.plot(0.0, 0.0, "o", color="black", ms=5, label="start")
    axis.set_aspect("equal", adjustable="datalim")
    finish(axis, "x, m", "y, m")
    figure.legend(fontsize=8, loc="outside lower center", ncols=2, frameon=False)
    return figure


def _traced(result: SuiteResult, wanted: Callable[[ScenarioInfo], bool]) -> list[ScenarioInfo]:
    return [info for info in result.scenarios if info.id in result.traces and wanted(info)]


def _load(result: SuiteResult, folder: Path, info: ScenarioInfo) -> dict[str, np.ndarray]:
    with np.load(folder / result.traces[info.id]) as file:
        return {name: file[name] for name in ("time", "command", "phase", "position", "foot_force", "foot_height")}


def _is_steady_walk(info: ScenarioInfo) -> bool:
    """Whether its last command asks to walk for long enough to be seen."""
    t, *command = info.commands[-1]
    return any(command) and info.duration_s - t >= 2.0 * tracking.SETTLE_S


def _extras(info: ScenarioInfo) -> float:
    """How much a command asks for besides walking ahead."""
    _, _, vy, wz = info.commands[-1]
    return abs(vy) + abs(wz)
