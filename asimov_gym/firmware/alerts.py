"""Alerts, error flags and the latch.

An alert is up while its cause lasts and for 2.5 s after. A critical one also latches DAMP: its bit in the error word
and bit 0 stay until the firmware restarts. Numbers and severities are those of the robot's alert catalogue.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum

from asimov_gym.firmware.clock import MICROSECONDS


class AlertId(IntEnum):
    """The catalogue, in blocks of 16: critical, warning, info. The firmware here raises the six that its simulated
    hardware can cause; others can be injected (`Firmware.inject`)."""

    MOTOR_COMM_LOSS = 0
    MOTOR_OVERCURRENT = 1
    MOTOR_OVERTEMP = 2
    IMU_FAILURE = 3
    WATCHDOG_TIMEOUT = 4
    MOTOR_ENCODER_ERROR = 5
    FALL_DETECTED = 7
    POLICY_SPAZ = 8
    TUMBLE_DETECTED = 9
    MOTOR_PARTIAL_LOSS = 10
    JOINT_OUT_OF_RANGE = 11
    BMS_COMM_LOSS = 12
    BMS_PROTECTION = 13
    INFERENCE_FAILURE = 14
    MOTOR_DRV_FAULT = 16
    MOTOR_TEMP_HIGH = 17
    IMU_DEGRADED = 18
    CAN_ERRORS = 19
    POLICY_LATE = 20
    CAN_TIMEOUT = 21
    CAN_BUS_OFF = 22
    CAN_TX_FAILURE = 23
    MOTOR_UNDERVOLTAGE = 24
    MOTOR_BRAKE_OVERVOLT = 25
    CAN_UTILIZATION_HIGH = 26
    BMS_LOW_SOC = 27
    INVALID_GAINS = 28
    MODE_CHANGE = 32
    IMU_STALE = 34
    IMU_CALIBRATION_LOW = 35
    POLICY_INFERENCE_TIMEOUT = 36
    POLICY_DEADLINE_MISS = 37
    MOTOR_MISSING = 38
    INFERENCE_JITTER = 39
    IMU_RATE_DROP = 40
    BMS_CELL_TEMP_HIGH = 41

    @property
    def severity(self) -> Severity:
        return Severity(self.value // 16)


class Severity(IntEnum):
    """Severity as telemetry carries it."""

    CRITICAL = 0
    WARNING = 1
    INFO = 2


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

DAMP_LATCHED = 1
"""Bit 0 of the error word."""


def error_bit(alert: AlertId) -> int:
    """The bit of a critical alert in the error word: shifted by one, since bit 0 is the latch.

    Raises:
        ValueError: the alert is not critical and has no bit.
    """
    if alert.severity is not Severity.CRITICAL:
        raise ValueError(f"alert {alert.name} is {alert.severity.name}; only critical alerts (ids 0 to 15) have a bit")
    return 1 << (1 + alert)


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
