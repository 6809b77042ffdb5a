"""Current, heat and torque-speed limits of the 25 motors, in motor order (the ankles as A and B), over the array-API
standard.

Current is torque over the torque constant. Heat is one first-order lag for each motor, driven by the square of its
load: T' = (ambient + rise (torque / rated torque)^2 - T) / time constant. No thermal figure of these motors is
published; those here are assumed, chosen so that rated torque, a continuous rating, settles at 70 degrees, below the
robot's trip at 80. Since torque is current times a constant, heat is driven by current all the same.

The torque that a motor can put into its motion falls with speed, on a straight line from the peak torque at rest
through the rated torque at the rated speed; that line meets zero at `NO_LOAD_SPEED`. Its source marks it unverified.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from asimov_gym.robot.array_library import namespace
from asimov_gym.robot.joints import JOINTS, MOTORS


def _read_only(values: Sequence[float]) -> np.ndarray:
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array


KT = _read_only([MOTORS[joint.motor].kt for joint in JOINTS])
"""Torque constant, N·m/A, (25,)."""
RATED_TORQUE = _read_only([MOTORS[joint.motor].rated_torque for joint in JOINTS])
"""Continuous torque, N·m, (25,)."""
PEAK_CURRENT = _read_only([MOTORS[joint.motor].peak_current for joint in JOINTS])
"""A, (25,)."""
PEAK_TORQUE = _read_only([MOTORS[joint.motor].peak_torque for joint in JOINTS])
"""N·m, (25,)."""
NO_LOAD_SPEED = _read_only(
    [
        m.rated_speed * m.peak_torque / (m.peak_torque - m.rated_torque)
        for m in (MOTORS[joint.motor] for joint in JOINTS)
    ]
)
"""Speed at which the torque-speed line meets zero, rad/s, (25,)."""


@dataclass(frozen=True)
class HeatModel:
    """Figures of the heat model, all assumed."""

    ambient_c: float = 25.0
    """Temperature of a cold motor, degrees Celsius."""
    rise_at_rated_c: float = 45.0
    """Steady rise over ambient at rated torque, K."""
    time_constant_s: float = 600.0

    def __post_init__(self) -> None:
        for name, low in (("ambient_c", -273.15), ("rise_at_rated_c", 0.0)):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= low):
                raise ValueError(f"{name} must be a finite number >= {low:g}, got {value!r}")
        if not (math.isfinite(self.time_constant_s) and self.time_constant_s > 0.0):
            raise ValueError(f"time_constant_s must be a finite number > 0, got {self.time_constant_s!r}")


DEFAULT_HEAT = HeatModel()


def motor_current(torque: Any) -> Any:
    """Phase currents (..., 25) in A of motor torques (..., 25) in N·m."""
    xp = namespace(torque)
    return torque / xp.asarray(KT, dtype=torque.dtype)


def heat(temperature: Any, torque: Any, dt: float, model: HeatModel = DEFAULT_HEAT) -> Any:
    """Motor temperatures after a step, (..., 25), degrees Celsius.

    Args:
        temperature: before the step, degrees Celsius, (..., 25).
        torque: of the motors during the step, N·m, (..., 25).
        dt: length of the step, s; much shorter than the model's time constant.
        model: figures of the model.
    """
    xp = namespace(temperature, torque)
    load = torque / xp.asarray(RATED_TORQUE, dtype=torque.dtype)
    steady = model.ambient_c + model.rise_at_rated_c * load * load
    return temperature + (steady - temperature) * (dt / model.time_constant_s)


def motor_torque_limits(speed: Any) -> tuple[Any, Any]:
    """Least and greatest torque (..., 25) in N·m that motors turning at `speed` (..., 25), rad/s, can give.

    Along the motion the limit falls with speed to zero at `NO_LOAD_SPEED`; against it the peak torque stays.
    """
    xp = namespace(speed)
    peak = xp.asarray(PEAK_TORQUE, dtype=speed.dtype)
    slope = speed * (peak / xp.asarray(NO_LOAD_SPEED, dtype=speed.dtype))
    zero = xp.zeros_like(speed)
    return -xp.clip(peak + slope, zero, peak), xp.clip(peak - slope, zero, peak)
