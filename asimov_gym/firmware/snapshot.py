"""What the firmware reports after a tick."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from asimov_gym.firmware.alerts import Alert
from asimov_gym.firmware.modes import Mode, State


@dataclass(frozen=True)
class FirmwareState:
    """The robot at one instant, 200 times a second. Joint arrays are in joint order, motor arrays in firmware order
    (they differ in the ankle slots only), all (25,)."""

    boot: int
    """Which run of the firmware this is, counted from 1; a restart adds one."""
    timestamp_us: int
    """Firmware clock: microseconds since this boot."""
    state: State
    joint_position: np.ndarray
    """rad."""
    joint_velocity: np.ndarray
    """rad/s."""
    joint_torque: np.ndarray
    """N·m."""
    motor_position: np.ndarray
    """rad."""
    motor_velocity: np.ndarray
    """rad/s."""
    motor_torque: np.ndarray
    """N·m."""
    motor_current: np.ndarray
    """A."""
    motor_temperature: np.ndarray
    """Degrees Celsius."""
    imu_quat: np.ndarray
    """Orientation (w, x, y, z), body to world, (4,)."""
    imu_gyro: np.ndarray
    """Angular velocity, body frame, rad/s, (3,)."""
    imu_gravity: np.ndarray
    """Unit vector to the ground, body frame, (3,)."""
    alerts: tuple[Alert, ...]
    error_flags: int
    """Bit 0 DAMP latched, bit 1+n critical alert n; sticky until restart."""
    velocity: np.ndarray
    """The command that the policy walks by, after its own clamp: vx, vy (m/s), yaw rate (rad/s), (3,)."""
    gantry_force: float
    """Tension of the gantry's rope, N; exactly 0 while it is slack."""

    @property
    def mode(self) -> Mode:
        return self.state.mode

    @property
    def latched(self) -> bool:
        """Whether a critical alert holds the robot in DAMP."""
        return bool(self.error_flags & 1)
