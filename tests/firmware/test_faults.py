"""Faults by their causes: what breaks, what the firmware finds, what it does about it, and when that is over."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from asimov_gym.firmware import (
    UNITS,
    AlertId,
    BatteryConfig,
    FirmwareState,
    Stand,
    State,
    Trajectory,
    Velocity,
)
from asimov_gym.robot.joints import KD, KP, MOTOR_NAMES, STAND_POSITION, joint_index

KNEE = MOTOR_NAMES.index("L_Knee")
ANKLE_A, ANKLE_B = MOTOR_NAMES.index("L_Ankle_A"), MOTOR_NAMES.index("L_Ankle_B")
LEFT_LEG = slice(0, 6)


def standing(bench) -> None:
    bench.firmware.command(Stand())
    bench.run(2.2)


def walking(bench) -> None:
    standing(bench)
    bench.firmware.command(Velocity(0.3, 0.0, 0.0))
    bench.run(0.1)


def found(snapshot: FirmwareState) -> set[AlertId]:
    return {alert.id for alert in snapshot.alerts}


def turn_over(bench, degrees: float) -> None:
    """Put the robot in the air, turned about its y axis, at rest."""
    state = bench.physics.state()
    half = np.radians(degrees) / 2.0
    state.qpos[0, 2:7] = [2.0, np.cos(half), 0.0, np.sin(half), 0.0]
    state.qvel[0] = 0.0
    bench.physics.set_state(state)


def bend_elbow_too_far(bench) -> None:
    state = bench.physics.state()
    state.qpos[0, bench.physics.model.joint("left_elbow_joint").qposadr[0]] = 2.7
    bench.physics.set_state(state)


def invalid_gains(bench) -> None:
    kp = KP.copy()
    kp[KNEE] = 600.0
    bench.firmware.command(Trajectory(STAND_POSITION, kp, KD, timeout_s=60.0))


CAUSES: dict[AlertId, Callable] = {
    AlertId.MOTOR_COMM_LOSS: lambda b: b.firmware.faults.drop_bus("all"),
    AlertId.MOTOR_OVERCURRENT: lambda b: b.firmware.faults.overcurrent("L_Knee", 100.0),
    AlertId.MOTOR_OVERTEMP: lambda b: b.firmware.faults.heat("L_Knee", 81.0),
    AlertId.IMU_FAILURE: lambda b: b.firmware.faults.imu(),
    AlertId.WATCHDOG_TIMEOUT: lambda b: b.physics.kick(np.full((1, 6), 1e4)),
    AlertId.MOTOR_ENCODER_ERROR: lambda b: b.firmware.faults.encoder("L_Knee"),
    AlertId.FALL_DETECTED: lambda b: turn_over(b, 90.0),
    AlertId.TUMBLE_DETECTED: lambda b: turn_over(b, 150.0),
    AlertId.MOTOR_PARTIAL_LOSS: lambda b: b.firmware.faults.drop_bus("left_leg"),
    AlertId.JOINT_OUT_OF_RANGE: bend_elbow_too_far,
    AlertId.BMS_PROTECTION: lambda b: b.firmware.faults.battery(0.0),
    AlertId.INFERENCE_FAILURE: lambda b: b.firmware.faults.fail_policy(),
    AlertId.POLICY_SPAZ: lambda b: b.policy.action.fill(np.nan),
    AlertId.MOTOR_TEMP_HIGH: lambda b: b.firmware.faults.heat("L_Knee", 61.0),
    AlertId.POLICY_LATE: lambda b: b.firmware.faults.delay_policy(30.0),
    AlertId.CAN_TIMEOUT: lambda b: b.firmware.faults.drop_bus("right_arm", 0.03),
    AlertId.CAN_BUS_OFF: lambda b: b.firmware.faults.drop_bus("right_arm", 0.07),
    AlertId.BMS_LOW_SOC: lambda b: b.firmware.faults.battery(19.0),
    AlertId.INVALID_GAINS: invalid_gains,
    AlertId.MODE_CHANGE: lambda b: b.firmware.e_stop(True),
    AlertId.POLICY_INFERENCE_TIMEOUT: lambda b: b.firmware.faults.delay_policy(150.0),
    AlertId.POLICY_DEADLINE_MISS: lambda b: b.firmware.faults.delay_policy(30.0),
    AlertId.IMU_STALE: lambda b: b.firmware.faults.imu(0.05),
    AlertId.MOTOR_MISSING: lambda b: b.firmware.faults.drop_motor("R_Elbow", 0.05),
}


@pytest.mark.parametrize("alert", UNITS, ids=lambda alert: alert.name)
def test_every_alert_with_a_unit_has_a_cause_in_the_hardware(make_bench: Callable, alert: AlertId) -> None:
    bench = make_bench("hold")
    walking(bench)
    assert found(bench.firmware.snapshot) == set()
    CAUSES[alert](bench)
    seen = set()
    for _ in range(60):
        seen |= found(bench.run(0.005))
    assert alert in seen
    critical = alert.value < 16
    assert bool(bench.firmware.snapshot.error_flags & 1 << (1 + alert.value)) is critical
    assert bench.firmware.snapshot.latched is critical
    assert critical <= (bench.firmware.state is State.DAMP)


def test_an_alert_clears_after_its_cause_and_the_latch_on_restart(held) -> None:
    standing(held)
    held.firmware.faults.drop_bus("left_leg", 0.3)
    snapshot = held.run(0.3)
    assert snapshot.error_flags == 1 | 1 << (1 + AlertId.MOTOR_PARTIAL_LOSS)
    assert AlertId.MOTOR_PARTIAL_LOSS in found(held.run(2.4))
    snapshot = held.run(0.15)
    assert found(snapshot) == set()
    assert snapshot.error_flags == 1 | 1 << 11
    held.firmware.command(Stand())
    assert held.run(0.1).state is State.DAMP
    held.firmware.restart()
    snapshot = held.firmware.snapshot
    assert (snapshot.error_flags, snapshot.tick, snapshot.timestamp_us, snapshot.boot) == (0, 0, 0, 2)
    assert snapshot.can[0].frames_sent == snapshot.can[0].errors == 0
    held.firmware.command(Stand())
    assert held.run(0.1).state is State.STAND


def test_a_restart_does_not_mend_the_hardware(held) -> None:
    held.firmware.faults.drop_bus("left_leg")
    held.run(0.2)
    held.firmware.restart()
    assert held.firmware.snapshot.error_flags == 0
    assert held.run(0.005).latched
    held.firmware.faults.clear()
    held.firmware.restart()
    assert held.run(0.2).error_flags == 0


# -- buses -----------------------------------------------------------------------------------------


def test_a_dead_bus_is_found_step_by_step(held) -> None:
    standing(held)
    sent = held.firmware.snapshot.can[0].frames_sent
    held.firmware.faults.drop_bus("left_leg")
    alerts = {}
    for step in range(1, 23):
        for alert in held.run(0.005).alerts:
            alerts.setdefault((alert.id, alert.source), 5 * step)
    missing = {(AlertId.MOTOR_MISSING, motor): 20 for motor in range(6)}
    whole = {(AlertId.CAN_TIMEOUT, 0): 10, (AlertId.CAN_BUS_OFF, 0): 50, (AlertId.MOTOR_PARTIAL_LOSS, 0): 100}
    assert alerts == missing | whole
    left, right = held.firmware.snapshot.can[:2]
    assert left.errors == left.frames_sent - left.frames_received == 9 * 6
    assert left.frames_sent == sent + 9 * 6  # a controller that is off sends nothing
    assert left.bus_offs == 1
    assert (right.errors, right.bus_offs) == (0, 0)
    assert right.frames_sent == right.frames_received == held.firmware.snapshot.tick * 6


def test_a_short_loss_is_survived(held) -> None:
    standing(held)
    held.firmware.faults.drop_bus("waist_neck", 0.08)
    snapshot = held.run(0.5)
    assert (snapshot.state, snapshot.error_flags) == (State.STAND, 0)
    assert AlertId.CAN_BUS_OFF in found(snapshot)
    assert held.firmware.faults.ongoing == ()


def test_motors_of_a_dead_bus_are_limp_and_their_readings_stand(held) -> None:
    standing(held)
    before = held.firmware.snapshot
    held.physics.kick(np.array([[0.3, 0.2, 0.0, 0.5, 0.0, 0.0]]))
    held.firmware.faults.drop_bus("left_leg")
    snapshot = held.run(0.08)
    assert snapshot.state is State.STAND
    assert np.array_equal(snapshot.motor_position[LEFT_LEG], before.motor_position[LEFT_LEG])
    assert np.array_equal(snapshot.motor_current[LEFT_LEG], before.motor_current[LEFT_LEG])
    assert np.array_equal(snapshot.motor_temperature[LEFT_LEG], before.motor_temperature[LEFT_LEG])
    truth = held.physics.read()
    assert np.abs(truth.joint_position[0, LEFT_LEG] - before.joint_position[LEFT_LEG]).max() > 0.005
    assert truth.joint_torque[0, LEFT_LEG] == pytest.approx(0.0)
    assert np.abs(truth.joint_torque[0, 6:12]).max() > 0.1
    assert snapshot.joint_position[6:] == pytest.approx(truth.joint_position[0, 6:], abs=1e-12)
    held.firmware.faults.clear()
    back = held.run(0.005)
    assert back.joint_position == pytest.approx(held.physics.read().joint_position[0], abs=1e-12)


def test_one_silent_ankle_motor_is_no_dead_bus(held) -> None:
    standing(held)
    before = held.firmware.snapshot
    held.physics.kick(np.array([[0.3, 0.2, 0.0, 0.5, 0.0, 0.0]]))
    held.firmware.faults.drop_motor("L_Ankle_A", 0.09)
    snapshot = held.run(0.08)
    assert [(alert.id, alert.source) for alert in snapshot.alerts] == [(AlertId.MOTOR_MISSING, ANKLE_A)]
    assert snapshot.motor_position[ANKLE_A] == pytest.approx(before.motor_position[ANKLE_A], abs=1e-12)
    pitch, roll = held.physics.read().joint_position[0, [4, 5]]
    assert snapshot.motor_position[ANKLE_B] == pytest.approx(-2.02 * pitch - 0.8 * roll)
    assert held.physics.read().joint_torque[0, [4, 5]] == pytest.approx(0.0)
    assert snapshot.can[0].errors == 16


# -- motors, IMU -----------------------------------------------------------------------------------


def test_a_short_in_a_motor_is_seen_after_50_ms_and_heats_it(held) -> None:
    standing(held)
    held.firmware.faults.overcurrent("L_Knee", 45.0, seconds=1.0)
    assert not held.run(0.05).latched
    snapshot = held.run(0.02)
    assert snapshot.error_flags == 1 | 1 << 2
    alert = next(alert for alert in snapshot.alerts if alert.id is AlertId.MOTOR_OVERCURRENT)
    assert (alert.source, alert.threshold) == (KNEE, 300)
    assert alert.value == pytest.approx(450, abs=60)
    held.run(0.93)
    # 45 A are 45 * 2.53 / 25 = 4.55 times the rating: 45 K * 20.7 / 600 s is 1.55 K in the second.
    assert held.firmware.snapshot.motor_temperature[KNEE] == pytest.approx(26.55, abs=0.15)
    assert np.delete(held.firmware.snapshot.motor_temperature, KNEE).max() < 25.2


def test_a_short_is_found_again_after_a_restart(held) -> None:
    held.firmware.faults.overcurrent("L_Knee", 100.0)
    assert held.run(0.1).latched
    held.firmware.restart()
    assert not held.run(0.05).latched
    assert held.run(0.02).error_flags == 1 | 1 << 2


def test_a_spike_of_current_is_no_fault(held) -> None:
    held.firmware.faults.overcurrent("L_Knee", 200.0, seconds=0.04)
    assert held.run(0.2).error_flags == 0


def test_a_broken_encoder_latches_at_once_and_its_reading_stands(held) -> None:
    standing(held)
    before = held.firmware.snapshot.motor_position[KNEE]
    held.firmware.faults.encoder("L_Knee")
    snapshot = held.run(0.005)
    assert snapshot.error_flags == 1 | 1 << 6
    assert [(a.id, a.source, a.value) for a in snapshot.alerts] == [(AlertId.MOTOR_ENCODER_ERROR, KNEE, 5)]
    held.run(1.0)
    assert held.firmware.snapshot.motor_position[KNEE] == pytest.approx(before, abs=1e-12)
    assert abs(held.physics.read().joint_position[0, KNEE] - before) > 0.01


def test_a_stopped_imu_repeats_itself_until_it_counts_as_failed(held) -> None:
    standing(held)
    before = held.firmware.snapshot
    held.physics.kick(np.array([[0.0, 0.0, 0.0, 0.5, 0.5, 0.5]]))
    held.firmware.faults.imu()
    snapshot = held.run(0.095)
    assert np.array_equal(snapshot.imu_gyro, before.imu_gyro)
    assert np.array_equal(snapshot.imu_quat, before.imu_quat)
    assert (found(snapshot), snapshot.state) == ({AlertId.IMU_STALE}, State.STAND)
    assert held.run(0.005).error_flags == 1 | 1 << 4
    held.firmware.faults.clear()
    assert not np.array_equal(held.run(0.005).imu_quat, before.imu_quat)


# -- motion ----------------------------------------------------------------------------------------


def test_a_push_gives_the_robot_its_momentum(make_bench: Callable) -> None:
    bench = make_bench("off")
    turn_over(bench, 0.0)
    bench.firmware.faults.push((120.0, -60.0, 0.0), 0.1, body="pelvis_link")
    bench.run(0.2)
    assert bench.firmware.faults.ongoing == ()
    model, state = bench.physics.model, bench.physics.state()
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = state.qpos[0], state.qvel[0]
    mujoco.mj_forward(model, data)
    mujoco.mj_subtreeVel(model, data)
    mass = float(model.body_subtreemass[0])
    assert data.subtree_linvel[0][:2] == pytest.approx([12.0 / mass, -6.0 / mass], rel=0.01)


def test_a_hard_push_ends_in_a_fall(make_bench: Callable) -> None:
    bench = make_bench("off")
    standing(bench)
    bench.firmware.faults.push((250.0, 0.0, 0.0), 0.3)
    assert bench.run(1.5).error_flags & 0x101 == 0x101


def test_pushes_add_to_the_rope(bench) -> None:
    bench.run(1.0)
    bench.firmware.faults.push((0.0, 0.0, -100.0), 60.0)
    weight = 9.81 * float(bench.physics.model.body_subtreemass[0])
    assert bench.run(4.0).gantry_force == pytest.approx(weight + 100.0, rel=0.02)


def test_turning_fast_is_a_tumble_and_so_is_hanging_upside_down(make_bench: Callable) -> None:
    bench = make_bench("off")
    bench.firmware.command(Stand())
    turn_over(bench, 0.0)
    bench.physics.kick(np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 6.5]]))
    snapshot = bench.run(0.005)
    assert snapshot.error_flags == 1 | 1 << 10
    assert (snapshot.alerts[0].value, snapshot.alerts[0].threshold) == (round(10 * np.degrees(6.5)), 3438)
    bench.firmware.restart()
    bench.firmware.command(Stand())
    turn_over(bench, 130.0)
    snapshot = bench.run(0.005)
    assert snapshot.error_flags == 1 | 1 << 8 | 1 << 10
    assert [(a.id, a.value, a.threshold) for a in snapshot.alerts] == [
        (AlertId.FALL_DETECTED, 1300, 600),
        (AlertId.TUMBLE_DETECTED, 1300, 1200),
    ]


def test_whatever_the_robot_does_in_damp_is_no_fall(make_bench: Callable) -> None:
    bench = make_bench("off")
    turn_over(bench, 150.0)
    bench.physics.kick(np.array([[0.0, 0.0, 0.0, 8.0, 0.0, 0.0]]))
    assert bench.run(1.0).error_flags == 0


# -- battery ---------------------------------------------------------------------------------------


def test_the_battery_warns_below_20_percent_and_cuts_off_when_empty(held) -> None:
    held.firmware.command(Stand())
    held.firmware.faults.battery(20.5)
    assert found(held.run(0.1)) == set()
    held.firmware.faults.battery(19.94)
    snapshot = held.run(0.1)
    assert [(a.id, a.value, a.threshold) for a in snapshot.alerts] == [(AlertId.BMS_LOW_SOC, 199, 200)]
    assert (snapshot.state, snapshot.error_flags) == (State.STAND, 0)
    held.firmware.faults.battery(0.0)
    snapshot = held.run(0.1)
    assert (snapshot.state, snapshot.error_flags) == (State.DAMP, 1 | 1 << 14)
    assert snapshot.battery.protection_flags == 1
    held.firmware.faults.battery(80.0)
    assert held.run(2.6).alerts == ()
    assert held.firmware.snapshot.latched


def test_a_small_battery_runs_empty_by_itself(make_bench: Callable) -> None:
    bench = make_bench("hold", battery=BatteryConfig(capacity_ah=0.001, start_soc_percent=21.0))
    seen = set()
    for _ in range(40):
        seen |= found(bench.run(0.05))
    assert {AlertId.BMS_LOW_SOC, AlertId.BMS_PROTECTION} <= seen
    assert bench.firmware.snapshot.battery.soc_percent == 0.0


# -- injection -------------------------------------------------------------------------------------


def test_bad_arguments_list_what_is_allowed(held) -> None:
    faults = held.firmware.faults
    with pytest.raises(ValueError, match="unknown motor 'knee'; allowed are number or name of 0 L_Hip_Pitch, 1 L_Hip_"):
        faults.heat("knee", 50.0)
    with pytest.raises(ValueError, match="unknown motor 25"):
        faults.encoder(25)
    with pytest.raises(ValueError, match=r"unknown bus 'leg'.* 0 left_leg, 1 right_leg, 2 left_arm"):
        faults.drop_bus("leg")
    with pytest.raises(ValueError, match=r"unknown body 'torso'; the bodies are .*waist_yaw_link"):
        faults.push((1.0, 0.0, 0.0), 0.1, body="torso")
    with pytest.raises(ValueError, match="force_n must be three finite numbers"):
        faults.push((1.0, float("nan"), 0.0), 0.1)
    with pytest.raises(ValueError, match="duration must be above 0 s"):
        faults.imu(-1.0)
    with pytest.raises(ValueError, match="ms must be between 0 and 60000, got -1"):
        faults.delay_policy(-1.0)
    with pytest.raises(ValueError, match="soc_percent must be between 0 and 100, got 101"):
        faults.battery(101)
    with pytest.raises(ValueError, match="unknown alert 'FIRE'; the alerts are MOTOR_COMM_LOSS"):
        faults.raise_alert("FIRE")
    with pytest.raises(ValueError, match="alert source must be from 0 to 4294967295, got -1"):
        faults.raise_alert("FALL_DETECTED", source=-1)
    assert faults.ongoing == ()


def test_clear_ends_what_goes_on_and_keeps_what_has_come_of_it(held) -> None:
    faults = held.firmware.faults
    faults.push((10.0, 0.0, 0.0), 60.0)
    faults.drop_bus(3)
    faults.imu()
    faults.delay_policy(5.0)
    faults.heat("R_Knee", 70.0)
    assert set(faults.ongoing) == {"push", "bus right_arm", "imu", "policy delay"}
    held.run(0.01)
    faults.clear()
    assert faults.ongoing == ()
    assert held.run(0.01).motor_temperature[MOTOR_NAMES.index("R_Knee")] == pytest.approx(70.0, abs=0.1)
    assert held.run(3.0).error_flags == 0


def test_an_alert_without_a_cause_goes_after_two_and_a_half_seconds(held) -> None:
    held.firmware.faults.raise_alert("MOTOR_DRV_FAULT", source=7, value=3)
    assert [(a.id, a.source, a.value) for a in held.run(2.45).alerts] == [(AlertId.MOTOR_DRV_FAULT, 7, 3)]
    assert held.run(0.1).alerts == ()
    held.firmware.faults.raise_alert(AlertId.BMS_COMM_LOSS)
    assert (held.run(0.005).error_flags, held.firmware.state) == (1 | 1 << 13, State.DAMP)


def test_invalid_gains_are_replaced_by_the_defaults(held) -> None:
    elbow = joint_index("left_elbow_joint")
    goal = STAND_POSITION.copy()
    goal[elbow] = 1.5
    kp = KP.copy()
    kp[elbow] = -1.0
    for _ in range(50):
        held.firmware.command(Trajectory(goal, kp, KD))
        snapshot = held.run(0.02)
    assert snapshot.joint_position[elbow] == pytest.approx(1.5, abs=0.05)
    assert [(a.id, a.source, a.value, a.threshold) for a in snapshot.alerts] == [(AlertId.INVALID_GAINS, elbow, 100, 0)]
    assert snapshot.state is State.TRAJECTORY


def test_the_readings_are_the_robot_itself_when_all_is_well(held) -> None:
    standing(held)
    snapshot, truth = held.run(0.005), held.physics.read()
    assert np.array_equal(snapshot.joint_position, truth.joint_position[0])
    assert np.array_equal(snapshot.imu_gyro, truth.gyro[0])
    assert replace(snapshot, tick=0).tick == 0
