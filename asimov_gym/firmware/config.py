"""Figures of the firmware: times, thresholds and gains."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from asimov_gym.firmware.battery import BatteryConfig
from asimov_gym.firmware.can_bus import CanConfig
from asimov_gym.firmware.gantry import GantryConfig
from asimov_gym.firmware.joint_control import JointControlConfig
from asimov_gym.firmware.motors import MotorConfig
from asimov_gym.firmware.policy_control import InferenceConfig
from asimov_gym.firmware.stand import RAMP_S
from asimov_gym.robot.ankle import FORMS, Form
from asimov_gym.robot.safety_limits import (
    FALL_GRAVITY_Z,
    TRIP_C,
    TRIP_CLEAR_C,
    TUMBLE_RATE,
    TUMBLE_TILT_DEG,
    WARNING_C,
)


@dataclass(frozen=True)
class FirmwareConfig:
    """Times and thresholds of the robot. Those marked assumed are published by nobody."""

    stand_ramp_s: float = RAMP_S
    """Time from the present pose to the standing pose."""
    trajectory_timeout_s: float = 0.2
    """MOVE/TRAJECTORY falls back to DAMP after this long without a request, unless the last one says otherwise."""
    damp_kd: float = 2.0
    """Damping of every joint in DAMP, N·m·s/rad. Assumed."""
    fall_gravity_z: float = FALL_GRAVITY_Z
    """A fall is when the body-frame gravity's z rises above this: tilt over 60 degrees."""
    tumble_tilt_deg: float = TUMBLE_TILT_DEG
    """A tumble is a tilt beyond this, degrees. Assumed."""
    tumble_rate: float = TUMBLE_RATE
    """Or a body rate beyond this, rad/s. Assumed."""
    warning_c: float = WARNING_C
    """Motor temperature that raises a warning, degrees Celsius."""
    trip_c: float = TRIP_C
    """Motor temperature that latches DAMP, degrees Celsius."""
    trip_clear_c: float = TRIP_CLEAR_C
    """The over-temperature alert's cause lasts until the motor is below this, degrees Celsius. Assumed."""
    range_margin: float = 0.05
    """A joint is out of range when it is this far past its limit, rad. Assumed."""
    overcurrent_s: float = 0.05
    """A motor's current may be beyond its family's peak for this long, s. Assumed."""
    imu_stale_s: float = 0.01
    """IMU_STALE after this long without a new sample, s. Assumed."""
    imu_failure_s: float = 0.1
    """IMU_FAILURE, which latches DAMP, after this long without a new sample, s. Assumed."""
    watchdog_s: float = 0.5
    """A gap of this long between two control steps is a fault, s; in real time only. Assumed, and lenient: a busy
    machine is late, and says so in its diagnostics, but the robot goes on."""
    ankle: Form = "linear"
    """Mechanics of the ankle linkage: `linear` as the firmware computes it, or `exact`."""
    aged_readings: bool = False
    """Whether each joint reading is as old as its motor's polling slot makes it, up to 7.5 ms; see `can_bus`."""
    inference: InferenceConfig = field(default_factory=InferenceConfig)
    joint_control: JointControlConfig = field(default_factory=JointControlConfig)
    can: CanConfig = field(default_factory=CanConfig)
    battery: BatteryConfig = field(default_factory=BatteryConfig)
    gantry: GantryConfig = field(default_factory=GantryConfig)
    motors: MotorConfig = field(default_factory=MotorConfig)

    def __post_init__(self) -> None:
        allowed = {
            "stand_ramp_s": (0.0, 60.0),
            "trajectory_timeout_s": (0.005, 60.0),
            "damp_kd": (0.0, 5.0),
            "fall_gravity_z": (-1.0, 1.0),
            "tumble_tilt_deg": (0.0, 180.0),
            "tumble_rate": (0.0, 1e3),
            "warning_c": (-50.0, 300.0),
            "trip_c": (-50.0, 300.0),
            "trip_clear_c": (-50.0, 300.0),
            "range_margin": (0.0, 1.0),
            "overcurrent_s": (0.0, 60.0),
            "imu_stale_s": (0.0, 60.0),
            "imu_failure_s": (0.0, 60.0),
            "watchdog_s": (0.05, 3600.0),
        }
        for name, (low, high) in allowed.items():
            value = getattr(self, name)
            if not (math.isfinite(value) and low <= value <= high):
                raise ValueError(f"firmware {name} must be between {low} and {high}, got {value!r}")
        if self.ankle not in FORMS:
            raise ValueError(f"firmware ankle must be one of {', '.join(FORMS)}, got {self.ankle!r}")
        if self.trip_clear_c > self.trip_c:
            raise ValueError(f"firmware trip_clear_c must be at most trip_c = {self.trip_c}, got {self.trip_clear_c}")
