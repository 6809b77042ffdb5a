"""The robot's telemetry as an observation: the fixed-shape numeric fields of the message, under their names there.

Joint fields are in motor order, the ankles as the motors A and B, just as the robot reports them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from asimov_gym.physics import Reading
from asimov_gym.robot import ankle
from asimov_gym.robot.alerts import DAMP_LATCHED, AlertId, error_bit
from asimov_gym.robot.array_library import integer, namespace
from asimov_gym.robot.joints import JOINT_NAMES, RANGE, VELOCITY_LIMIT, joint_index
from asimov_gym.robot.motor import PEAK_CURRENT, motor_current
from asimov_gym.robot.safety_limits import TRIP_C, WARNING_C

FW_MODE_MOVE = 2
"""What `fw_mode` says while joints are driven; 0 is DAMP, 1 is STAND."""
_ANKLE_ROLL = np.array([joint_index(f"{side}_ankle_roll_joint") for side in ("left", "right")])


def motor_range(form: ankle.Form) -> np.ndarray:
    """Range of each motor's angle over the joints' ranges, rad, (25, 2)."""
    # An ankle's motors are at their extremes in the corners of the range of pitch and roll.
    corners = np.repeat(RANGE.T[:, None], 2, axis=1)
    corners[:, :, _ANKLE_ROLL] = RANGE.T[None, :, _ANKLE_ROLL]
    angles = ankle.to_motor_position(corners.reshape(4, -1), form)
    return np.stack([angles.min(axis=0), angles.max(axis=0)], axis=-1)


@dataclass(frozen=True)
class Field:
    """Finite bounds of a field in the observation, (n,); values are clipped to them."""

    low: np.ndarray
    high: np.ndarray


def _symmetric(bound: np.ndarray) -> Field:
    return Field(-bound, bound)


def measured_fields(form: ankle.Form) -> Mapping[str, Field]:
    """The real-valued fields in the message's order."""
    angles, n = motor_range(form), len(JOINT_NAMES)
    return MappingProxyType(
        {
            "joint_pos": Field(angles[:, 0] - 0.5, angles[:, 1] + 0.5),
            "joint_vel": _symmetric(3.0 * VELOCITY_LIMIT),
            "joint_current": _symmetric(PEAK_CURRENT),
            "joint_temp": Field(np.full(n, -40.0), np.full(n, 150.0)),
            "imu_quat": _symmetric(np.ones(4)),
            "imu_gyro": _symmetric(np.full(3, 40.0)),
            "imu_gravity": _symmetric(np.ones(3)),
        }
    )


def measure(reading: Reading, torque: Any, temperature: Any, form: ankle.Form) -> dict[str, Any]:
    """Values of the real-valued fields, float32, (N, n) each, within their bounds.

    Args:
        reading: the robots.
        torque: of the motors, N·m, (N, 25).
        temperature: of the motors, degrees Celsius, (N, 25).
        form: of the ankle linkage.
    """
    xp = namespace(reading.gyro)
    values = {
        "joint_pos": ankle.to_motor_position(reading.joint_position, form),
        "joint_vel": ankle.to_motor_velocity(reading.joint_velocity, reading.joint_position, form),
        "joint_current": motor_current(torque),
        "joint_temp": temperature,
        "imu_quat": reading.base_quat,
        "imu_gyro": reading.gyro,
        "imu_gravity": reading.gravity,
    }
    return {name: clip_to(xp, values[name], field) for name, field in measured_fields(form).items()}


def clip_to(xp: Any, value: Any, field: Field) -> Any:
    """The value as float32 within the bounds of its field."""
    low, high = xp.asarray(field.low, dtype=xp.float32), xp.asarray(field.high, dtype=xp.float32)
    return xp.clip(xp.astype(value, xp.float32), low, high)


def alert_count(fallen: Any, temperature: Any) -> Any:
    """How many alerts are active, (N,) int.

    Args:
        fallen: (N,) bool.
        temperature: of the motors, degrees Celsius, (N, 25).
    """
    xp = namespace(temperature)
    count = integer(xp)
    hot = xp.sum(xp.astype(temperature >= WARNING_C, count) + xp.astype(temperature >= TRIP_C, count), axis=-1)
    return hot + xp.astype(fallen, count)


def error_flags(fallen: Any, temperature: Any) -> Any:
    """The robot's error bits, (N,) int; arguments as of `alert_count`."""
    xp = namespace(temperature)
    tripped = xp.any(temperature >= TRIP_C, axis=-1)
    bits = error_bit(AlertId.FALL_DETECTED) * xp.astype(fallen, integer(xp))
    bits = bits + error_bit(AlertId.MOTOR_OVERTEMP) * xp.astype(tripped, integer(xp))
    return bits + DAMP_LATCHED * xp.astype(fallen | tripped, integer(xp))


def active_alerts(fallen: bool, temperature: np.ndarray) -> tuple[tuple[int, int], ...]:
    """Alerts of one robot as (id, source): source is the motor, 0 for a fall. `temperature` is (25,)."""
    falls = ((int(AlertId.FALL_DETECTED), 0),) if fallen else ()
    trips = tuple((int(AlertId.MOTOR_OVERTEMP), int(motor)) for motor in np.flatnonzero(temperature >= TRIP_C))
    return (
        falls
        + trips
        + tuple((int(AlertId.MOTOR_TEMP_HIGH), int(motor)) for motor in np.flatnonzero(temperature >= WARNING_C))
    )
