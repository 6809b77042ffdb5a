"""Alerts, error flags and the latch.

An alert is up while its cause lasts and for 2.5 s after. A critical one also latches DAMP: its bit in the error word
and bit 0 stay until the firmware restarts. Numbers and severities are those of the robot's alert catalogue.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from asimov_gym.firmware.clock import MICROSECONDS
from asimov_gym.robot.alerts import DAMP_LATCHED, AlertId, Severity, error_bit

UNITS = {
    AlertId.MOTOR_COMM_LOSS: "motors lost: all",
    AlertId.MOTOR_OVERCURRENT: "0.1 A",
    AlertId.MOTOR_OVERTEMP: "0.1 deg C",
    AlertId.IMU_FAILURE: "ms since the last sample",
    AlertId.WATCHDOG_TIMEOUT: "ms of standstill; 0 if the simulation diverged",
    AlertId.MOTOR_ENCODER_ERROR: "error code of the driver, 5; threshold 0",
    AlertId.FALL_DETECTED: "0.1 deg of tilt",
    AlertId.POLICY_SPAZ: "0.001 of the largest action; 2^32-1 if not finite",
    AlertId.TUMBLE_DETECTED: "0.1 deg of tilt, or 0.1 deg/s of body rate; the threshold tells which",
    AlertId.MOTOR_PARTIAL_LOSS: "motors lost",
    AlertId.JOINT_OUT_OF_RANGE: "mrad past the joint's range",
    AlertId.BMS_PROTECTION: "protection flags; threshold 0",
    AlertId.INFERENCE_FAILURE: "0.1 ms without an answer; 0 if the network raised an error",
    AlertId.MOTOR_TEMP_HIGH: "0.1 deg C",
    AlertId.POLICY_LATE: "0.1 ms from question to answer, so far",
    AlertId.CAN_TIMEOUT: "ms without an answer on the bus",
    AlertId.CAN_BUS_OFF: "ms without an answer on the bus",
    AlertId.BMS_LOW_SOC: "0.1 % of charge",
    AlertId.INVALID_GAINS: "0.01 of the size of the first unusable gain; threshold: the bound it passed",
    AlertId.MODE_CHANGE: "mode entered; threshold: mode left",
    AlertId.POLICY_INFERENCE_TIMEOUT: "0.1 ms from question to answer, so far",
    AlertId.POLICY_DEADLINE_MISS: "0.1 ms from question to answer, so far",
    AlertId.IMU_STALE: "ms since the last sample",
    AlertId.MOTOR_MISSING: "ms without an answer",
}
"""Unit of an alert's `value` and `threshold` (whole numbers on the wire). Not published for the robot: ours.

These are the alerts that the simulated hardware can cause. Those of the catalogue that are not here have no cause in
the simulation and come by injection alone."""

CLEAR_DELAY_US = round(2.5 * MICROSECONDS)
"""An alert goes away this long after its cause ended."""


@dataclass(frozen=True)
class Alert:
    """One active alert."""

    id: AlertId
    source: int
    """Motor in firmware order where the alert concerns one, the bus for CAN_TIMEOUT and CAN_BUS_OFF, else 0."""
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
        self._sorted: tuple[Alert, ...] | None = ()
        self.error_flags = 0
        """Bit 0 DAMP latched, bit 1+n critical alert n. Sticky."""

    @property
    def latched(self) -> bool:
        return bool(self.error_flags & DAMP_LATCHED)

    @property
    def active(self) -> tuple[Alert, ...]:
        """Active alerts, by id and source."""
        if self._sorted is None:
            self._sorted = tuple(self._active[key] for key in sorted(self._active))
        return self._sorted

    def is_active(self, alert: AlertId, source: int = 0) -> bool:
        return (alert, source) in self._active

    def set(self, alert: AlertId, now_us: int, value: int = 0, threshold: int = 0, source: int = 0) -> bool:
        """Note that the alert's cause is there now. True if that latched DAMP just now."""
        key = (alert, source)
        self._sorted = None
        known = self._active.get(key)
        if known is None:
            self._active[key] = Alert(alert, source, value, threshold, now_us, now_us)
        else:
            self._active[key] = replace(known, value=value, threshold=threshold, last_set_us=now_us)
        if alert.severity is not Severity.CRITICAL:
            return False
        was_latched = self.latched
        self.error_flags |= DAMP_LATCHED | error_bit(alert)
        return not was_latched

    def expire(self, now_us: int) -> None:
        """Take down the alerts whose cause ended `CLEAR_DELAY_US` ago."""
        if not self._active:
            return
        for key in [key for key, alert in self._active.items() if now_us - alert.last_set_us >= CLEAR_DELAY_US]:
            del self._active[key]
            self._sorted = None
