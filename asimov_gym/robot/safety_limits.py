"""Thresholds that firmware, tasks and evaluation share: what a fall is, and when a motor is too hot."""

from __future__ import annotations

from typing import Any

FALL_GRAVITY_Z = -0.5
"""The robot has fallen when its body-frame gravity's z rises above this: tilt over 60 degrees."""
FALL_HEIGHT = 0.35
"""In training and evaluation a pelvis below this is a fall too, m. The real robot does not know its height."""
WARNING_C = 60.0
"""Motor temperature that raises a warning, degrees Celsius."""
TRIP_C = 80.0
"""Motor temperature that latches DAMP, degrees Celsius."""
TRIP_CLEAR_C = 70.0
"""The over-temperature alert's cause lasts until the motor is below this, degrees Celsius. Assumed."""

TUMBLE_TILT_DEG = 120.0
"""A robot tilted further than this is tumbling, degrees: head below the hips. Assumed."""
TUMBLE_RATE = 6.0
"""A robot turning faster than this is tumbling, rad/s; walking and pushes stay within 3. Assumed."""
LOW_SOC_PERCENT = 20.0
"""State of charge below which the battery warns."""


def has_fallen(
    gravity: Any, pelvis_height: Any, gravity_z: Any = FALL_GRAVITY_Z, least_height: Any = FALL_HEIGHT
) -> Any:
    """Robots on the ground, (N,) bool, from body-frame gravity (N, 3) and pelvis height above the ground (N,), m.

    Args:
        gravity: unit vector to the ground.
        pelvis_height: m.
        gravity_z: gravity's z above this is a fall; a number, or (N,) one for each robot.
        least_height: a pelvis below this is a fall, m; a number, or (N,).
    """
    return (gravity[:, 2] > gravity_z) | (pelvis_height < least_height)
