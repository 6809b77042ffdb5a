"""Plots of a recording: what was asked, what the robot did, and what happened to it."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from asimov_gym.recording.odometry import Odometry, estimate_motion
from asimov_gym.recording.reader import read_recording
from asimov_gym.recording.schemas import COMMANDS
from asimov_gym.recording.series import TelemetrySeries, VelocityCommands, read_telemetry, read_velocity_commands
from asimov_gym.recording.summary import ModeSpan, Summary, summarize
from asimov_gym.robot.joints import MOTOR_NAMES
from asimov_gym.robot.motor import PEAK_TORQUE, RATED_TORQUE
from asimov_gym.robot.safety_limits import TRIP_C, WARNING_C

VELOCITY_LABELS = ("forward, m/s", "left, m/s", "turn, rad/s")
GAIT_PERIOD_S = 0.7
"""Width of the moving mean over velocities: about one gait period, so that the sway of each step is no error."""
MODE_COLOURS = {"DAMP": "#d9d9d9", "STAND": "#cfe2f3", "MOVE/TRAJECTORY": "#fbe3c4", "MOVE": "#d5ecd0"}
_LEFT, _RIGHT, _SINGLE = "#1f5a99", "#d9822b", "#444444"
_LEAST_SPAN = {"rad": 0.1, "A": 2.0, "°C": 5.0}
_POINTS = 4000
"""A line with more is drawn by the extremes of each stretch."""


def save_plots(path: str | Path, folder: Path) -> list[Path]:
    """Draw a recording: `timeline`, `velocity`, `positions`, `currents`, `temperatures` and `torques`, as PNG files.

    Args:
        path: of the recording.
        folder: for the files; made where it is missing.

    Returns:
        The files written. Without telemetry there is the timeline alone.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: it is not a recording.
    """
    summary = summarize(path)
    folder.mkdir(parents=True, exist_ok=True)
    written = [_save(_timeline(path, summary), folder / "timeline.png")]
    try:
        series = read_telemetry(path)
    except ValueError:
        return written
    motion = estimate_motion(series)
    written.append(_save(_velocity(summary, motion, read_velocity_commands(path)), folder / "velocity.png"))
    for name, values, unit in (
        ("positions", series.motor_position, "rad"),
        ("currents", series.motor_current, "A"),
        ("temperatures", series.motor_temperature, "°C"),
    ):
        written.append(_save(_motors(summary, series, values, unit, name), folder / f"{name}.png"))
    written.append(_save(_torques(series), folder / "torques.png"))
    return written


def _save(figure: Figure, path: Path) -> Path:
    FigureCanvasAgg(figure)  # the object interface, without pyplot: no display is asked for
    figure.savefig(path, dpi=110)
    return path


# -- timeline --------------------------------------------------------------------------------------


def _timeline(path: str | Path, summary: Summary) -> Figure:
    """Modes, commands by client, alerts and other events, each on a row."""
    clients = list(dict.fromkeys(client for client, _, _ in summary.commands))
    alerts = list(dict.fromkeys(_alert_name(alert.text) for alert in summary.alerts))
    others = [event for event in summary.events if event.code not in ("mode_change", "alert_raised", "alert_cleared")]
    rows = ["mode", *clients, *alerts, *dict.fromkeys(event.code for event in others)]
    place = {(group, name): row for row, (group, name) in enumerate(_grouped(clients, alerts, others))}
    figure = Figure(figsize=(11, 1.6 + 0.32 * len(rows)), layout="constrained")
    axis = figure.subplots()
    for span in summary.modes:
        width, colour = span.stop - span.start, _colour(span.state)
        axis.barh(0, width, left=span.start, height=0.8, color=colour, edgecolor="0.5", lw=0.5)
        if width > 0.06 * summary.duration:
            axis.text((span.start + span.stop) / 2, 0, span.state, ha="center", va="center", fontsize=7, clip_on=True)
    start_us = summary.start_us
    marks: dict[tuple[str, bool], list[float]] = {}
    for entry in read_recording(path, [COMMANDS]):
        command: Any = entry.message
        marks.setdefault((command.client, command.verdict == "accepted"), []).append((entry.time_us - start_us) / 1e6)
    for (client, accepted), times in marks.items():
        row = place["client", client]
        colour, marker, label = ("#2f7d32", "|", "accepted") if accepted else ("#b3261e", "x", "dropped")
        axis.plot(times, np.full(len(times), row), marker, color=colour, ms=7, mew=1.2, label=label)
    for alert in summary.alerts:
        stop = summary.duration if alert.stop is None else alert.stop
        colour = "#b3261e" if " critical " in alert.text else "#e0a100"
        row = place["alert", _alert_name(alert.text)]
        axis.barh(row, max(stop - alert.start, 0.002 * summary.duration), left=alert.start, height=0.6, color=colour)
    for event in others:
        axis.plot(event.time, place["event", event.code], "o", color=_SINGLE, ms=4)
    axis.set_yticks(range(len(rows)), rows, fontsize=8)
    axis.set_ylim(len(rows) - 0.5, -0.5)
    margin = 0.01 * max(summary.duration, 1e-3)  # or what happened at the very start and end is cut in half
    axis.set_xlim(-margin, summary.duration + margin)
    axis.set_xlabel("time, s")
    axis.grid(axis="x", color="0.9")
    axis.set_axisbelow(True)
    handles, labels = axis.get_legend_handles_labels()
    if labels:
        unique = dict(zip(labels, handles, strict=True))
        figure.legend(unique.values(), unique.keys(), loc="outside upper right", ncols=2, fontsize=8, title="commands")
    figure.suptitle(f"{Path(path).name}: modes, commands, alerts, events", x=0.02, ha="left", fontsize=11)
    return figure


def _grouped(clients: list[str], alerts: list[str], others: Iterable[Any]) -> list[tuple[str, str]]:
    """Keys of the timeline's rows from the top; a client may be called like an alert."""
    events = dict.fromkeys(event.code for event in others)
    groups = (("mode", ["mode"]), ("client", clients), ("alert", alerts), ("event", list(events)))
    return [(group, name) for group, names in groups for name in names]


def _alert_name(text: str) -> str:
    return text.split()[0] if text else "alert"


# -- lines over time -------------------------------------------------------------------------------


def _velocity(summary: Summary, motion: Odometry, commands: VelocityCommands) -> Figure:
    """Commanded velocity against the one that leg odometry and gyro tell."""
    figure = Figure(figsize=(10, 6.5), layout="constrained")
    axes = figure.subplots(3, 1, sharex=True)
    asked = _held(summary, commands, motion.time)
    # A hanging robot's feet are no hold for odometry, so DAMP is left out.
    unseen = np.isnan(_held(summary, commands, motion.time, damp=np.nan)[:, 0])
    velocity = np.where(unseen[:, None], np.nan, motion.velocity)
    smooth = np.where(unseen[:, None], np.nan, _moving_mean(motion.velocity, motion.time))
    for channel, (axis, label) in enumerate(zip(axes, VELOCITY_LABELS, strict=True)):
        _shade(axis, summary.modes, names=channel == 0)
        axis.plot(*_thin(motion.time, velocity[:, channel]), color="#b9c6d6", lw=0.7, label="estimated, each instant")
        axis.plot(motion.time, smooth[:, channel], color=_LEFT, lw=1.8, label=f"estimated, mean over {GAIT_PERIOD_S} s")
        axis.plot(motion.time, asked[:, channel], color=_RIGHT, lw=1.5, ls="--", ds="steps-post", label="commanded")
        bound = max(0.5, 1.3 * float(np.nanmax(np.abs(np.append(smooth[:, channel], asked[:, channel])), initial=0.0)))
        axis.set_ylim(-bound, bound)
        _finish(axis, label)
    axes[-1].set_xlabel("time, s")
    axes[-1].set_xlim(0.0, max(summary.duration, 1e-3))
    axes[-1].legend(loc="lower right", ncols=3, fontsize=8)
    figure.suptitle("Velocity: commanded, and estimated from legs and gyro", fontsize=11)
    return figure


def _held(summary: Summary, commands: VelocityCommands, time: np.ndarray, damp: float = 0.0) -> np.ndarray:
    """The velocity asked for at each time, (n, 3): the last accepted command while the robot walks, else 0."""
    asked = np.zeros((len(time), 3))
    if len(commands.time):
        last = np.searchsorted(commands.time, time, side="right") - 1
        asked = np.where(last[:, None] >= 0, commands.velocity[np.maximum(last, 0)], 0.0)
    for span in summary.modes:
        if not span.state.startswith("MOVE/POLICY") and span.state != "MOVE":
            asked[(time >= span.start) & (time <= span.stop)] = damp if span.state == "DAMP" else 0.0
    return asked


def _moving_mean(values: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Mean over `GAIT_PERIOD_S`, centred, shortened at both ends, (n, c)."""
    if len(time) < 2:
        return values
    width = min(max(1, round(GAIT_PERIOD_S / float(np.median(np.diff(time)) or 1.0))), len(values))
    kernel = np.ones(width)
    count = np.convolve(np.ones(len(values)), kernel, mode="same")
    return np.stack([np.convolve(column, kernel, mode="same") / count for column in values.T], axis=1)


def _motors(summary: Summary, series: TelemetrySeries, values: np.ndarray, unit: str, title: str) -> Figure:
    """One small plot for each kind of motor, left and right together."""
    kinds = _kinds()
    columns = 4
    rows = -(-len(kinds) // columns)
    # A fixed layout: finding one for so many plots takes longer than drawing them.
    figure = Figure(figsize=(13, 2.1 * rows))
    places_of_axes = {"left": 0.05, "right": 0.99, "top": 0.92, "bottom": 0.07, "hspace": 0.35, "wspace": 0.2}
    axes = figure.subplots(rows, columns, sharex=True, gridspec_kw=places_of_axes).ravel()
    for axis, (kind, places) in zip(axes, kinds.items(), strict=False):
        _shade(axis, summary.modes)
        for place in places:
            colour, _, label = _side(place)
            axis.plot(*_thin(series.time, values[:, place]), color=colour, lw=0.9, label=label)
        if unit == "°C":
            for limit, colour in ((WARNING_C, "#e0a100"), (TRIP_C, "#b3261e")):
                if float(np.max(values[:, places], initial=0.0)) > limit - 10.0:
                    axis.axhline(limit, color=colour, lw=0.8, ls=":")
        axis.set_title(kind.replace("_", " "), fontsize=9)
        axis.tick_params(labelsize=7)
        axis.locator_params(nbins=5)
        axis.margins(x=0.0)
        _widen(axis, _LEAST_SPAN[unit])
        _finish(axis, "")
    for place, axis in enumerate(axes):
        if place >= len(kinds):
            axis.set_axis_off()
        elif place + columns >= len(kinds):
            axis.tick_params(labelbottom=True)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="upper right", ncols=2, fontsize=8)
    figure.supxlabel("time, s", fontsize=9)
    figure.suptitle(f"Motor {title}, {unit}", fontsize=11)
    return figure


def _torques(series: TelemetrySeries) -> Figure:
    """RMS torque of each motor against its continuous rating, and its largest torque against the peak rating."""
    torque = series.motor_torque()
    rms = 100.0 * np.sqrt(np.mean(torque**2, axis=0)) / RATED_TORQUE
    peak = 100.0 * np.max(np.abs(torque), axis=0) / PEAK_TORQUE
    kinds = _kinds()
    figure = Figure(figsize=(8.2, 1.0 + 0.36 * len(kinds)), layout="constrained")
    axis = figure.subplots()
    for row, places in enumerate(kinds.values()):
        for place in places:
            colour, offset, _ = _side(place)
            axis.barh(row + offset, rms[place], height=0.34, color=colour, lw=0)
            axis.plot(peak[place], row + offset, "d", color="black", ms=4)
    for name, colour in (("left", _LEFT), ("right", _RIGHT), ("middle", _SINGLE)):
        axis.barh(0, 0.0, color=colour, label=f"RMS, {name}")
    axis.plot([], [], "d", color="black", ms=4, label="largest, of the peak torque")
    axis.axvline(100.0, color="#b3261e", lw=1.2, ls="--")
    axis.set_yticks(range(len(kinds)), [kind.replace("_", " ") for kind in kinds], fontsize=8)
    axis.set_ylim(len(kinds) - 0.4, -0.6)
    axis.set_xlim(0.0, max(105.0, 1.05 * float(max(rms.max(), peak.max()))))
    axis.set_xlabel("% of the motor's rating: bars of the continuous torque, diamonds of the peak torque", fontsize=9)
    axis.grid(axis="x", color="0.9")
    axis.set_axisbelow(True)
    figure.legend(fontsize=8, loc="outside lower center", ncols=4, frameon=False)
    figure.suptitle("Motor torques, from the currents", fontsize=11)
    return figure


def _kinds() -> dict[str, list[int]]:
    """Places of the motors in firmware order by kind, left before right."""
    kinds: dict[str, list[int]] = {}
    for place, name in enumerate(MOTOR_NAMES):
        kinds.setdefault(name.removeprefix("L_").removeprefix("R_"), []).append(place)
    return kinds


def _side(place: int) -> tuple[str, float, str | None]:
    """Colour, offset from the middle of its row, and label of a motor's side."""
    sides = {"L_": (_LEFT, -0.19, "left"), "R_": (_RIGHT, 0.19, "right")}
    return sides.get(MOTOR_NAMES[place][:2], (_SINGLE, 0.0, None))


def _shade(axis: Axes, modes: Iterable[ModeSpan], names: bool = False) -> None:
    """Colour the background by mode."""
    spans = list(modes)
    whole = spans[-1].stop - spans[0].start if spans else 0.0
    for span in spans:
        axis.axvspan(span.start, span.stop, color=_colour(span.state), alpha=0.6, lw=0)
        if names and span.stop - span.start > 0.05 * whole:
            at = ((span.start + span.stop) / 2, 1.02)
            axis.annotate(span.state, at, xycoords=("data", "axes fraction"), ha="center", va="bottom", fontsize=7)


def _widen(axis: Axes, least: float) -> None:
    """Show at least so much of a value, or the noise of a motor at rest fills its plot."""
    low, high = axis.get_ylim()
    if high - low < least:
        axis.set_ylim((low + high - least) / 2, (low + high + least) / 2)


def _colour(state: str) -> str:
    return MODE_COLOURS.get(state) or MODE_COLOURS.get(state.partition("/")[0], "white")


def _finish(axis: Axes, label: str) -> None:
    axis.set_ylabel(label)
    axis.grid(color="white", lw=0.6)
    axis.set_axisbelow(True)


def _thin(time: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A line of at most about `_POINTS` points that still shows every peak: lowest and highest of each stretch."""
    if len(time) <= _POINTS:
        return time, values
    width = -(-2 * len(time) // _POINTS)
    count = len(time) // width
    blocks = values[: count * width].reshape(count, width)
    pairs = np.stack([blocks.min(axis=1), blocks.max(axis=1)], axis=1).ravel()
    return np.repeat(time[: count * width : width], 2), pairs
