"""What ends in DAMP and stays there until a restart: falls, joints out of range, heat, a diverged simulation."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from asimov_gym.firmware import (
    AlertId,
    Damp,
    MotorConfig,
    Outcome,
    Stand,
    State,
    Trajectory,
    Velocity,
)
from asimov_gym.robot.joints import KD, KP, MOTOR_NAMES, RANGE, STAND_POSITION, joint_index
from asimov_gym.robot.motor import HeatModel

LEFT_KNEE = joint_index("left_knee_joint")
ELBOW = joint_index("left_elbow_joint")


def topple(bench) -> None:
    bench.physics.kick(np.array([[3.0, 0.0, 0.0, 0.0, 0.0, 0.0]]))


def test_fall_latches_damp_and_only_a_restart_clears_it(make_bench: Callable) -> None:
    bench = make_bench("off")
    bench.firmware.command(Stand())
    assert bench.run(1.0).error_flags == 0
    topple(bench)
    snapshot = bench.run(1.5)
    assert snapshot.state is State.DAMP
    assert snapshot.error_flags & 0x101 == 0x101
    assert AlertId.FALL_DETECTED in {alert.id for alert in snapshot.alerts}
    snapshot = bench.run(3.0)
    assert snapshot.alerts == ()
    assert snapshot.error_flags & 0x101 == 0x101
    assert bench.firmware.command(Stand()).outcome is Outcome.TAKEN
    assert bench.firmware.command(Velocity(0.1, 0.0, 0.0)).outcome is Outcome.DAMPED
    assert bench.firmware.command(Trajectory(STAND_POSITION)).outcome is Outcome.LATCHED
    assert bench.firmware.command(Damp()).outcome is Outcome.TAKEN
    assert bench.run(0.1).state is State.DAMP
    bench.firmware.restart()
    snapshot = bench.firmware.snapshot
    assert (snapshot.error_flags, snapshot.boot, snapshot.timestamp_us) == (0, 2, 0)
    bench.firmware.command(Stand())
    assert bench.firmware.state is State.STAND


def test_lying_down_in_damp_is_no_fault(make_bench: Callable) -> None:
    bench = make_bench("off")
    snapshot = bench.run(3.0)
    assert bench.pelvis_height() < 0.4
    assert (snapshot.error_flags, snapshot.alerts) == (0, ())


@pytest.mark.parametrize(("state", "latches"), [(State.STAND, True), (State.DAMP, False)])
def test_joint_out_of_range_latches_unless_damped(held, state: State, latches: bool) -> None:
    if state is State.STAND:
        held.firmware.command(Stand())
        held.run(2.0)
    physics = held.physics.state()
    physics.qpos[0, held.physics.model.joint("left_elbow_joint").qposadr[0]] = RANGE[ELBOW, 1] + 0.2
    held.physics.set_state(physics)
    snapshot = held.run(0.005)
    assert snapshot.latched is latches
    if latches:
        alert = snapshot.alerts[0]
        assert (alert.id, alert.source, alert.value, alert.threshold) == (AlertId.JOINT_OUT_OF_RANGE, ELBOW, 200, 50)
        assert snapshot.state is State.DAMP


def test_hot_motor_warns_then_trips(held) -> None:
    knee = MOTOR_NAMES.index("R_Knee")
    held.firmware.command(Stand())
    held.firmware.motors.temperature[knee] = 60.5
    warm = held.run(0.01)
    assert [(a.id, a.source, a.value, a.threshold) for a in warm.alerts] == [(AlertId.MOTOR_TEMP_HIGH, knee, 605, 600)]
    assert (warm.state, warm.error_flags) == (State.STAND, 0)
    held.firmware.motors.temperature[knee] = 80.5
    hot = held.run(0.01)
    assert (hot.state, hot.error_flags) == (State.DAMP, 0x9)
    assert {alert.id for alert in hot.alerts} == {AlertId.MOTOR_OVERTEMP, AlertId.MOTOR_TEMP_HIGH}
    held.firmware.motors.temperature[knee] = 71.0
    assert AlertId.MOTOR_OVERTEMP in {alert.id for alert in held.run(3.0).alerts}
    held.firmware.motors.temperature[knee] = 40.0
    assert held.run(2.6).alerts == ()
    assert held.firmware.snapshot.error_flags == 0x9


def test_restart_of_a_hot_robot_trips_again(held) -> None:
    held.firmware.motors.temperature[0] = 85.0
    held.run(0.01)
    held.firmware.restart()
    assert held.run(0.01).error_flags == 0x9


def test_overworked_motor_heats_until_it_trips(make_bench: Callable) -> None:
    bench = make_bench("hold", motors=MotorConfig(heat=HeatModel(time_constant_s=1.0)))
    kp = KP.copy()
    kp[LEFT_KNEE] = 500.0
    goal = STAND_POSITION.copy()
    for i in range(300):  # saws to and fro at nearly twice the rated torque
        goal[LEFT_KNEE] = (0.6, 0.9)[i // 4 % 2]
        bench.firmware.command(Trajectory(goal, kp, KD))
        snapshot = bench.run(0.02)
        if snapshot.latched:
            break
    hot = [(alert.id, alert.source) for alert in snapshot.alerts]
    assert snapshot.error_flags == 0x9
    assert (AlertId.MOTOR_OVERTEMP, LEFT_KNEE) in hot
    assert snapshot.motor_temperature[LEFT_KNEE] == pytest.approx(80.0, abs=1.0)


def test_injected_critical_alert_latches(bench) -> None:
    bench.firmware.command(Stand())
    bench.firmware.inject(AlertId.MOTOR_COMM_LOSS, source=4)
    snapshot = bench.run(0.005)
    assert (snapshot.state, snapshot.error_flags) == (State.DAMP, 0x3)


def test_a_diverged_simulation_latches(held) -> None:
    held.physics.kick(np.full((1, 6), 1e4))
    held.run(0.005)
    snapshot = held.run(0.005)
    assert (snapshot.state, snapshot.error_flags) == (State.DAMP, 1 | 1 << 5)
