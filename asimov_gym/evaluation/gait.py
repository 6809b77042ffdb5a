"""How a robot steps: contacts, swings, slip and left-right symmetry. Plain arrays of one robot, T policy steps.

Feet are left, right. A foot carries while the ground pushes it up with more than `CONTACT_FORCE`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from asimov_gym.robot.joints import JOINT_NAMES, joint_index
from asimov_gym.robot.mirror import mirror_name
from asimov_gym.tasks.walk.rewards import CONTACT_FORCE

SWING_S = 0.1
"""A foot in the air for less is bouncing, not stepping, s."""

_LEFT_LEG = [joint_index(f"left_{name}_joint") for name in ("hip_pitch", "hip_roll", "hip_yaw", "knee")] + [
    joint_index(f"left_ankle_{axis}_joint") for axis in ("pitch", "roll")
]
_RIGHT_LEG = [joint_index(mirror_name(JOINT_NAMES[place])) for place in _LEFT_LEG]


@dataclass(frozen=True)
class Swing:
    """One step of one foot: from lift-off to touch-down."""

    foot: int
    """0 left, 1 right."""
    start: int
    """First policy step in the air."""
    stop: int
    """First policy step on the ground again."""
    height: float
    """Highest the sole came above the ground, m."""


def contacts(foot_force: np.ndarray) -> np.ndarray:
    """Whether each foot carries, (T, 2) bool, from the ground's upward force on it, N, (T, 2)."""
    return foot_force > CONTACT_FORCE


def runs(mask: np.ndarray) -> list[tuple[int, int]]:
    """First index of each unbroken stretch of True in (T,), and the first index after it."""
    edges = np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8))
    return list(zip(np.flatnonzero(edges == 1).tolist(), np.flatnonzero(edges == -1).tolist(), strict=True))


def swings(contact: np.ndarray, sole_height: np.ndarray, dt: float) -> list[Swing]:
    """Every complete step of at least `SWING_S`, left foot first; one cut off by either end is left out.

    Args:
        contact: (T, 2) bool.
        sole_height: above the ground, m, (T, 2).
        dt: s.
    """
    shortest = max(1, round(SWING_S / dt))
    return [
        Swing(foot, start, stop, float(sole_height[start:stop, foot].max()))
        for foot in range(2)
        for start, stop in runs(~contact[:, foot])
        if stop - start >= shortest and start > 0 and stop < len(contact)
    ]


def clearance(steps: list[Swing]) -> float | None:
    """Mean over all steps of the sole's highest point above the ground, m; None without steps."""
    return float(np.mean([step.height for step in steps])) if steps else None


def frequency(steps: list[Swing], dt: float) -> float | None:
    """Gait cycles per second: touch-downs of the same foot, both feet averaged; None unless both stepped twice."""
    rates = []
    for foot in range(2):
        downs = [step.stop for step in steps if step.foot == foot]
        if len(downs) < 2:
            return None
        rates.append((len(downs) - 1) / ((downs[-1] - downs[0]) * dt))
    return float(np.mean(rates))


def slip_speed(foot_velocity: np.ndarray, contact: np.ndarray) -> float | None:
    """Mean horizontal speed of carrying feet, m/s; None where none carries.

    The first and last moment of a stance are left out: landing and rolling off over the toes move the foot, but are no
    slip.

    Args:
        foot_velocity: world, m/s, (T, 2, 2 or 3).
        contact: (T, 2) bool.
    """
    firm = _firm(contact)
    if not firm.any():
        return None
    return float(np.linalg.norm(foot_velocity[:, :, :2], axis=2)[firm].mean())


def slip_distance(foot_velocity: np.ndarray, contact: np.ndarray, dt: float) -> float:
    """Way that carrying feet slid over the ground, both feet added, m; arguments as for `slip_speed`."""
    return float(np.linalg.norm(foot_velocity[:, :, :2], axis=2)[_firm(contact)].sum() * dt)


def _firm(contact: np.ndarray) -> np.ndarray:
    firm = np.zeros_like(contact)
    firm[1:-1] = contact[:-2] & contact[1:-1] & contact[2:]
    return firm


def asymmetry(left: float, right: float) -> float | None:
    """|left - right| as a share of their mean; 0 is symmetric, None where both are zero."""
    mean = 0.5 * (left + right)
    return abs(left - right) / mean if mean > 0.0 else None


def step_time_asymmetry(steps: list[Swing]) -> float | None:
    """Asymmetry of the median swing duration; None unless both feet stepped.

    Medians, so that one stumble does not make a limp.
    """
    durations = [[step.stop - step.start for step in steps if step.foot == foot] for foot in range(2)]
    if not all(durations):
        return None
    return asymmetry(float(np.median(durations[0])), float(np.median(durations[1])))


def foot_lift_asymmetry(steps: list[Swing]) -> float | None:
    """Asymmetry of the median height of the swings; None unless both feet stepped."""
    heights = [[step.height for step in steps if step.foot == foot] for foot in range(2)]
    if not all(heights):
        return None
    return asymmetry(max(0.0, float(np.median(heights[0]))), max(0.0, float(np.median(heights[1]))))


def joint_range_asymmetry(joint_position: np.ndarray) -> float | None:
    """Asymmetry of the angles that the leg joints use: summed differences over the mean of both legs' sums.

    A joint's range is that between its 5th and 95th percentile. None where no leg joint moved.

    Args:
        joint_position: joint order, rad, (T, 25).
    """
    low, high = np.percentile(joint_position, [5.0, 95.0], axis=0)
    used = high - low
    left, right = used[_LEFT_LEG], used[_RIGHT_LEG]
    mean = 0.5 * float((left + right).sum())
    return float(np.abs(left - right).sum()) / mean if mean > 0.0 else None
