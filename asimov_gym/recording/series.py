"""A recording's telemetry and commands as arrays over time."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from asimov_gym.edge import Dialect
from asimov_gym.edge.dialect import RULES
from asimov_gym.edge.wire import cloud_pb2, io_pb2
from asimov_gym.recording.reader import read_notes, read_recording
from asimov_gym.recording.schemas import COMMANDS, ROBOT_STATE, STATE
from asimov_gym.robot import ankle
from asimov_gym.robot.joints import MOTOR_NAMES
from asimov_gym.robot.motor import KT

_MICROSECONDS = 1_000_000
_MOTORS = len(MOTOR_NAMES)


@dataclass(frozen=True)
class TelemetrySeries:
    """What the robot reported over time, n samples. Motor arrays are (n, 25) in firmware order with the ankles' motors
    A and B."""

    time: np.ndarray
    """Since the recording's first message, s, (n,)."""
    motor_position: np.ndarray
    """rad."""
    motor_velocity: np.ndarray
    """rad/s."""
    motor_current: np.ndarray
    """A."""
    motor_temperature: np.ndarray
    """Degrees Celsius."""
    imu_quat: np.ndarray
    """Orientation (w, x, y, z), body to world, (n, 4)."""
    imu_gyro: np.ndarray
    """Angular velocity, body frame, rad/s, (n, 3)."""
    imu_gravity: np.ndarray
    """Unit vector to the ground, body frame, (n, 3)."""
    error_flags: np.ndarray
    """(n,)."""
    ankle: ankle.Form
    """Mechanics of the ankle linkage that the robot had."""

    def motor_torque(self) -> np.ndarray:
        """Torques at the output shafts that the currents stand for, N·m, (n, 25), firmware order."""
        return self.motor_current * KT

    def joint_position(self) -> np.ndarray:
        """Joint angles in joint order, rad, (n, 25)."""
        return ankle.to_joint_position(self.motor_position, self.ankle)

    def joint_velocity(self) -> np.ndarray:
        """Joint speeds in joint order, rad/s, (n, 25)."""
        return ankle.to_joint_velocity(self.motor_velocity, self.joint_position(), self.ankle)


@dataclass(frozen=True)
class VelocityCommands:
    """Velocity commands that the robot took, as it received them, k of them."""

    time: np.ndarray
    """Since the recording's first message, s, (k,)."""
    velocity: np.ndarray
    """vx, vy (m/s) and yaw rate (rad/s), (k, 3)."""


def read_telemetry(path: str | Path) -> TelemetrySeries:
    """The robot's reports, from the denser of the two topics that hold them.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: it is not a recording, or holds no telemetry.
    """
    start = first_time_us(path)
    entries = list(read_recording(path, [ROBOT_STATE]))
    read = _robot_state
    if not entries:
        entries, read = list(read_recording(path, [STATE])), _telemetry
    if not entries:
        raise ValueError(f"{path} holds no telemetry")
    rows = [(entry.time_us, *read(entry.message)) for entry in entries]
    columns = [np.array(column, dtype=np.float64) for column in _complete(path, rows)]
    if read is _robot_state:
        columns[1:5] = [RULES[Dialect.IO].to_joint_order(column.T).T for column in columns[1:5]]
    columns[0] = (columns[0] - start) / _MICROSECONDS
    return TelemetrySeries(*columns, ankle=recorded_ankle(path))


def read_velocity_commands(path: str | Path) -> VelocityCommands:
    """The accepted velocity commands, of either dialect.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: it is not a recording.
    """
    start = first_time_us(path)
    times, values = [], []
    for entry in read_recording(path, [COMMANDS]):
        command: Any = entry.message
        if command.kind != "velocity" or command.verdict != "accepted":
            continue
        if command.dialect == Dialect.IO.value:
            velocity: Any = io_pb2.RobotCommand.FromString(command.payload).policy
        else:
            velocity = cloud_pb2.CloudCommand.FromString(command.payload).velocity
        times.append((entry.time_us - start) / _MICROSECONDS)
        values.append((velocity.vx, velocity.vy, velocity.vyaw))
    return VelocityCommands(np.array(times), np.array(values).reshape(-1, 3))


def first_time_us(path: str | Path) -> int:
    """Edge wall clock of the recording's first message, microseconds.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: it is not a recording, or holds no message.
    """
    for entry in read_recording(path):
        return entry.time_us
    raise ValueError(f"{path} holds no message")


def recorded_ankle(path: str | Path) -> ankle.Form:
    """Form of the ankle linkage that the recorded robot had; linear where the file does not say.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: it is not a recording, or names an unknown form.
    """
    form: Any = read_notes(path).get("ankle", "linear")
    if form not in ankle.FORMS:
        raise ValueError(f"{path}: note `ankle` must be one of {', '.join(ankle.FORMS)}, got {form!r}")
    return form


def _telemetry(message: Any) -> tuple[Any, ...]:
    m = message
    motors = (m.joint_pos, m.joint_vel, m.joint_current, m.joint_temp)
    return (*motors, m.imu_quat, m.imu_gyro, m.imu_gravity, m.error_flags)


def _robot_state(message: Any) -> tuple[Any, ...]:
    m = message
    motors = (m.joint_pos, m.joint_vel, m.joint_current, m.joint_temp)
    return (*motors, m.base_quat, m.base_ang_vel, m.projected_gravity, m.error_flags)


def _complete(path: str | Path, rows: Iterable[tuple[Any, ...]]) -> list[tuple[Any, ...]]:
    """The columns, of rows whose arrays all have their lengths."""
    widths = (_MOTORS,) * 4 + (4, 3, 3)
    for row in rows:
        if any(len(values) != width for values, width in zip(row[1:8], widths, strict=True)):
            raise ValueError(f"{path}: a telemetry frame lacks values: it is not one of this robot")
    return list(zip(*rows, strict=True))
