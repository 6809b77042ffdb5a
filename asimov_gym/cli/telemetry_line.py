"""A robot's telemetry on one line, for people."""

from __future__ import annotations

import math

from asimov_gym.edge.wire.cloud_pb2 import EdgeTelemetry, FirmwareMode
from asimov_gym.robot.alerts import DAMP_LATCHED, AlertId, Severity, error_bit
from asimov_gym.robot.joints import MOTOR_NAMES


def mode_name(telemetry: EdgeTelemetry) -> str:
    """DAMP, STAND or MOVE."""
    return FirmwareMode.Name(telemetry.fw_mode).removeprefix("FW_MODE_")


def fault_names(error_flags: int) -> list[str]:
    """The critical alerts whose bits are set in the error word."""
    critical = [alert for alert in AlertId if alert.severity is Severity.CRITICAL]
    names = [alert.name for alert in critical if error_flags & error_bit(alert)]
    return names or (["unknown"] if error_flags & ~DAMP_LATCHED else [])


def telemetry_line(telemetry: EdgeTelemetry) -> str:
    """Mode, tilt, hottest motor, strongest current and what is wrong."""
    words = [f"{mode_name(telemetry):<5}"]
    if len(telemetry.imu_gravity) == 3:
        tilt = math.degrees(math.acos(max(-1.0, min(1.0, -telemetry.imu_gravity[2]))))
        words.append(f"tilt {tilt:4.1f}°")
    for values, unit in ((telemetry.joint_temp, "°C"), (telemetry.joint_current, "A")):
        if len(values) == len(MOTOR_NAMES):
            most = max(range(len(values)), key=lambda motor: abs(values[motor]))
            words.append(f"{MOTOR_NAMES[most]} {values[most]:.1f} {unit}")
    if telemetry.error_flags:
        words.append(f"FAULT {', '.join(fault_names(telemetry.error_flags)) or 'latched'}")
    return "  ".join(words)
