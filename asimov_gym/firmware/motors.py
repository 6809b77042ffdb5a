"""Current and heat of the 25 motors, in firmware order (the ankles as A and B).

Current is torque over the torque constant. Heat is one first-order lag for each motor, driven by the square of its
load: T' = (ambient + rise (torque / rated)^2 - T) / time constant. No thermal data is published for these motors; the
figures are assumed, chosen so that rated torque, a continuous rating, settles below the 80 degrees at which the robot
trips.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from asimov_gym.robot.joints import JOINTS, MOTORS


def _read_only(values: list[float]) -> np.ndarray:
    array = np.array(values)
    array.setflags(write=False)
    return array


KT = _read_only([MOTORS[joint.motor].kt for joint in JOINTS])
"""Torque constant, N·m/A, (25,)."""
RATED_TORQUE = _read_only([MOTORS[joint.motor].rated_torque for joint in JOINTS])
"""Continuous torque, N·m, (25,)."""


@dataclass(frozen=True)
class MotorConfig:
    """Figures of the current and heat model. All assumed, none is published."""

    ambient_c: float = 25.0
    """Temperature of a cold motor, degrees Celsius."""
    rise_at_rated_c: float = 45.0
    """Steady rise over ambient at rated torque, K."""
    time_constant_s: float = 600.0
    """Time constant of the heat model, s."""
    current_noise_a: float = 0.1
    """Standard deviation of the current reading, A: a few counts of the 12-bit field on the bus."""

    def __post_init__(self) -> None:
        for name, low in (("ambient_c", -273.15), ("rise_at_rated_c", 0.0), ("current_noise_a", 0.0)):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= low):
                raise ValueError(f"motor {name} must be a finite number >= {low}, got {value!r}")
        if not (np.isfinite(self.time_constant_s) and self.time_constant_s > 0.0):
            raise ValueError(f"motor time_constant_s must be a finite number > 0, got {self.time_constant_s!r}")


class Motors:
    """Readings of the motors' current and temperature.

    Args:
        config: figures of the model.
        seed: seed of the current noise.
    """

    def __init__(self, config: MotorConfig, seed: int) -> None:
        self.config = config
        self.temperature = np.full(len(JOINTS), config.ambient_c)
        """Degrees Celsius, (25,). May be written, to heat a motor in a rehearsal."""
        self.current = np.zeros(len(JOINTS))
        """Last reading, A, (25,)."""
        self._random = np.random.default_rng(seed)

    def step(self, torque: np.ndarray, dt: float) -> None:
        """Take the motors' torques over a step.

        Args:
            torque: at the motors' output shafts, N·m, (25,), firmware order.
            dt: s.
        """
        c = self.config
        noise = self._random.normal(0.0, c.current_noise_a, torque.shape) if c.current_noise_a else 0.0
        self.current = torque / KT + noise
        steady = c.ambient_c + c.rise_at_rated_c * np.square(torque / RATED_TORQUE)
        self.temperature += (steady - self.temperature) * (dt / c.time_constant_s)
