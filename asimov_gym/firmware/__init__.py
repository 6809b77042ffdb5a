"""The robot's firmware in simulation: mode machine, 200 Hz loop, safety, motors, gantry, clocks."""

from asimov_gym.firmware.alerts import CLEAR_DELAY_US, UNITS, Alert, AlertBoard
from asimov_gym.firmware.clock import MICROSECONDS, Clock, StepClock, WallClock
from asimov_gym.firmware.commands import Command, Damp, Stand, Trajectory, Velocity
from asimov_gym.firmware.config import FirmwareConfig
from asimov_gym.firmware.firmware import Firmware, Receipt
from asimov_gym.firmware.gantry import Gantry, GantryConfig, GantryMode
from asimov_gym.firmware.linkage import Linkage
from asimov_gym.firmware.modes import TRANSITIONS, Mode, Outcome, State, Transition, Trigger, transition
from asimov_gym.firmware.motors import MotorConfig, Motors
from asimov_gym.firmware.policy_control import PolicyControl, PolicyFault
from asimov_gym.firmware.snapshot import FirmwareState
from asimov_gym.robot.alerts import AlertId, Severity, error_bit

__all__ = [
    "CLEAR_DELAY_US",
    "MICROSECONDS",
    "TRANSITIONS",
    "UNITS",
    "Alert",
    "AlertBoard",
    "AlertId",
    "Clock",
    "Command",
    "Damp",
    "Firmware",
    "FirmwareConfig",
    "FirmwareState",
    "Gantry",
    "GantryConfig",
    "GantryMode",
    "Linkage",
    "Mode",
    "MotorConfig",
    "Motors",
    "Outcome",
    "PolicyControl",
    "PolicyFault",
    "Receipt",
    "Severity",
    "Stand",
    "State",
    "StepClock",
    "Trajectory",
    "Transition",
    "Trigger",
    "Velocity",
    "WallClock",
    "error_bit",
    "transition",
]
