"""How well a robot did what its commands asked: velocity, path and heading. Plain arrays of one robot, T policy steps.

A command row is vx, vy (m/s, heading frame) and yaw rate (rad/s, about the vertical); a velocity row is the same three,
measured. Both are in force during the step that the row ends.
"""

from __future__ import annotations

import math

import numpy as np

from asimov_gym.robot.frames import to_heading

SETTLE_S = 2.0
"""Tracking and standing are judged after this."""
CYCLE_WITHOUT_CLOCK_S = 0.7
"""Gait cycle assumed for a policy without a clock."""


def gait_period(gait_frequency_hz: float | None) -> float:
    """Length of a policy's gait cycle, s."""
    return CYCLE_WITHOUT_CLOCK_S if gait_frequency_hz is None else 1.0 / gait_frequency_hz


def moving_mean(values: np.ndarray, width: int) -> np.ndarray:
    """Mean over a sliding window of `width` rows along the first axis; (T - width + 1, ...)."""
    total = np.cumsum(np.concatenate([np.zeros_like(values[:1]), values]), axis=0)
    return (total[width:] - total[:-width]) / width


def cycle_error(velocity: np.ndarray, command: np.ndarray, dt: float, period_s: float) -> tuple[float, float] | None:
    """Mean error of the velocity averaged over a gait cycle, after `SETTLE_S`.

    A walking pelvis sways with every step; a mean over one cycle leaves what the robot does on the whole.

    Args:
        velocity: (T, 3).
        command: (T, 3).
        dt: s.
        period_s: of the gait cycle.

    Returns:
        Norm of the planar error, m/s, and absolute yaw rate error, rad/s; None where the time is too short.
    """
    error = (velocity - command)[round(SETTLE_S / dt) :]
    width = max(1, round(period_s / dt))
    if len(error) < width:
        return None
    mean = moving_mean(error, width)
    return float(np.linalg.norm(mean[:, :2], axis=1).mean()), float(np.abs(mean[:, 2]).mean())


def instantaneous_rmse(velocity: np.ndarray, command: np.ndarray, dt: float) -> tuple[float, float] | None:
    """Root mean square of the planar error, m/s, and of the yaw rate error, rad/s, at each instant after `SETTLE_S`.

    None where the time is too short.
    """
    error = (velocity - command)[round(SETTLE_S / dt) :]
    if not len(error):
        return None
    square = error**2
    return float(np.sqrt(square[:, :2].sum(axis=1).mean())), float(np.sqrt(square[:, 2].mean()))


def mean_velocity(velocity: np.ndarray, dt: float) -> np.ndarray | None:
    """Mean vx, vy and yaw rate after `SETTLE_S`, (3,); None where the time is too short."""
    settled = velocity[round(SETTLE_S / dt) :]
    return settled.mean(axis=0) if len(settled) else None


def dead_reckoned_path(command: np.ndarray, dt: float, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where a robot that does exactly what is asked would be after each step.

    It starts at `start` facing along x, as every trial does. Within a step the velocity keeps its direction to the
    body, so the step is taken along the heading of its middle, which is exact up to the chord of an arc of one step.

    Args:
        command: (T, 3).
        dt: s.
        start: x, y, (2 or 3,), m.

    Returns:
        Position (T, 2), m, and heading (T,), rad, not wrapped.
    """
    heading = np.cumsum(command[:, 2]) * dt
    middle = heading - 0.5 * command[:, 2] * dt
    planar = np.concatenate([command[:, :2], np.zeros((len(command), 1))], axis=1)
    steps = to_heading(-middle, planar)[:, :2] * dt
    return np.asarray(start, dtype=np.float64)[:2] + np.cumsum(steps, axis=0), heading


def final_drift(position: np.ndarray, path: np.ndarray) -> float:
    """Horizontal distance of the pelvis from the end of the dead-reckoned path, m.

    Args:
        position: pelvis, world, (T, 2 or 3).
        path: (T, 2).
    """
    return float(np.linalg.norm(position[-1, :2] - path[-1, :2]))


def final_heading_error(heading: np.ndarray, path_heading: np.ndarray) -> float:
    """Absolute difference of the last headings, rad, at most pi."""
    return abs(math.remainder(float(heading[-1] - path_heading[-1]), 2.0 * math.pi))


def path_length(position: np.ndarray, dt: float, period_s: float) -> float:
    """Length of the pelvis' way over ground, averaged over a gait cycle so that sway is no distance, m.

    Zero where the time is shorter than a cycle.
    """
    width = max(1, round(period_s / dt))
    if len(position) < width + 1:
        return 0.0
    track = moving_mean(np.asarray(position[:, :2], dtype=np.float64), width)
    # The window's two halves see half a cycle less at each end; the mean speed makes up for it.
    length = float(np.linalg.norm(np.diff(track, axis=0), axis=1).sum())
    return length * (len(position) - 1) / (len(track) - 1) if len(track) > 1 else 0.0
