"""Ages of the motors' answers on their buses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from asimov_gym.firmware import ANSWER_AGE_S, BUS_NAMES, BUSES, Condition, Linkage, Stand, Trajectory, Velocity
from asimov_gym.firmware.sensing import Sensing
from asimov_gym.physics import CPhysics
from asimov_gym.robot.joints import JOINTS, MOTOR_NAMES, STAND_POSITION, joint_index

WELL = Condition()


def test_ages_follow_the_polling_slots() -> None:
    ages = dict(zip(MOTOR_NAMES, 1000.0 * ANSWER_AGE_S, strict=True))
    # Told of the robot: hips 6 to 9 ms when the ankles arrive, the middle 3 to 5, the ankles 0 to 2.
    for side in "LR":
        assert all(6.0 <= ages[f"{side}_Hip_{axis}"] <= 9.0 for axis in ("Pitch", "Roll"))
        assert all(3.0 <= ages[f"{side}_{name}"] <= 5.0 for name in ("Hip_Yaw", "Knee"))
        assert all(0.0 <= ages[f"{side}_Ankle_{motor}"] <= 2.0 for motor in "AB")
    assert ages["L_Ankle_B"] == 0.0


def test_every_motor_is_on_one_bus_in_polling_order() -> None:
    assert sorted(motor for motors in BUSES.values() for motor in motors) == list(range(25))
    assert BUS_NAMES == ("left_leg", "right_leg", "left_arm", "right_arm", "waist_neck")
    assert [MOTOR_NAMES[motor] for motor in BUSES["waist_neck"]] == ["Waist_Yaw", "Neck_Pitch", "Neck_Yaw"]
    for motors in BUSES.values():
        assert [JOINTS[motor].can_slot for motor in motors] == list(range(len(motors)))


def test_a_steady_motion_is_seen_as_far_back_as_its_answer_is_old() -> None:
    sensing = Sensing(Linkage(), 0.005, aged=True)
    start = CPhysics(1).read()
    rate = np.linspace(-2.0, 2.0, 25)
    for step in range(5):
        position = (0.005 * step * rate)[None]
        reading = replace(start, joint_position=position, joint_velocity=rate[None])
        current = 100.0 * step + np.zeros(25)
        sense = sensing.look(reading, current, np.full(25, 30.0), WELL)
        sensing.remember(reading, current, np.full(25, 30.0))
    linkage = Linkage()
    late = linkage.motor_position(0.02 * rate) - ANSWER_AGE_S * linkage.motor_velocity(rate, rate)
    assert sense.reading.joint_position[0] == pytest.approx(linkage.joint_position(late))
    assert sense.reading.joint_velocity[0] == pytest.approx(rate)
    assert sense.current == pytest.approx(400.0 - 20_000.0 * ANSWER_AGE_S)
    assert sense.temperature == pytest.approx(30.0)


def test_telemetry_of_a_moving_robot_lags_by_the_slot_and_the_imu_does_not(make_bench: Callable) -> None:
    bench = make_bench("hold", aged_readings=True)
    goal = STAND_POSITION.copy()
    places = [joint_index(f"left_{name}_joint") for name in ("hip_pitch", "knee", "ankle_roll", "elbow")]
    truth, seen = [], []
    for i in range(60):
        goal[places[0]] = 0.4 * np.sin(0.2 * i)
        goal[places[1]] = 0.7 + 0.4 * np.sin(0.2 * i)
        goal[places[3]] = 1.0 + 0.6 * np.sin(0.2 * i)
        bench.firmware.command(Trajectory(goal))
        snapshot = bench.run(0.005)
        truth.append(snapshot.linkage.motor_position(bench.physics.read().joint_position[0]))
        seen.append(snapshot.motor_position)
    assert np.array_equal(snapshot.imu_gyro, bench.physics.read().gyro[0])
    times = 0.005 * np.arange(60)
    for motor in places:
        history = np.array(truth)[:, motor]
        assert np.ptp(history[20:]) > (0.0 if motor == places[2] else 0.1)
        expected = np.interp(times[20:] - ANSWER_AGE_S[motor], times, history)
        assert np.array(seen)[20:, motor] == pytest.approx(expected, abs=1e-9)
        if ANSWER_AGE_S[motor] > 0.0:
            assert not np.allclose(np.array(seen)[20:, motor], history[20:], atol=1e-3)


def test_the_policy_sees_the_aged_readings(make_bench: Callable, policy) -> None:
    offsets = {}
    for aged in (False, True):
        bench = make_bench("hold", aged_readings=aged)
        bench.run(1.0)
        bench.firmware.command(Stand())
        bench.run(0.5)  # on the way down the ramp, joints on the move
        bench.firmware.command(Velocity(0.0, 0.0, 0.0))
        seen = bench.firmware.snapshot.joint_position
        bench.run(0.005)
        offsets[aged] = policy.seen[-1][9]  # left hip pitch, from the standing pose
        assert offsets[aged] == pytest.approx(seen[0] - STAND_POSITION[0], abs=1e-6)
    assert offsets[True] != pytest.approx(offsets[False], abs=1e-5)


def test_the_robot_still_stands_on_aged_readings(make_bench: Callable) -> None:
    bench = make_bench(aged_readings=True)
    bench.firmware.command(Stand())
    snapshot = bench.run(3.0)
    assert snapshot.error_flags == 0
    assert snapshot.joint_position == pytest.approx(bench.physics.read().joint_position[0], abs=1e-3)
