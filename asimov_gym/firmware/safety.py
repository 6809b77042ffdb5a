"""The checks that run every tick and raise alerts: fall, joint range, motor heat."""

from __future__ import annotations

import math

import numpy as np

from asimov_gym.firmware.alerts import AlertBoard
from asimov_gym.firmware.config import FirmwareConfig
from asimov_gym.firmware.modes import State
from asimov_gym.physics import Reading
from asimov_gym.robot.alerts import AlertId
from asimov_gym.robot.joints import RANGE


def tilt(gravity: np.ndarray) -> float:
    """Angle of the body from upright, rad, from body-frame gravity (3,)."""
    return math.acos(max(-1.0, min(1.0, -float(gravity[2]))))


class Safety:
    """Raises the alerts that the simulated hardware can cause.

    Fall and joint range are watched only while the robot is driven: lying down after a DAMP is no fault.
    """

    def __init__(self, config: FirmwareConfig) -> None:
        self.config = config

    def check(self, state: State, reading: Reading, temperature: np.ndarray, board: AlertBoard, now_us: int) -> bool:
        """Look at the robot. True if something latched DAMP just now.

        Args:
            state: present state of the mode machine.
            reading: the robot, a batch of one.
            temperature: of the motors, degrees Celsius, (25,).
            board: takes the alerts.
            now_us: firmware time.
        """
        latched = self._check_heat(temperature, board, now_us)
        if state is not State.DAMP:
            latched |= self._check_fall(reading, board, now_us)
            latched |= self._check_range(reading, board, now_us)
        return latched

    def _check_fall(self, reading: Reading, board: AlertBoard, now_us: int) -> bool:
        if reading.gravity[0, 2] <= self.config.fall_gravity_z:
            return False
        value = round(10.0 * math.degrees(tilt(reading.gravity[0])))
        threshold = round(10.0 * math.degrees(math.acos(-self.config.fall_gravity_z)))
        return board.set(AlertId.FALL_DETECTED, now_us, value, threshold)

    def _check_range(self, reading: Reading, board: AlertBoard, now_us: int) -> bool:
        position = reading.joint_position[0]
        beyond = np.maximum(position - RANGE[:, 1], RANGE[:, 0] - position)
        latched = False
        for joint in np.flatnonzero(beyond > self.config.range_margin):
            value, threshold = round(1000.0 * float(beyond[joint])), round(1000.0 * self.config.range_margin)
            latched |= board.set(AlertId.JOINT_OUT_OF_RANGE, now_us, value, threshold, source=int(joint))
        return latched

    def _check_heat(self, temperature: np.ndarray, board: AlertBoard, now_us: int) -> bool:
        c = self.config
        latched = False
        for motor in np.flatnonzero(temperature >= min(c.warning_c, c.trip_clear_c)):
            source, value = int(motor), round(10.0 * float(temperature[motor]))
            if temperature[motor] >= c.warning_c:
                board.set(AlertId.MOTOR_TEMP_HIGH, now_us, value, round(10.0 * c.warning_c), source)
            cooling = board.is_active(AlertId.MOTOR_OVERTEMP, source) and temperature[motor] >= c.trip_clear_c
            if temperature[motor] >= c.trip_c or cooling:
                latched |= board.set(AlertId.MOTOR_OVERTEMP, now_us, value, round(10.0 * c.trip_c), source)
        return latched
