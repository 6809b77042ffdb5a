"""The trajectory task's pure functions: ankles, gains, rewards, error bits."""

import numpy as np
import pytest

from asimov_gym.physics import CPhysics, JointTarget
from asimov_gym.robot import ankle
from asimov_gym.robot.joints import JOINT_NAMES, RANGE, STAND_POSITION, joint_index
from asimov_gym.tasks.trajectory import TrajectoryConfig, TrajectoryTask, rewards, telemetry

PITCH, ROLL = joint_index("left_ankle_pitch_joint"), joint_index("left_ankle_roll_joint")


@pytest.fixture(scope="module")
def reading():
    physics = CPhysics(3)
    reading = physics.step(JointTarget(np.tile(STAND_POSITION, (3, 1))), 4)
    physics.close()
    return reading


@pytest.mark.parametrize("form", ankle.FORMS)
def test_actions_are_motor_angles(form):
    task = TrajectoryTask(TrajectoryConfig(ankle=form))
    joints = np.tile(STAND_POSITION, (2, 1))
    joints[1, PITCH], joints[1, ROLL] = 0.1, -0.2
    target, clipped = task.target(ankle.to_motor_position(joints, form))
    assert np.allclose(target.position, joints)
    assert clipped.tolist() == [0, 0]
    assert target.kp is None


def test_action_bounds_are_the_motors_ranges():
    task = TrajectoryTask()
    rest = np.array(["ankle" not in name for name in JOINT_NAMES])
    assert np.array_equal(task.action_low[rest], RANGE[rest, 0])
    assert np.array_equal(task.action_high[rest], RANGE[rest, 1])
    corner = (ankle.K_PITCH + ankle.K_ROLL) * 0.35
    assert np.allclose(task.action_high[[PITCH, ROLL]], corner)
    assert np.allclose(task.action_low[[PITCH, ROLL]], -corner)


def test_targets_beyond_a_joint_are_clipped_though_each_motor_could_reach_them():
    task = TrajectoryTask()
    motors = ankle.to_motor_position(STAND_POSITION[None])
    motors[0, [PITCH, ROLL]] = 0.9, -0.9  # pure pitch of 0.45 rad, beyond 0.35
    target, clipped = task.target(motors)
    assert target.position[0, PITCH] == pytest.approx(0.35)
    assert clipped.tolist() == [1]


def test_gains_at_the_motors_become_gains_at_the_joints():
    task = TrajectoryTask(TrajectoryConfig(gains=True))
    action = np.concatenate([ankle.to_motor_position(STAND_POSITION), np.full(25, 10.0), np.full(25, 7.0)])[None]
    target, clipped = task.target(action)
    assert clipped.tolist() == [25], "damping gains end at 5"
    knee = joint_index("left_knee_joint")
    assert (target.kp[0, knee], target.kd[0, knee]) == (10.0, 5.0)
    assert target.kp[0, PITCH] == pytest.approx(2.0 * ankle.K_PITCH**2 * 10.0)
    assert target.kd[0, ROLL] == pytest.approx(2.0 * ankle.K_ROLL**2 * 5.0)


def test_reward_prefers_being_where_the_motion_is(reading):
    def tracking(offset):
        q = reading.joint_position
        return rewards.Tracking(
            reading=reading,
            reference=q + np.array([0.0, 0.08, offset])[:, None],
            reference_velocity=reading.joint_velocity,
            target=np.stack([q, q], axis=1),
        )

    near, medium, far = rewards.track_position(tracking(0.3))
    assert near == 1.0
    assert 0.5 < medium < 0.55
    assert far < 1e-3
    total, shares = rewards.total(tracking(0.3), TrajectoryConfig().rewards, 0.02)
    assert total[0] > total[1] > total[2] > 0.0
    assert np.allclose(total, 0.02 * sum(shares.values()))


def test_penalties_do_not_make_a_reward_negative(reading):
    q = reading.joint_position
    tracking = rewards.Tracking(reading, q, reading.joint_velocity, np.stack([q, q + 3.0], axis=1))
    total, shares = rewards.total(tracking, {"target_rate": -1.0}, 0.02)
    assert np.allclose(shares["target_rate"], -9.0 * 25)
    assert np.array_equal(total, np.zeros(3))


def test_reference_looks_ahead_and_repeats(reading):
    task = TrajectoryTask(TrajectoryConfig(ahead=(0, 1, 200)))
    state = task.initial_state(reading.joint_position)
    state = type(state)(np.array([0, 30, 230]), state.target, state.temperature, state.torque)
    observation = task.observe(state, reading)
    frames = ankle.to_motor_position(task.motion.frames)
    assert np.allclose(observation["reference"][0], frames[[0, 1, 0]], atol=1e-6)
    assert np.allclose(observation["reference"][1], frames[[30, 31, 30]], atol=1e-6)
    assert np.allclose(observation["reference"][2], observation["reference"][1])
    assert np.allclose(observation["phase"][1], (np.cos(0.3 * np.pi), np.sin(0.3 * np.pi)), atol=1e-6)


def test_heat_raises_alerts_and_then_latches():
    fallen = np.array([False, False, False, True])
    temperature = np.full((4, 25), 25.0)
    temperature[1, 3], temperature[2, 3] = 65.0, 85.0
    assert telemetry.alert_count(fallen, temperature).tolist() == [0, 1, 2, 1]
    assert telemetry.error_flags(fallen, temperature).tolist() == [0, 0, 0x9, 0x101]
    assert telemetry.active_alerts(False, temperature[2]) == ((2, 3), (17, 3))
    task = TrajectoryTask()
    state = task.initial_state(np.tile(STAND_POSITION, (4, 1)))
    state = type(state)(state.step, state.target, temperature, state.torque)
    assert task.overheated(state).tolist() == [False, False, True, False]


def test_same_on_another_array_library(reading):
    torch = pytest.importorskip("torch", reason="needs torch: pip install 'asimov-gym[train]'")
    import dataclasses

    task = TrajectoryTask()
    other = type(reading)(**{f.name: torch.tensor(getattr(reading, f.name)) for f in dataclasses.fields(reading)})
    action = np.tile(ankle.to_motor_position(STAND_POSITION), (3, 1)) + 0.2

    def run(action, reading):
        target, clipped = task.target(action)
        state = task.advance(task.initial_state(reading.joint_position), target, reading)
        reward, _ = task.reward(state, reading)
        return {"clipped": clipped, "reward": reward, **task.observe(state, reading)}

    ours, theirs = run(action, reading), run(torch.tensor(action), other)
    for name, value in ours.items():
        assert isinstance(theirs[name], torch.Tensor)
        assert np.allclose(value, theirs[name].numpy(), atol=1e-6), name
