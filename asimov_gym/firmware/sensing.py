"""What the firmware sees of the robot: the motors' answers on the bus and the IMU's samples.

As a rule that is the robot as it is. A silent motor's last answer stands, a faulty encoder stands still, a stopped IMU
repeats itself. On request every answer is as old as its motor's polling slot makes it (`ANSWER_AGE_S`): values between
the control steps are interpolated from the true ones of the last three. That is the history itself, so it serves speed
and current as well as position, which `position - age * speed` would not.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from asimov_gym.firmware.alerts import AlertBoard
from asimov_gym.firmware.can_bus import ANSWER_AGE_S
from asimov_gym.firmware.clock import MICROSECONDS
from asimov_gym.firmware.condition import Condition
from asimov_gym.firmware.linkage import Linkage
from asimov_gym.physics import Reading
from asimov_gym.robot.alerts import AlertId
from asimov_gym.robot.joints import JOINT_NAMES

_POSITION, _SPEED, _CURRENT, _TEMPERATURE = range(4)


@dataclass(frozen=True)
class Sense:
    """One look at the robot. Where all is well the arrays are those of the robot itself."""

    reading: Reading
    """A batch of one; joint positions and speeds, orientation and gyro as sensed, the rest as it is."""
    current: np.ndarray
    """A, (25,), firmware order."""
    temperature: np.ndarray
    """Degrees Celsius, (25,), firmware order."""


class Sensing:
    """The firmware's senses.

    Args:
        linkage: between ankle joints and motors.
        period_s: time between two control steps, s.
        aged: whether answers are as old as their polling slots make them.
    """

    def __init__(self, linkage: Linkage, period_s: float, aged: bool) -> None:
        self._linkage = linkage
        self._aged = aged
        steps = ANSWER_AGE_S / period_s
        nodes = np.arange(3.0)[:, None]
        # Weights of the answers 0, 1 and 2 control steps ago: a hat function around each.
        self._weights = np.maximum(0.0, 1.0 - np.abs(steps[None, :] - nodes))
        if not np.allclose(self._weights.sum(axis=0), 1.0):
            raise ValueError(f"answers are at most two control steps old, got {ANSWER_AGE_S.max()} s of {period_s} s")
        self._past: list[np.ndarray] = []
        self._last: Sense | None = None

    def forget(self) -> None:
        """The robot was put somewhere else: no history."""
        self._past = []
        self._last = None

    def remember(self, reading: Reading, current: np.ndarray, temperature: np.ndarray) -> None:
        """A control step begins at this state: it is history from now on. Arguments as for `look`."""
        if self._aged:
            now = self._answers(reading, current, temperature)
            self._past = [now, *(self._past or [now])][:2]

    def look(self, reading: Reading, current: np.ndarray, temperature: np.ndarray, condition: Condition) -> Sense:
        """Sense the robot.

        Args:
            reading: the robot as it is, a batch of one.
            current: of the motors, A, (25,).
            temperature: of the motors, degrees Celsius, (25,).
            condition: of the hardware.
        """
        if not self._aged and condition.silent is None and condition.encoder_fault is None:
            seen = reading
        else:
            answers = self._answers(reading, current, temperature)
            if self._aged and self._past:
                one, two = self._past[0], self._past[-1]
                answers = self._weights[0] * answers + self._weights[1] * one + self._weights[2] * two
                answers[_TEMPERATURE] = temperature
            if self._last is not None:
                self._hold(answers, self._last, condition)
            seen = self._with_joints(reading, answers)
            current, temperature = answers[_CURRENT], answers[_TEMPERATURE]
        if condition.imu_since_us is not None and self._last is not None:
            old = self._last.reading
            seen = replace(seen, base_quat=old.base_quat, gyro=old.gyro, gravity=old.gravity)
        self._last = Sense(seen, current, temperature)
        return self._last

    def _hold(self, answers: np.ndarray, last: Sense, condition: Condition) -> None:
        """Put the last answers where no new ones come from."""
        old = self._answers(last.reading, last.current, last.temperature)
        if condition.silent is not None:
            answers[:, condition.silent] = old[:, condition.silent]
        if condition.encoder_fault is not None:
            for row in (_POSITION, _SPEED):
                answers[row, condition.encoder_fault] = old[row, condition.encoder_fault]

    def _answers(self, reading: Reading, current: np.ndarray, temperature: np.ndarray) -> np.ndarray:
        """Position, speed, current and temperature of the motors, (4, 25)."""
        joint = reading.joint_position[0]
        speed = self._linkage.motor_velocity(reading.joint_velocity[0], joint)
        return np.stack([self._linkage.motor_position(joint), speed, current, temperature])

    def _with_joints(self, reading: Reading, answers: np.ndarray) -> Reading:
        joint = self._linkage.joint_position(answers[_POSITION])
        speed = self._linkage.joint_velocity(answers[_SPEED], joint)
        return replace(reading, joint_position=joint[None], joint_velocity=speed[None])


@dataclass(frozen=True)
class ImuWatch:
    """Raises alerts when the IMU's samples grow old. Both times are assumed, s."""

    stale_s: float
    failure_s: float

    def check(self, condition: Condition, board: AlertBoard, now_us: int, clock_us: int) -> bool:
        """Look at the age of the last sample. True if it latched DAMP just now.

        Args:
            condition: of the hardware.
            board: takes the alerts.
            now_us: firmware time.
            clock_us: time of the robot's clock.
        """
        if condition.imu_since_us is None:
            return False
        age_us = clock_us - condition.imu_since_us
        value, latched = age_us // 1000, False
        if age_us >= round(self.stale_s * MICROSECONDS):
            board.set(AlertId.IMU_STALE, now_us, value, round(1000.0 * self.stale_s))
        if age_us >= round(self.failure_s * MICROSECONDS):
            latched = board.set(AlertId.IMU_FAILURE, now_us, value, round(1000.0 * self.failure_s))
        return latched


def silent_joints(silent: np.ndarray) -> np.ndarray:
    """Joints that a silent motor leaves limp, bool (25,), from the silent motors (25,).

    An ankle whose one motor is limp cannot be held in either axis by the other, so both its joints go.
    """
    joints = silent.copy()
    for side in ("left", "right"):
        pair = [JOINT_NAMES.index(f"{side}_ankle_{axis}_joint") for axis in ("pitch", "roll")]
        joints[pair] = silent[pair].any()
    return joints
