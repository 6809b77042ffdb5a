"""The checks that run every tick on what the firmware senses: fall, tumble, joint range, motor heat and current."""

from __future__ import annotations

import math

import numpy as np

from asimov_gym.firmware.alerts import AlertBoard
from asimov_gym.firmware.clock import MICROSECONDS
from asimov_gym.firmware.config import FirmwareConfig
from asimov_gym.firmware.modes import State
from asimov_gym.firmware.sensing import Sense
from asimov_gym.robot.alerts import AlertId
from asimov_gym.robot.joints import RANGE
from asimov_gym.robot.motor import PEAK_CURRENT


def tilt(gravity_z: float) -> float:
    """Angle of the body from upright, rad, from the z component of the body-frame gravity."""
    return math.acos(max(-1.0, min(1.0, -gravity_z)))


class Safety:
    """Raises the alerts that the robot's motion, heat and current can cause.

    Fall, tumble and joint range are watched only while the robot is driven: lying down after a DAMP is no fault.

    Args:
        config: thresholds.
    """

    def __init__(self, config: FirmwareConfig) -> None:
        self.config = config
        self._tumble_gravity_z = -math.cos(math.radians(config.tumble_tilt_deg))
        self._low = RANGE[:, 0] - config.range_margin
        self._high = RANGE[:, 1] + config.range_margin
        self._lowest_alert_c = min(config.warning_c, config.trip_clear_c)
        self.reset()

    def reset(self) -> None:
        """The firmware boots: its clock starts again."""
        self._over_since: dict[int, int] = {}

    def check(self, state: State, sense: Sense, board: AlertBoard, now_us: int) -> bool:
        """Look at the robot. True if something latched DAMP just now.

        Args:
            state: present state of the mode machine.
            sense: the robot as sensed.
            board: takes the alerts.
            now_us: firmware time.
        """
        latched = self._check_heat(sense.temperature, board, now_us)
        latched |= self._check_current(sense.current, board, now_us)
        if state is not State.DAMP:
            x, y, z = sense.reading.gyro[0].tolist()
            gravity_z, rate = float(sense.reading.gravity[0, 2]), math.sqrt(x * x + y * y + z * z)
            latched |= self._check_fall(gravity_z, board, now_us)
            latched |= self._check_tumble(gravity_z, rate, board, now_us)
            latched |= self._check_range(sense.reading.joint_position[0], board, now_us)
        return latched

    def _check_fall(self, gravity_z: float, board: AlertBoard, now_us: int) -> bool:
        if gravity_z <= self.config.fall_gravity_z:
            return False
        threshold = round(10.0 * math.degrees(tilt(self.config.fall_gravity_z)))
        return board.set(AlertId.FALL_DETECTED, now_us, _tenths(tilt(gravity_z)), threshold)

    def _check_tumble(self, gravity_z: float, rate: float, board: AlertBoard, now_us: int) -> bool:
        if gravity_z > self._tumble_gravity_z:
            threshold = round(10.0 * self.config.tumble_tilt_deg)
            return board.set(AlertId.TUMBLE_DETECTED, now_us, _tenths(tilt(gravity_z)), threshold)
        if rate > self.config.tumble_rate:
            return board.set(AlertId.TUMBLE_DETECTED, now_us, _tenths(rate), _tenths(self.config.tumble_rate))
        return False

    def _check_range(self, position: np.ndarray, board: AlertBoard, now_us: int) -> bool:
        outside = (position > self._high) | (position < self._low)
        if not outside.any():
            return False
        beyond = np.maximum(position - RANGE[:, 1], RANGE[:, 0] - position)
        threshold, latched = round(1000.0 * self.config.range_margin), False
        for joint in np.flatnonzero(outside).tolist():
            value = round(1000.0 * float(beyond[joint]))
            latched |= board.set(AlertId.JOINT_OUT_OF_RANGE, now_us, value, threshold, source=joint)
        return latched

    def _check_heat(self, temperature: np.ndarray, board: AlertBoard, now_us: int) -> bool:
        if temperature.max() < self._lowest_alert_c:
            return False
        c = self.config
        latched = False
        for motor in np.flatnonzero(temperature >= self._lowest_alert_c).tolist():
            celsius = float(temperature[motor])
            value = round(10.0 * celsius)
            if celsius >= c.warning_c:
                board.set(AlertId.MOTOR_TEMP_HIGH, now_us, value, round(10.0 * c.warning_c), motor)
            cooling = board.is_active(AlertId.MOTOR_OVERTEMP, motor) and celsius >= c.trip_clear_c
            if celsius >= c.trip_c or cooling:
                latched |= board.set(AlertId.MOTOR_OVERTEMP, now_us, value, round(10.0 * c.trip_c), motor)
        return latched

    def _check_current(self, current: np.ndarray, board: AlertBoard, now_us: int) -> bool:
        over = np.abs(current) > PEAK_CURRENT
        if not over.any():
            self._over_since.clear()
            return False
        motors = np.flatnonzero(over).tolist()
        self._over_since = {motor: self._over_since.get(motor, now_us) for motor in motors}
        latched = False
        for motor, since_us in self._over_since.items():
            if now_us - since_us >= self.config.overcurrent_s * MICROSECONDS:
                value, threshold = round(10.0 * abs(float(current[motor]))), round(10.0 * float(PEAK_CURRENT[motor]))
                latched |= board.set(AlertId.MOTOR_OVERCURRENT, now_us, value, threshold, motor)
        return latched


def _tenths(radians: float) -> int:
    """Tenths of a degree."""
    return round(10.0 * math.degrees(radians))
