"""How still a robot stands when asked to: plain arrays of one robot, T policy steps."""

from __future__ import annotations

import numpy as np

from asimov_gym.evaluation.gait import runs
from asimov_gym.evaluation.tracking import SETTLE_S

STEP_HEIGHT = 0.01
"""A sole higher than this above the ground has been lifted, m."""
STEP_S = 0.04
"""A foot must be off the ground for so long to count as a step, s: one missing force sample is none."""


def drift(position: np.ndarray, start: np.ndarray) -> float:
    """Largest horizontal distance of the pelvis from its place at the start, m.

    Args:
        position: pelvis, world, (T, 2 or 3).
        start: the same before the first step, (2 or 3,).
    """
    return float(np.linalg.norm(position[:, :2] - start[:2], axis=1).max())


def settled_drift(position: np.ndarray, dt: float) -> float | None:
    """Largest horizontal distance of the pelvis from its place at `SETTLE_S`, m; None where the time is too short."""
    settled = position[round(SETTLE_S / dt) :]
    return drift(settled, settled[0]) if len(settled) else None


def sway(position: np.ndarray, dt: float) -> float | None:
    """Root mean square horizontal distance of the pelvis from its mean after `SETTLE_S`, m; None where too short."""
    settled = position[round(SETTLE_S / dt) :, :2]
    if not len(settled):
        return None
    return float(np.sqrt(((settled - settled.mean(axis=0)) ** 2).sum(axis=1).mean()))


def steps_taken(sole_height: np.ndarray, contact: np.ndarray, dt: float) -> int:
    """Times that a foot left the ground: its sole above `STEP_HEIGHT`, or without load, for `STEP_S`.

    Args:
        sole_height: above the ground, m, (T, 2).
        contact: whether each foot carries, (T, 2) bool.
        dt: s.
    """
    off = (sole_height > STEP_HEIGHT) | ~contact
    shortest = max(1, round(STEP_S / dt))
    return sum(stop - start >= shortest for foot in range(2) for start, stop in runs(off[:, foot]))
