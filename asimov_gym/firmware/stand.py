"""STAND: the joints go from where they are to the standing pose in a ramp, and stay. Nothing balances the robot."""

from __future__ import annotations

import numpy as np

RAMP_S = 2.0
"""Duration of the ramp unless the configuration says otherwise, s."""


def stand_target(entry: np.ndarray, pose: np.ndarray, ramp: float | np.ndarray) -> np.ndarray:
    """Joint targets in STAND, rad, (n, 25).

    Args:
        entry: joint positions when STAND was entered, rad, (n, 25).
        pose: the standing pose, rad, (25,) or (n, 25).
        ramp: share of the ramp that is done, 0 to 1, one for all or (n, 1).
    """
    return entry + ramp * (pose - entry)
