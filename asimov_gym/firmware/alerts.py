"""Alerts, error flags and the latch.

An alert is up while its cause lasts and for 2.5 s after. A critical one also latches DAMP: its bit in the error word
and bit 0 stay until the firmware restarts. Numbers and severities are those of the robot's alert catalogue.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from asimov_gym.firmware.clock import MICROSECONDS
from asimov_gym.robot.alerts import DAMP_LATCHED, AlertId, Severity, error_bit

UNITS = {
    AlertId.MOTOR_OVERTEMP: "0.1 deg C",
    AlertId.MOTOR_TEMP_HIGH: "0.1 deg C",
    AlertId.FALL_DETECTED: "0.1 deg of tilt",
    AlertId.JOINT_OUT_OF_RANGE: "mrad past the joint's range",
    AlertId.POLICY_SPAZ: "0.001 of the largest action; 2^32-1 if not finite",
    AlertId.INFERENCE_FAILURE: "none, 0",
}
"""Unit of an alert's `value` and `threshold` (whole numbers on the wire). Not published for the robot: ours."""

CLEAR_DELAY_US = round(2.5 * MICROSECONDS)
"""An alert goes away this long after its cause ended."""


@dataclass(frozen=True)
class Alert:
    """One active alert."""

    id: AlertId
    source: int
    """Motor in firmware order where the alert concerns one, else 0."""
    value: int
    """In the unit of `UNITS`."""
    threshold: int
    first_set_us: int
    """Firmware time of the first cause."""
    last_set_us: int
    """Firmware time of the latest cause."""


class AlertBoard:
    """The active alerts and the sticky error word of one firmware run."""

    def __init__(self) -> None:
        self._active: dict[tuple[AlertId, int], Alert] = {}
        self.error_flags = 0
        """Bit 0 DAMP latched, bit 1+n critical alert n. Sticky."""

    @property
    def latched(self) -> bool:
        return bool(self.error_flags & DAMP_LATCHED)

    @property
    def active(self) -> tuple[Alert, ...]:
        """Active alerts, by id and source."""
        return tuple(self._active[key] for key in sorted(self._active))

    def is_active(self, alert: AlertId, source: int = 0) -> bool:
        return (alert, source) in self._active

    def set(self, alert: AlertId, now_us: int, value: int = 0, threshold: int = 0, source: int = 0) -> bool:
        """Note that the alert's cause is there now. True if that latched DAMP just now."""
        key = (alert, source)
        known = self._active.get(key)
        if known is None:
            self._active[key] = Alert(alert, source, value, threshold, now_us, now_us)
        else:
            self._active[key] = replace(known, value=value, last_set_us=now_us)
        if alert.severity is not Severity.CRITICAL:
            return False
        was_latched = self.latched
        self.error_flags |= DAMP_LATCHED | error_bit(alert)
        return not was_latched

    def expire(self, now_us: int) -> None:
        """Take down the alerts whose cause ended `CLEAR_DELAY_US` ago."""
        for key in [key for key, alert in self._active.items() if now_us - alert.last_set_us >= CLEAR_DELAY_US]:
            del self._active[key]
