"""A recorded movement as a reference motion for `Asimov-Trajectory-v0`."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from asimov_gym.recording.series import TelemetrySeries, read_telemetry
from asimov_gym.robot.joints import RANGE, VELOCITY_LIMIT
from asimov_gym.tasks.trajectory import Motion

_PEAK_SPEED = 1.875
"""Largest speed of a minimum-jerk movement over its mean."""
_SPEED_SHARE = 0.5
"""Share of the joints' speed limit that the way back to the first pose may use."""


def reference_motion(
    path: str | Path, start: float = 0.0, stop: float | None = None, dt: float = 0.02, return_s: float = 1.0
) -> Motion:
    """The joint angles that a robot reported, as a motion that repeats: after the last pose it goes back to the first.

    Angles between samples follow from the reported angles and speeds (cubic Hermite), so that 10 Hz telemetry is
    enough. Angles a little beyond a joint's range are put on its limit.

    Args:
        path: a recording.
        start: of the part to take, s since the recording's first message.
        stop: its end, s; None for the recording's.
        dt: time between frames, s; the environment's control step by default.
        return_s: least time for the way from the last pose to the first, s.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: it is not a recording, or has no such part.
        MotionError: a joint moves faster there than the robot can, as in a fall.
    """
    series = read_telemetry(path)
    first, last = float(series.time[0]), float(series.time[-1])
    begin, end = max(start, first), last if stop is None else stop
    if not (start >= 0.0 and end <= last + dt and begin + 2.0 * dt <= end):
        raise ValueError(
            f"{path} has telemetry from {first:.2f} to {last:.2f} s: there is no part from {start} to {stop}"
        )
    if dt <= 0.0 or return_s <= 0.0:
        raise ValueError(f"dt and return_s must be > 0 s, got {dt} and {return_s}")
    frames = _resample(series, begin + dt * np.arange(1 + math.floor((min(end, last) - begin) / dt + 1e-6)))
    frames = np.clip(frames, RANGE[:, 0], RANGE[:, 1])
    return Motion(str(path), np.concatenate([frames, _way_back(frames[-1], frames[0], dt, return_s)]), dt)


def _resample(series: TelemetrySeries, at: np.ndarray) -> np.ndarray:
    """Joint angles (m, 25) at times (m,), by cubic Hermite interpolation between samples."""
    position, velocity, time = series.joint_position(), series.joint_velocity(), series.time
    distinct = np.concatenate([[True], np.diff(time) > 0.0])
    position, velocity, time = position[distinct], velocity[distinct], time[distinct]
    before = np.clip(np.searchsorted(time, at, side="right") - 1, 0, len(time) - 2)
    step = (time[before + 1] - time[before])[:, None]
    u = (at - time[before])[:, None] / step
    return (
        (1.0 + 2.0 * u) * (1.0 - u) ** 2 * position[before]
        + u * (1.0 - u) ** 2 * step * velocity[before]
        + u**2 * (3.0 - 2.0 * u) * position[before + 1]
        + u**2 * (u - 1.0) * step * velocity[before + 1]
    )


def _way_back(last: np.ndarray, first: np.ndarray, dt: float, least_s: float) -> np.ndarray:
    """Frames strictly between two poses (25,), slow enough for every joint, (n, 25)."""
    slowest = float(np.max(_PEAK_SPEED * np.abs(first - last) / (_SPEED_SHARE * VELOCITY_LIMIT)))
    count = math.ceil(max(least_s, slowest) / dt)
    u = (np.arange(1, count) / count)[:, None]
    blend = u**3 * (10.0 - 15.0 * u + 6.0 * u * u)  # minimum jerk, as between keyframes
    return last + blend * (first - last)
