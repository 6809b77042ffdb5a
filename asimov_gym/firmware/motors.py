"""Readings of the 25 motors' current and temperature, in firmware order (the ankles as A and B)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from asimov_gym.robot.joints import JOINTS
from asimov_gym.robot.motor import KT, HeatModel, heat, motor_current


@dataclass(frozen=True)
class MotorConfig:
    """Figures of the readings. All assumed, none is published."""

    heat: HeatModel = field(default_factory=HeatModel)
    current_noise_a: float = 0.1
    """Standard deviation of the current reading, A: a few counts of the 12-bit field on the bus."""

    def __post_init__(self) -> None:
        if not (np.isfinite(self.current_noise_a) and self.current_noise_a >= 0.0):
            raise ValueError(f"motor current_noise_a must be a finite number >= 0, got {self.current_noise_a!r}")


class Motors:
    """Readings of the motors' current and temperature.

    Args:
        config: figures of the model.
        seed: seed of the current noise.
    """

    def __init__(self, config: MotorConfig, seed: int) -> None:
        self.config = config
        self.temperature = np.full(len(JOINTS), config.heat.ambient_c)
        """Degrees Celsius, (25,). May be written, to heat a motor in a rehearsal; `FaultInjector.heat` does."""
        self.current = np.zeros(len(JOINTS))
        """Last reading, A, (25,)."""
        self._random = np.random.default_rng(seed)

    def step(self, torque: np.ndarray, dt: float, leak: np.ndarray | None = None) -> None:
        """Take the motors' torques over a step.

        Args:
            torque: at the motors' output shafts, N·m, (25,), firmware order.
            dt: s.
            leak: current beside the one that makes torque, A, (25,): it heats as well.
        """
        current = motor_current(torque)
        if leak is not None:
            current = current + leak
            torque = current * KT
        self.temperature = heat(self.temperature, torque, dt, self.config.heat)
        noise = self.config.current_noise_a
        self.current = current + noise * self._random.standard_normal(len(JOINTS)) if noise else current
