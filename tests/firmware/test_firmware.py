"""Modes, walking and what is reported, on a step clock."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from asimov_gym.firmware import (
    AlertId,
    Firmware,
    FirmwareConfig,
    GantryConfig,
    Mode,
    Outcome,
    Stand,
    State,
    StepClock,
    Trajectory,
    Velocity,
    WallClock,
)
from asimov_gym.physics import CPhysics
from asimov_gym.robot.joints import STAND_POSITION, joint_index

LEFT_KNEE = joint_index("left_knee_joint")
ELBOW = joint_index("left_elbow_joint")


def walking(bench) -> None:
    bench.firmware.command(Stand())
    bench.run(2.5)
    bench.firmware.command(Velocity(0.3, 0.0, 0.0))
    bench.run(0.1)


# -- boot and modes --------------------------------------------------------------------------------


def test_boots_in_damp_with_nothing_wrong(bench) -> None:
    snapshot = bench.firmware.snapshot
    assert (snapshot.state, snapshot.error_flags, snapshot.alerts, snapshot.boot) == (State.DAMP, 0, (), 1)
    assert snapshot.timestamp_us == 0


def test_needs_exactly_one_robot() -> None:
    with pytest.raises(ValueError, match=r"physics\.copies must be 1, got 2"):
        Firmware(CPhysics(2), StepClock())


def test_damp_is_damping_alone(held) -> None:
    held.run(2.0)
    state = held.physics.state()
    state.qvel[:, 6:] = 0.0
    state.qvel[0, held.physics.model.joint("left_elbow_joint").dofadr[0]] = 2.0
    held.physics.set_state(state)
    snapshot = held.run(0.005)
    # torque = -kd * speed, with the speed somewhere between the start and the end of the step
    assert -2.0 * 2.0 <= snapshot.joint_torque[ELBOW] <= -2.0 * snapshot.joint_velocity[ELBOW] < -1.0
    assert abs(snapshot.joint_torque[joint_index("right_elbow_joint")]) < 0.1


def test_stand_ramps_from_the_present_pose_in_two_seconds(held) -> None:
    start = held.run(1.0).joint_position
    held.firmware.command(Stand())
    assert held.run(0.005).mode is Mode.STAND
    middle = held.run(0.995).joint_position
    end = held.run(1.3).joint_position
    assert middle[LEFT_KNEE] == pytest.approx(0.5 * (start[LEFT_KNEE] + STAND_POSITION[LEFT_KNEE]), abs=0.03)
    assert end == pytest.approx(STAND_POSITION, abs=0.06)


def test_repeated_stand_does_not_start_the_ramp_again(held) -> None:
    goal = STAND_POSITION.copy()
    goal[ELBOW] = 2.0
    for _ in range(50):
        held.firmware.command(Trajectory(goal))
        held.run(0.02)
    for _ in range(10):
        held.firmware.command(Stand())
        snapshot = held.run(0.25)
    assert snapshot.joint_position[ELBOW] == pytest.approx(STAND_POSITION[ELBOW], abs=0.03)


def test_move_is_accepted_the_moment_it_arrives(bench) -> None:
    bench.firmware.command(Stand())
    assert bench.firmware.command(Velocity(0.0, 0.0, 0.0)).outcome is Outcome.TAKEN
    assert bench.run(0.005).mode is Mode.MOVE


def test_velocity_in_damp_is_dropped(bench) -> None:
    assert bench.firmware.command(Velocity(0.1, 0.0, 0.0)).outcome is Outcome.DAMPED
    assert bench.run(0.1).mode is Mode.DAMP


def test_velocity_without_a_policy_is_dropped(make_bench: Callable) -> None:
    bench = make_bench(with_policy=False)
    bench.firmware.command(Stand())
    assert bench.firmware.command(Velocity(0.1, 0.0, 0.0)).outcome is Outcome.NO_POLICY
    assert bench.run(0.1).mode is Mode.STAND


# -- policy ----------------------------------------------------------------------------------------


def test_policy_runs_at_50_hz_from_the_first_tick(bench, policy) -> None:
    bench.firmware.command(Stand())
    bench.run(2.0)
    bench.firmware.command(Velocity(0.3, 0.0, 0.0))
    bench.run(0.005)
    assert len(policy.seen) == 1
    bench.run(0.995)
    assert len(policy.seen) == 50


def test_policy_sees_the_command_until_it_is_replaced(bench, policy) -> None:
    walking(bench)
    bench.run(3.0)
    assert policy.seen[-1][6:9] == pytest.approx([0.3, 0.0, 0.0])
    bench.firmware.command(Velocity(0.0, 0.2, 0.0))
    bench.run(0.04)
    assert policy.seen[-1][6:9] == pytest.approx([0.0, 0.2, 0.0])


def test_a_velocity_with_a_timeout_becomes_zero_and_the_robot_walks_on_the_spot(bench, policy) -> None:
    walking(bench)
    bench.firmware.command(Velocity(0.3, 0.0, 0.0, timeout_s=2.0))
    snapshot = bench.run(1.995)
    assert (snapshot.state, snapshot.velocity[0]) == (State.POLICY, 0.3)
    snapshot = bench.run(0.005)
    assert (snapshot.state, list(snapshot.velocity)) == (State.POLICY, [0.0, 0.0, 0.0])
    bench.run(0.04)
    assert policy.seen[-1][6:9] == pytest.approx(0.0)
    assert bench.firmware.snapshot.alerts == ()


def test_a_new_velocity_starts_its_own_time(bench) -> None:
    walking(bench)
    for _ in range(4):
        bench.firmware.command(Velocity(0.3, 0.0, 0.0, timeout_s=0.5))
        assert bench.run(0.4).velocity[0] == 0.3
    bench.firmware.command(Velocity(0.2, 0.0, 0.0))
    assert bench.run(3.0).velocity[0] == 0.2


def test_stop_walking_stops_a_walk_and_nothing_else(held) -> None:
    walking(held)
    held.firmware.stop_walking()
    snapshot = held.run(0.1)
    assert (snapshot.state, list(snapshot.velocity)) == (State.POLICY, [0.0, 0.0, 0.0])
    held.firmware.command(Trajectory(STAND_POSITION, timeout_s=1.0))
    held.firmware.stop_walking()
    assert held.run(0.1).state is State.TRAJECTORY


def test_entering_move_resets_clock_and_last_action(bench, policy) -> None:
    policy.action[:] = 0.1
    walking(bench)
    assert policy.seen[-1][55:78] == pytest.approx(0.1)
    assert policy.seen[-1][79] != 0.0
    bench.firmware.command(Stand())
    bench.run(0.5)
    bench.firmware.command(Velocity(0.3, 0.0, 0.0))
    bench.run(0.005)
    assert policy.seen[-1][55:78] == pytest.approx(0.0)
    assert policy.seen[-1][78:80] == pytest.approx([1.0, 0.0])


def test_command_is_clamped_to_the_trained_range(bench, policy) -> None:
    bench.firmware.command(Stand())
    receipt = bench.firmware.command(Velocity(2.0, -1.0, 0.5))
    snapshot = bench.run(0.005)
    assert receipt.clamped
    assert snapshot.velocity == pytest.approx([0.8, -0.4, 0.5])
    assert policy.seen[-1][6:9] == pytest.approx([0.8, -0.4, 0.5])


def test_action_moves_the_joints_and_the_neck_stands(bench, policy) -> None:
    policy.action[:] = 0.0
    policy.action[list(policy.contract.joint_names).index("left_elbow_joint")] = 2.0
    walking(bench)
    snapshot = bench.run(1.0)
    assert snapshot.joint_position[ELBOW] == pytest.approx(STAND_POSITION[ELBOW] + 0.5, abs=0.05)
    assert snapshot.joint_position[23:25] == pytest.approx([0.0, 0.0], abs=0.02)


@pytest.mark.parametrize(("value", "reported"), [(np.nan, 2**32 - 1), (np.inf, 2**32 - 1), (-12.5, 12_500)])
def test_runaway_policy_latches_damp(bench, policy, value: float, reported: int) -> None:
    walking(bench)
    policy.action[3] = value
    snapshot = bench.run(0.02)
    assert snapshot.state is State.DAMP
    assert snapshot.error_flags == 1 | 1 << 9
    assert [(a.id, a.value, a.threshold) for a in snapshot.alerts] == [(AlertId.POLICY_SPAZ, reported, 10_000)]


def test_failing_inference_latches_damp(bench, policy) -> None:
    walking(bench)
    policy.error = RuntimeError("out of memory")
    snapshot = bench.run(0.02)
    assert snapshot.state is State.DAMP
    assert snapshot.error_flags == 1 | 1 << 15
    assert bench.run(1.0).state is State.DAMP


# -- reports ---------------------------------------------------------------------------------------


def test_ankles_are_reported_as_motors(held) -> None:
    goal = STAND_POSITION.copy()
    goal[4], goal[5] = 0.1, -0.05
    for _ in range(100):
        held.firmware.command(Trajectory(goal))
        snapshot = held.run(0.02)
    pitch, roll = snapshot.joint_position[4:6]
    assert snapshot.motor_position[4:6] == pytest.approx([2.02 * pitch - 0.8 * roll, -2.02 * pitch - 0.8 * roll])
    tau_pitch, tau_roll = snapshot.joint_torque[4:6]
    tau_a, tau_b = snapshot.motor_torque[4:6]
    assert [2.02 * (tau_a - tau_b), -0.8 * (tau_a + tau_b)] == pytest.approx([tau_pitch, tau_roll])


def test_exact_ankle_reaches_less_than_is_asked(make_bench: Callable) -> None:
    bench = make_bench("hold", ankle="exact")
    bench.firmware.command(Stand())
    snapshot = bench.run(3.0)
    # The linear form asks the motors for 2.02 * 0.3; the mechanism turns that into 0.275 rad.
    assert abs(snapshot.joint_position[4]) == pytest.approx(0.275, abs=0.01)
    a = math.asin(2.02 * math.tan(snapshot.joint_position[4]) - 0.8 * math.sin(snapshot.joint_position[5]))
    assert snapshot.motor_position[4] == pytest.approx(a)


def test_explicit_ankle_gains_act_through_the_exact_mechanism(make_bench: Callable) -> None:
    bench = make_bench("hold", ankle="exact")
    pose = STAND_POSITION.copy()
    pose[4:6] = 0.3, 0.1
    kp, kd = bench.firmware.linkage.joint_gains(np.full(25, 20.0), np.full(25, 1.0), pose)
    for _ in range(100):
        bench.firmware.command(Trajectory(pose, kp, kd))
        snapshot = bench.run(0.02)
    # A law at the motors, 20 (target - angle) each, holds the same torques in this pose.
    error = bench.firmware.linkage.motor_position(pose) - snapshot.motor_position
    assert snapshot.motor_torque[4:6] == pytest.approx(20.0 * error[4:6], abs=0.1)
    assert snapshot.alerts == ()


def test_both_counters_start_again_with_each_boot_and_the_epoch_tells_boots_apart(held) -> None:
    held.run(0.1)
    first = held.firmware.snapshot
    assert (first.tick, first.timestamp_us, held.firmware.ticks) == (20, 100_000, 20)
    held.firmware.restart()
    second = held.run(0.05)
    assert (second.boot, second.tick, second.timestamp_us, held.firmware.ticks) == (2, 10, 50_000, 30)
    assert first.epoch != second.epoch
    assert all(0 < epoch < 2**63 for epoch in (first.epoch, second.epoch))


def test_epochs_repeat_in_lockstep_and_differ_in_real_time() -> None:
    physics = CPhysics(1)
    assert (
        Firmware(physics, StepClock(), seed=3).snapshot.epoch == Firmware(physics, StepClock(), seed=3).snapshot.epoch
    )
    assert (
        Firmware(physics, StepClock(), seed=3).snapshot.epoch != Firmware(physics, StepClock(), seed=4).snapshot.epoch
    )
    assert Firmware(physics, WallClock()).snapshot.epoch != Firmware(physics, WallClock()).snapshot.epoch


def test_inference_and_battery_are_reported(bench) -> None:
    walking(bench)
    snapshot = bench.firmware.snapshot
    assert snapshot.inference.count == 5
    assert 0.0 < snapshot.inference.average_ms <= snapshot.inference.max_ms
    assert 45.0 < snapshot.battery.voltage_v < 54.6
    assert snapshot.battery.current_a < -60.0 / 54.6
    assert 99.9 < snapshot.battery.soc_percent < 100.0


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("watchdog_s", 0.01),
        ("tumble_rate", -1.0),
        ("tumble_tilt_deg", 190.0),
        ("imu_failure_s", float("nan")),
        ("trajectory_timeout_s", 0.0),
        ("damp_kd", 9.0),
        ("trip_clear_c", 90.0),
        ("ankle", "springy"),
        ("stand_ramp_s", -1.0),
    ],
)
def test_config_names_the_bad_field(field: str, value: object) -> None:
    with pytest.raises(ValueError, match=field):
        FirmwareConfig(**{field: value})  # type: ignore[arg-type]


def test_gantry_config_names_the_bad_field() -> None:
    with pytest.raises(ValueError, match="gantry mode must be one of auto, hold, off, got 'crane'"):
        GantryConfig(mode="crane")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="gantry stiffness"):
        GantryConfig(stiffness=-1.0)
