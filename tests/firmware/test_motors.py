from __future__ import annotations

import math

import numpy as np
import pytest

from asimov_gym.firmware import MotorConfig, Motors
from asimov_gym.robot.joints import MOTOR_NAMES
from asimov_gym.robot.motor import RATED_TORQUE


def test_current_is_torque_over_the_motor_constant() -> None:
    motors = Motors(MotorConfig(current_noise_a=0.0), seed=0)
    torque = np.zeros(25)
    torque[MOTOR_NAMES.index("L_Hip_Pitch")] = 27.5
    torque[MOTOR_NAMES.index("R_Ankle_B")] = -18.1
    motors.step(torque, 0.005)
    assert motors.current[MOTOR_NAMES.index("L_Hip_Pitch")] == pytest.approx(10.0)
    assert motors.current[MOTOR_NAMES.index("R_Ankle_B")] == pytest.approx(-10.0)
    assert np.count_nonzero(motors.current) == 2


def test_heat_follows_the_first_order_lag() -> None:
    motors = Motors(MotorConfig(), seed=0)
    for _ in range(200 * 60):
        motors.step(RATED_TORQUE, 0.005)
    assert motors.temperature == pytest.approx(25.0 + 45.0 * (1.0 - math.exp(-60.0 / 600.0)), abs=0.01)


def test_three_times_rated_torque_trips_after_a_minute_and_a_half() -> None:
    motors = Motors(MotorConfig(), seed=0)
    seconds = 0.0
    while motors.temperature[0] < 80.0:
        motors.step(3.0 * RATED_TORQUE, 0.05)
        seconds += 0.05
    assert seconds == pytest.approx(88.0, abs=1.0)


def test_noise_repeats_with_the_seed() -> None:
    readings = []
    for seed in (1, 1, 2):
        motors = Motors(MotorConfig(), seed)
        motors.step(np.zeros(25), 0.005)
        readings.append(motors.current)
    assert np.array_equal(readings[0], readings[1])
    assert not np.array_equal(readings[0], readings[2])
    assert 0.01 < np.std(readings[0]) < 0.5


def test_config_names_the_bad_field() -> None:
    with pytest.raises(ValueError, match="current_noise_a"):
        MotorConfig(current_noise_a=-0.1)
