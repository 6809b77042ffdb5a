"""The five CAN buses: which motor is on which, who answers, counters, and the age of an answer.

The firmware sends every motor one command in each control step and gets one answer with position, speed, current and
temperature. A motor that has gone silent is limp, and its last answer stands.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from asimov_gym.firmware.alerts import AlertBoard
from asimov_gym.firmware.clock import MICROSECONDS
from asimov_gym.firmware.condition import Condition
from asimov_gym.robot.alerts import AlertId
from asimov_gym.robot.joints import JOINTS, MOTOR_NAMES

BUSES: dict[str, tuple[int, ...]] = {
    "left_leg": tuple(range(6)),
    "right_leg": tuple(range(6, 12)),
    "left_arm": tuple(range(12, 17)),
    "right_arm": tuple(range(17, 22)),
    "waist_neck": tuple(range(22, 25)),
}
"""Motors on each bus, in firmware order. Which arm is on which bus is disputed; the order here is that of the legs."""
BUS_NAMES = tuple(BUSES)

SLOT_S = 0.0015
"""Time between two motors of a bus in the polling order, s. Assumed: it puts the hips' answers at 6 to 7.5 ms of age
and the ankles' at 0 to 1.5 ms when the last one is in, within the 6 to 9 and 0 to 2 ms that were told of the robot."""
ANSWER_AGE_S = np.array([SLOT_S * (max(j.can_slot for j in JOINTS) - joint.can_slot) for joint in JOINTS])
"""Age of each motor's answer when the firmware works with it, s, (25,): the polling slot tells, the last is fresh."""


@dataclass(frozen=True)
class CanConfig:
    """How long a motor must be silent before the firmware says so, s. All assumed."""

    timeout_s: float = 0.01
    """CAN_TIMEOUT: two control steps without an answer on a bus."""
    missing_s: float = 0.02
    """MOTOR_MISSING, for each silent motor."""
    bus_off_s: float = 0.05
    """CAN_BUS_OFF: the controller of a bus that nobody acknowledges gives up."""
    loss_s: float = 0.1
    """MOTOR_PARTIAL_LOSS while some motors are lost, MOTOR_COMM_LOSS while all are: critical, latches DAMP."""

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not (math.isfinite(value) and 0.0 < value <= 60.0):
                raise ValueError(f"can {name} must be above 0 and at most 60, got {value!r}")


@dataclass(frozen=True)
class BusCounters:
    """Counters of one bus since the firmware's boot."""

    frames_sent: int
    frames_received: int
    errors: int
    """Commands that nobody answered."""
    bus_offs: int
    """How often the controller gave up."""


@dataclass(frozen=True)
class BusLosses:
    """What a bus has lost since boot, beside the one command and one answer of each motor and control step."""

    unsent: int = 0
    unanswered: int = 0
    bus_offs: int = 0


def counters(ticks: int, losses: tuple[BusLosses, ...]) -> tuple[BusCounters, ...]:
    """Counters of every bus after `ticks` control steps, in the order of `BUSES`."""
    result = []
    for motors, lost in zip(BUSES.values(), losses, strict=True):
        sent = ticks * len(motors) - lost.unsent
        result.append(BusCounters(sent, sent - lost.unanswered, lost.unanswered, lost.bus_offs))
    return tuple(result)


class CanBuses:
    """The firmware's side of the buses.

    Args:
        config: patience with silent motors.
    """

    def __init__(self, config: CanConfig) -> None:
        self.config = config
        self.reset()

    def reset(self) -> None:
        """The firmware boots: counters start at zero."""
        self.losses = (BusLosses(),) * len(BUSES)
        self._off: set[int] = set()

    def check(self, condition: Condition, board: AlertBoard, now_us: int, clock_us: int) -> bool:
        """One control step on the buses. True if a loss latched DAMP just now.

        Args:
            condition: of the hardware.
            board: takes the alerts; `source` is the bus for those of a bus, counted from 0.
            now_us: firmware time.
            clock_us: time of the robot's clock, which the silences are measured in.
        """
        if not condition.silent_since_us:
            self._off.clear()
            return False
        silence_us = {motor: clock_us - since for motor, since in condition.silent_since_us.items()}
        self._count(silence_us, board, now_us)
        for motor, silence in silence_us.items():
            _set_if_over(AlertId.MOTOR_MISSING, silence, self.config.missing_s, motor, board, now_us)
        lost = sum(silence >= round(self.config.loss_s * MICROSECONDS) for silence in silence_us.values())
        if lost == 0:
            return False
        alert = AlertId.MOTOR_COMM_LOSS if lost == len(MOTOR_NAMES) else AlertId.MOTOR_PARTIAL_LOSS
        return board.set(alert, now_us, value=lost, threshold=1)

    def _count(self, silence_us: dict[int, int], board: AlertBoard, now_us: int) -> None:
        """Count lost frames and raise the alerts of whole buses."""
        losses = []
        for index, (motors, before) in enumerate(zip(BUSES.values(), self.losses, strict=True)):
            quiet = [silence_us[motor] for motor in motors if motor in silence_us]
            # One answering motor acknowledges for the bus: it is the motor that is missing then, not the bus.
            dead_us = min(quiet) if len(quiet) == len(motors) else 0
            _set_if_over(AlertId.CAN_TIMEOUT, dead_us, self.config.timeout_s, index, board, now_us)
            was_off = index in self._off
            if _set_if_over(AlertId.CAN_BUS_OFF, dead_us, self.config.bus_off_s, index, board, now_us):
                self._off.add(index)
                lost = BusLosses(before.unsent + len(motors), before.unanswered, before.bus_offs + (not was_off))
            else:
                self._off.discard(index)
                lost = BusLosses(before.unsent, before.unanswered + len(quiet), before.bus_offs)
            losses.append(lost)
        self.losses = tuple(losses)


def _set_if_over(alert: AlertId, silence_us: int, limit_s: float, source: int, board: AlertBoard, now_us: int) -> bool:
    """Raise an alert, in milliseconds, if a silence has reached its limit; True if it has."""
    if silence_us < round(limit_s * MICROSECONDS):
        return False
    board.set(alert, now_us, silence_us // 1000, round(1000.0 * limit_s), source)
    return True
