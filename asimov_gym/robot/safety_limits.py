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


def has_fallen(gravity: Any, pelvis_height: Any) -> Any:
    """Robots on the ground, (N,) bool, from body-frame gravity (N, 3) and pelvis height above the ground (N,), m."""
    return (gravity[:, 2] > FALL_GRAVITY_Z) | (pelvis_height < FALL_HEIGHT)
