"""The robot's firmware in simulation: mode machine, 200 Hz loop, safety, motors, buses, gantry, faults."""

from asimov_gym.firmware.alerts import CLEAR_DELAY_US, UNITS, Alert, AlertBoard
from asimov_gym.firmware.battery import Battery, BatteryConfig, BatteryState
from asimov_gym.firmware.can_bus import ANSWER_AGE_S, BUS_NAMES, BUSES, BusCounters, CanConfig
from asimov_gym.firmware.clock import MICROSECONDS, Clock, StepClock, WallClock
from asimov_gym.firmware.commands import Command, Damp, Freeze, Stand, Stream, Trajectory, Velocity
from asimov_gym.firmware.condition import Condition
from asimov_gym.firmware.config import FirmwareConfig
from asimov_gym.firmware.faults import FaultInjector
from asimov_gym.firmware.firmware import Firmware
from asimov_gym.firmware.gantry import Gantry, GantryConfig, GantryMode, HandSetting
from asimov_gym.firmware.joint_command import Advice, JointCommand, JointGains
from asimov_gym.firmware.joint_control import (
    Echo,
    JointControl,
    JointControlConfig,
    JointFault,
    Refusal,
    RunEnd,
)
from asimov_gym.firmware.joint_sample import JointSample
from asimov_gym.firmware.linkage import Linkage
from asimov_gym.firmware.mode_control import Receipt
from asimov_gym.firmware.modes import HELD, TRANSITIONS, Hold, Mode, Outcome, State, Transition, Trigger, transition
from asimov_gym.firmware.motors import MotorConfig, Motors
from asimov_gym.firmware.policy_control import InferenceConfig, InferenceTime, PolicyControl, PolicyFault
from asimov_gym.firmware.snapshot import FirmwareState
from asimov_gym.firmware.watchdog import CycleTime
from asimov_gym.robot.alerts import AlertId, Severity, error_bit

__all__ = [
    "ANSWER_AGE_S",
    "BUSES",
    "BUS_NAMES",
    "CLEAR_DELAY_US",
    "HELD",
    "MICROSECONDS",
    "TRANSITIONS",
    "UNITS",
    "Advice",
    "Alert",
    "AlertBoard",
    "AlertId",
    "Battery",
    "BatteryConfig",
    "BatteryState",
    "BusCounters",
    "CanConfig",
    "Clock",
    "Command",
    "Condition",
    "CycleTime",
    "Damp",
    "Echo",
    "FaultInjector",
    "Firmware",
    "FirmwareConfig",
    "FirmwareState",
    "Freeze",
    "Gantry",
    "GantryConfig",
    "GantryMode",
    "HandSetting",
    "Hold",
    "InferenceConfig",
    "InferenceTime",
    "JointCommand",
    "JointControl",
    "JointControlConfig",
    "JointFault",
    "JointGains",
    "JointSample",
    "Linkage",
    "Mode",
    "MotorConfig",
    "Motors",
    "Outcome",
    "PolicyControl",
    "PolicyFault",
    "Receipt",
    "Refusal",
    "RunEnd",
    "Severity",
    "Stand",
    "State",
    "StepClock",
    "Stream",
    "Trajectory",
    "Transition",
    "Trigger",
    "Velocity",
    "WallClock",
    "error_bit",
    "transition",
]
