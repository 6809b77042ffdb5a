"""Energy, torque and speed shares and smoothness, against numbers worked out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from asimov_gym.evaluation import effort
from asimov_gym.robot.joints import EFFORT, JOINT_NAMES, VELOCITY_LIMIT, joint_index
from asimov_gym.robot.motor import NO_LOAD_SPEED, RATED_TORQUE

KNEE = joint_index("left_knee_joint")


def _one(joint: int, values: np.ndarray) -> np.ndarray:
    rows = np.zeros((len(values), len(JOINT_NAMES)), dtype=np.float32)
    rows[:, joint] = values
    return rows


def test_the_robot_weighs_what_its_maker_says() -> None:
    assert effort.robot_mass() == pytest.approx(32.2, abs=0.1)


def test_cost_of_transport() -> None:
    torque, speed = _one(KNEE, np.full(100, 20.0)), _one(KNEE, np.full(100, -3.0))
    torque[:, 0], speed[:, 0] = 10.0, 1.0
    # 60 W of braking and 10 W of driving for 2 s over 30 kg * 9.81 * 4 m
    assert effort.cost_of_transport(torque, speed, 0.02, 30.0, 4.0) == pytest.approx(140.0 / (30.0 * 9.81 * 4.0))
    assert effort.cost_of_transport(torque, speed, 0.02, 30.0, 0.49) is None


def test_torque_shares_of_a_joint() -> None:
    t = np.arange(100) * 0.02
    torque = _one(KNEE, -0.6 * EFFORT[KNEE] * np.sin(2.0 * math.pi * t))
    rms, peak = effort.torque_rms_shares(torque), effort.torque_peak_shares(torque)
    assert rms[KNEE] == pytest.approx(0.6 / math.sqrt(2.0), rel=1e-6)
    assert peak[KNEE] == pytest.approx(0.6, rel=2e-3)  # samples miss the top of the sine by up to half a step
    assert np.delete(rms, KNEE).max() == 0.0 and np.delete(peak, KNEE).max() == 0.0


def test_rated_torque_is_that_of_the_motors_behind_the_ankle_linkage() -> None:
    assert effort.rated_torque_shares(_one(KNEE, np.full(9, 20.0)))[KNEE] == pytest.approx(20.0 / 25.0)
    pitch = joint_index("left_ankle_pitch_joint")
    shares = effort.rated_torque_shares(_one(pitch, np.full(9, 24.24)))
    # 2.02 turns of a motor per turn of pitch, and two motors share the load
    assert shares[pitch] == pytest.approx(24.24 / (2 * 2.02) / 12.0, rel=1e-6)
    assert RATED_TORQUE[pitch] == 12.0


def test_speed_shares() -> None:
    speed = _one(KNEE, np.array([1.0, -6.0, 2.0]))
    assert effort.speed_peak_shares(speed)[KNEE] == pytest.approx(6.0 / VELOCITY_LIMIT[KNEE])
    assert effort.no_load_shares(speed)[KNEE] == pytest.approx(6.0 / NO_LOAD_SPEED[KNEE])
    pitch = joint_index("right_ankle_pitch_joint")
    assert effort.no_load_shares(_one(pitch, np.array([3.0])))[pitch] == pytest.approx(
        3.0 * 2.02 / NO_LOAD_SPEED[pitch], rel=1e-6
    )


def test_action_jerk_is_the_second_difference() -> None:
    action = np.zeros((4, 23))
    action[:, 0] = [0.0, 1.0, 2.0, 3.0]  # a ramp is smooth
    assert effort.action_jerk(action) == 0.0
    action[:, 1] = [0.0, 0.0, 1.0, 0.0]  # second differences 1 and -2
    assert effort.action_jerk(action) == pytest.approx((1.0 + 4.0) / (2 * 23))
    assert effort.action_jerk(action[:2]) is None
