"""What the firmware reports after a tick."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from asimov_gym.firmware.alerts import Alert
from asimov_gym.firmware.battery import BatteryState
from asimov_gym.firmware.can_bus import BusCounters, BusLosses, counters
from asimov_gym.firmware.linkage import Linkage
from asimov_gym.firmware.modes import Mode, State
from asimov_gym.firmware.policy_control import InferenceTime
from asimov_gym.firmware.watchdog import CycleTime


@dataclass(frozen=True)
class FirmwareState:
    """The robot at one instant, 200 times a second. Joint arrays are in joint order, motor arrays in firmware order
    (they differ in the ankle slots only), all (25,)."""

    boot: int
    """Which run of the firmware this is, counted from 1; a restart adds one."""
    epoch: int
    """Identity of this run, random, above 0 and below 2^63. With a `StepClock` it follows from seed and boot."""
    tick: int
    """Control steps since this boot."""
    timestamp_us: int
    """Firmware clock: microseconds since this boot."""
    state: State
    changes: tuple[tuple[State, State], ...]
    """What the machine went through since the control step before, from and to: a command may be undone by the next
    one before any control step sees it."""
    e_stop: bool
    """Whether the E-stop is pressed."""
    joint_position: np.ndarray
    """As sensed, rad."""
    joint_velocity: np.ndarray
    """As sensed, rad/s."""
    joint_torque: np.ndarray
    """Of the drives, N·m; not a reading of the robot's."""
    motor_torque: np.ndarray
    """Of the drives, N·m; not a reading of the robot's."""
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
    battery: BatteryState
    cycle: CycleTime
    """Timing of the control steps."""
    inference: InferenceTime
    """Timing of the network; all zero without one."""
    bus_losses: tuple[BusLosses, ...] = field(repr=False)
    linkage: Linkage = field(repr=False)

    @property
    def mode(self) -> Mode:
        return self.state.mode

    @property
    def latched(self) -> bool:
        """Whether a critical alert holds the robot in DAMP."""
        return bool(self.error_flags & 1)

    # What only telemetry needs is worked out when it asks.

    @cached_property
    def motor_position(self) -> np.ndarray:
        """As sensed, rad."""
        return self.linkage.motor_position(self.joint_position)

    @cached_property
    def motor_velocity(self) -> np.ndarray:
        """As sensed, rad/s."""
        return self.linkage.motor_velocity(self.joint_velocity, self.joint_position)

    @cached_property
    def can(self) -> tuple[BusCounters, ...]:
        """Counters of the buses since this boot, in the order of `can_bus.BUSES`."""
        return counters(self.tick, self.bus_losses)
