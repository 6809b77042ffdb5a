"""Current and heat of the 25 motors, in motor order (the ankles as A and B), over the array-API standard.

Current is torque over the torque constant. Heat is one first-order lag for each motor, driven by the square of its
load: T' = (ambient + rise (torque / rated torque)^2 - T) / time constant. No thermal figure of these motors is
published; those here are assumed, chosen so that rated torque, a continuous rating, settles at 70 degrees, below the
robot's trip at 80.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from array_api_compat import array_namespace

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
    xp = array_namespace(torque)
    return torque / xp.asarray(KT, dtype=torque.dtype)


def heat(temperature: Any, torque: Any, dt: float, model: HeatModel = DEFAULT_HEAT) -> Any:
    """Motor temperatures after a step, (..., 25), degrees Celsius.

    Args:
        temperature: before the step, degrees Celsius, (..., 25).
        torque: of the motors during the step, N·m, (..., 25).
        dt: length of the step, s; much shorter than the model's time constant.
        model: figures of the model.
    """
    xp = array_namespace(temperature, torque)
    load = torque / xp.asarray(RATED_TORQUE, dtype=torque.dtype)
    steady = model.ambient_c + model.rise_at_rated_c * load * load
    return temperature + (steady - temperature) * (dt / model.time_constant_s)
