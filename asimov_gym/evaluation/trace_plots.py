"""Plots of single walks, from the sample traces in a run folder."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from asimov_gym.evaluation import gait, tracking
from asimov_gym.evaluation.plot_data import GaitSample, gait_samples, load_trace, traced
from asimov_gym.evaluation.plot_style import BLUE, GREEN, GREY, LEFT, ORANGE, PALE, PINK, RIGHT, SKY, finish, new_figure
from asimov_gym.evaluation.results import SuiteResult


def gait_diagram(result: SuiteResult, folder: Path) -> Figure | str:
    """When each foot carries, against the gait clock, for up to three walks."""
    return draw_gaits(gait_samples(result, folder)) or "no sample trace of a steady walk"


def draw_gaits(samples: Sequence[GaitSample]) -> Figure | None:
    """The gait diagram of samples; None of none."""
    if not samples:
        return None
    figure = new_figure(9.0, 0.5 + 2.1 * len(samples))
    axes = figure.subplots(2 * len(samples), 1, height_ratios=[1.0, 1.1] * len(samples), squeeze=False)[:, 0]
    for place, sample in enumerate(samples):
        _draw_gait(axes[2 * place], axes[2 * place + 1], sample)
        last = place == len(samples) - 1
        axes[2 * place + 1].set_xlabel("time, s" if last else "", fontsize=9)
    return figure


def _draw_gait(bars: Axes, lines: Axes, sample: GaitSample) -> None:
    dt = sample.dt
    t = sample.start_s + dt * np.arange(len(sample.carries[0]))
    for foot, (name, colour) in enumerate((("left", LEFT), ("right", RIGHT))):
        y = 1 - foot
        if sample.asked:
            bars.broken_barh(_spans(t, sample.asked[foot], dt), (y - 0.42, 0.84), color=PALE, lw=0)
        bars.broken_barh(_spans(t, sample.carries[foot], dt), (y - 0.22, 0.44), color=colour, lw=0)
        lines.plot(t, sample.sole_cm[foot], color=colour, lw=1.3, label=name)
    vx, vy, wz = sample.command
    finish(bars, title=f"{sample.scenario}: {vx:g} m/s ahead, {vy:g} m/s to the left, {wz:g} rad/s")
    bars.set_yticks([1, 0], ["left", "right"], fontsize=8)
    bars.set_ylim(-0.5, 1.5)
    bars.grid(axis="y", visible=False)
    bars.tick_params(labelbottom=False)
    finish(lines, y="sole, cm")
    for axis in (bars, lines):
        axis.set_xlim(t[0] - dt, t[-1])


def _spans(time: np.ndarray, marks: str, dt: float) -> list[tuple[float, float]]:
    """Start and length of each stretch of ones; a row holds for the step that ends with it."""
    mask = np.array([mark == "1" for mark in marks])
    return [(float(time[a]) - dt, (b - a) * dt) for a, b in gait.runs(mask)]


def square_paths(result: SuiteResult, folder: Path) -> Figure | str:
    """Paths of the long walks, against the one that the commands add up to."""
    walks = traced(result, lambda info: info.config.startswith("distance"))
    if not walks:
        return "no sample trace of the 100 m square"
    figure = new_figure(6.6, 6.0)
    axis = figure.subplots()
    for place, info in enumerate(walks):
        trace = load_trace(result, folder, info)
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
