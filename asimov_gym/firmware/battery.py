"""The battery: charge, voltage and current.

A pack that is drained by the motors and the electronics. The robot's pack is not published: nominal voltage apart, all
figures here are assumed. Braking motors burn their power; nothing flows back.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from asimov_gym.firmware.alerts import AlertBoard
from asimov_gym.robot.alerts import AlertId
from asimov_gym.robot.motor import RATED_TORQUE
from asimov_gym.robot.safety_limits import LOW_SOC_PERCENT

UNDERVOLTAGE = 1
"""Bit 0 of the protection flags: the pack is empty and has cut off. Ours; the robot's bits are not published."""


@dataclass(frozen=True)
class BatteryConfig:
    """Figures of the pack: thirteen lithium cells in series, 48 V nominal as the motors are. All assumed."""

    capacity_ah: float = 9.0
    full_v: float = 54.6
    """Open-circuit voltage when full, V."""
    empty_v: float = 39.0
    """Open-circuit voltage when empty, V; the line between the two is straight."""
    resistance_ohm: float = 0.08
    idle_w: float = 60.0
    """Draw of computers, sensors and motor drivers, W."""
    loss_at_rated_w: float = 50.0
    """Heat that a motor makes at rated torque, W; with the square of the torque otherwise."""
    cell_c: float = 30.0
    """Temperature of the cells, degrees Celsius; it does not change."""
    start_soc_percent: float = 100.0

    def __post_init__(self) -> None:
        allowed = {
            "capacity_ah": (1e-6, 1e3),
            "full_v": (1.0, 1e3),
            "empty_v": (1.0, 1e3),
            "resistance_ohm": (0.0, 1.0),
            "idle_w": (0.0, 1e4),
            "loss_at_rated_w": (0.0, 1e4),
            "cell_c": (-50.0, 150.0),
            "start_soc_percent": (0.0, 100.0),
        }
        for name, (low, high) in allowed.items():
            value = getattr(self, name)
            if not (math.isfinite(value) and low <= value <= high):
                raise ValueError(f"battery {name} must be between {low} and {high}, got {value!r}")
        if self.empty_v > self.full_v:
            raise ValueError(f"battery empty_v must be at most full_v = {self.full_v}, got {self.empty_v}")


@dataclass(frozen=True)
class BatteryState:
    """What the battery management reports."""

    voltage_v: float
    """At the terminals, V."""
    current_a: float
    """A, positive while charging."""
    soc_percent: float
    """State of charge, 0 to 100."""
    max_cell_temp_c: float
    protection_flags: int
    """See `UNDERVOLTAGE`; 0 when all is well."""


class Battery:
    """The pack. It knows nothing of restarts.

    Args:
        config: figures of the pack.
    """

    PERIOD_S = 0.05
    """Time between two samples; the draw is held in between."""

    def __init__(self, config: BatteryConfig) -> None:
        self.config = config
        self._soc = config.start_soc_percent
        self._power = config.idle_w
        self._since_s = 0.0
        self.state = self._report()
        """The last sample."""

    def charge_to(self, soc_percent: float) -> None:
        """Set the charge.

        Raises:
            ValueError: outside 0 to 100.
        """
        if not (math.isfinite(soc_percent) and 0.0 <= soc_percent <= 100.0):
            raise ValueError(f"soc_percent must be between 0 and 100, got {soc_percent!r}")
        self._soc = float(soc_percent)
        self.state = self._report()

    def due(self, dt: float) -> bool:
        """Let `dt` seconds pass. True when it is time for `sample`."""
        self._since_s += dt
        return self._since_s > self.PERIOD_S - 0.5 * dt

    def sample(self, torque: np.ndarray, speed: np.ndarray) -> None:
        """Drain the pack for the time since the last sample at the draw of now.

        Args:
            torque: of the motors, N·m, (25,).
            speed: of the motors, rad/s, (25,).
        """
        load = torque / RATED_TORQUE
        driving = np.maximum(torque * speed, 0.0)
        self._power = self.config.idle_w + float(driving.sum() + self.config.loss_at_rated_w * (load @ load))
        drawn_ah = -self._report().current_a * self._since_s / 3600.0
        self._soc = max(0.0, self._soc - 100.0 * drawn_ah / self.config.capacity_ah)
        self._since_s = 0.0
        self.state = self._report()

    def check(self, board: AlertBoard, now_us: int) -> bool:
        """Raise what the charge calls for; True if that latched DAMP just now."""
        soc = self.state.soc_percent
        if soc >= LOW_SOC_PERCENT:
            return False
        board.set(AlertId.BMS_LOW_SOC, now_us, round(10.0 * soc), round(10.0 * LOW_SOC_PERCENT))
        if not self.state.protection_flags:
            return False
        return board.set(AlertId.BMS_PROTECTION, now_us, self.state.protection_flags)

    def _report(self) -> BatteryState:
        c = self.config
        open_v = c.empty_v + (c.full_v - c.empty_v) * 0.01 * self._soc
        # The root of power = current (open - resistance current); at most what the pack can give.
        spread = max(0.0, open_v * open_v - 4.0 * c.resistance_ohm * self._power)
        drawn = 2.0 * self._power / (open_v + math.sqrt(spread))
        flags = 0 if self._soc > 0.0 else UNDERVOLTAGE
        return BatteryState(open_v - c.resistance_ohm * drawn, -drawn, self._soc, c.cell_c, flags)
