"""The robot's alert catalogue and its error word. Numbers and severities are published with its protocol."""

from __future__ import annotations

from enum import IntEnum


class Severity(IntEnum):
    """Severity as telemetry carries it."""

    CRITICAL = 0
    WARNING = 1
    INFO = 2


class AlertId(IntEnum):
    """The catalogue, in blocks of 16: critical, warning, info."""

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
