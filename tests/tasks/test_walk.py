"""The walking task: its functions obey the mirror, the clock, their ranges and their own documentation."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from asimov_gym.envs.walk_batch import WalkBatch
from asimov_gym.physics import CPhysics, JointTarget, Reading
from asimov_gym.presets import from_mapping, to_mapping
from asimov_gym.robot import frames, mirror
from asimov_gym.robot.joints import JOINT_NAMES, POLICY_TO_JOINT, RANGE, STAND_POSITION, VELOCITY_LIMIT
from asimov_gym.tasks.walk import WalkConfig, WalkState, WalkTask, rewards
from asimov_gym.tasks.walk import task as walk
from asimov_gym.tasks.walk.config import CommandConfig
from asimov_gym.tasks.walk.draws import draw_command
from asimov_gym.tasks.walk.state import COMMAND_DRAWS, POSE_DRAWS, RESET_DRAWS, SENSOR_DRAWS


def _random_motion(task: WalkTask, n: int = 16, seed: int = 0) -> tuple[WalkState, Reading]:
    """A state and reading with every entry alive."""
    rng = np.random.default_rng(seed)
    state = task.initial_state(rng.random((n, RESET_DRAWS)))
    state = replace(
        state,
        command=rng.uniform(-0.5, 0.5, (n, 3)),
        phase=rng.uniform(0, 2 * np.pi, n),
        action=rng.standard_normal((n, 3, 23)),
        mean_velocity=rng.uniform(-0.5, 0.5, (n, 3)),
    )
    _, _, quat, _ = task.initial_pose(rng.random((n, POSE_DRAWS)))
    reading = Reading(
        base_position=rng.normal(0, 0.1, (n, 3)) + np.array([0, 0, 0.6]),
        base_quat=quat,
        base_velocity=rng.normal(0, 0.3, (n, 3)),
        gyro=rng.normal(0, 0.3, (n, 3)),
        gravity=frames.projected_gravity(quat),
        joint_position=STAND_POSITION + rng.normal(0, 0.3, (n, 25)),
        joint_velocity=rng.normal(0, 1, (n, 25)),
        joint_torque=rng.normal(0, 10, (n, 25)),
        foot_position=rng.normal(0, 0.1, (n, 2, 3)) + np.array([0, 0, 0.05]),
        foot_velocity=rng.normal(0, 0.3, (n, 2, 3)),
        foot_up=rng.normal(0, 0.1, (n, 2, 3)) + np.array([0, 0, 1]),
        foot_force=rng.normal(80, 80, (n, 2, 3)),
    )
    return state, reading


def _mirrored(state: WalkState, reading: Reading) -> tuple[WalkState, Reading]:
    """The same world in the mirror: the plane of reflection is the world's x-z plane."""

    def feet(vectors: np.ndarray) -> np.ndarray:
        return mirror.mirror_polar(vectors)[:, ::-1]

    return (
        replace(
            state,
            command=mirror.mirror_command(state.command),
            phase=(state.phase + np.pi) % (2 * np.pi),
            action=mirror.mirror_policy(state.action),
            joint_zero=mirror.mirror_joints(state.joint_zero),
            mean_velocity=mirror.mirror_command(state.mean_velocity),
        ),
        Reading(
            base_position=mirror.mirror_polar(reading.base_position),
            base_quat=mirror.mirror_quaternion(reading.base_quat),
            base_velocity=mirror.mirror_polar(reading.base_velocity),
            gyro=mirror.mirror_axial(reading.gyro),
            gravity=mirror.mirror_polar(reading.gravity),
            joint_position=mirror.mirror_joints(reading.joint_position),
            joint_velocity=mirror.mirror_joints(reading.joint_velocity),
            joint_torque=mirror.mirror_joints(reading.joint_torque),
            foot_position=feet(reading.foot_position),
            foot_velocity=feet(reading.foot_velocity),
            foot_up=feet(reading.foot_up),
            foot_force=feet(reading.foot_force),
        ),
    )


@pytest.mark.parametrize("layout", ["asimov-80", "asimov-78"])
def test_observations_of_a_mirrored_world_are_mirrored(layout: str) -> None:
    task = WalkTask(WalkConfig(layout=layout))
    state, reading = _random_motion(task)
    other_state, other_reading = _mirrored(state, reading)
    batch = WalkBatch(copies=16)
    np.testing.assert_allclose(
        task.observe(other_state, other_reading), task.layout.mirror(task.observe(state, reading)), atol=1e-5
    )
    np.testing.assert_allclose(
        task.privilege(other_state, other_reading, batch.body),
        task.privileged_mirror(task.privilege(state, reading, batch.body)),
        atol=1e-4,
    )


@pytest.mark.parametrize("name", sorted(rewards.TERMS))
def test_every_reward_is_the_same_in_the_mirror(name: str) -> None:
    task = WalkTask()
    state, reading = _random_motion(task)
    value = rewards.TERMS[name](task.motion(state, reading)[1])
    mirrored = rewards.TERMS[name](task.motion(*_mirrored(state, reading))[1])
    assert value.shape == (16,)
    np.testing.assert_allclose(mirrored, value, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("name", ["foot_height", "foot_contact", "rest", "rest_pose", "rest_stance", "rest_drift"])
def test_a_robot_thrown_off_may_step(name: str) -> None:
    """The terms for standing count at rest, and not while the pelvis moves faster than the configuration says."""
    _, motion = (task := WalkTask(WalkConfig(thrown_speed=0.3))).motion(*_random_motion(task))
    still, nothing = np.zeros(16), rewards.TERMS[name]
    away = replace(motion, moving=still, swing=np.zeros((16, 2)), resting=still)
    assert (nothing(away) == (1.0 if name.startswith("foot") else 0.0)).all()
    assert (nothing(replace(away, resting=still + 1.0)) != nothing(away)).any()


def test_the_stance_at_rest_is_that_of_stand() -> None:
    """Nothing where a robot in STAND comes to rest, 4 for both feet 5 cm too far forward and to one side, capped far
    off."""
    physics = CPhysics(1)
    physics.reset(*physics.standing())
    reading = physics.step(JointTarget(STAND_POSITION[None, None].repeat(1600, axis=1)), 1600)
    angle = frames.heading(reading.base_quat)
    feet = frames.to_heading(angle[:, None], reading.foot_position - reading.base_position[:, None])
    _, motion = (task := WalkTask()).motion(*_random_motion(task))
    values = []
    for shift in ((0.0, 0.0), (0.05, -0.05), (0.4, 0.0)):
        offset = feet.repeat(16, axis=0) + np.array([*shift, 0.0])
        values.append(rewards.rest_stance(replace(motion, foot_offset=offset, resting=np.ones(16)))[0])
    np.testing.assert_allclose(values, [0.0, 4.0, 16.0], atol=0.15)


def test_who_is_thrown_off() -> None:
    state, reading = _random_motion(task := WalkTask(WalkConfig(thrown_speed=0.5)))
    state = replace(state, command=np.zeros((16, 3), dtype=np.float32))
    motion = task.motion(state, reading)[1]
    speed = np.linalg.norm(reading.base_velocity[:, :2], axis=1)
    assert (speed > 0.5).any() and (speed < 0.5).any()
    np.testing.assert_array_equal(motion.resting, speed < 0.5)
    assert (WalkTask().motion(state, reading)[1].resting == 1.0).all()


def test_the_feet_belong_under_the_capture_point() -> None:
    """Thrown forward at 2 m/s beyond the command, the feet should be half a metre ahead of the pelvis."""
    state, reading = _random_motion(task := WalkTask())
    motion = task.motion(state, reading)[1]
    velocity = np.concatenate([motion.command[:, :2], np.zeros((16, 1))], axis=1) + np.array([2.0, 0.0, 0.0])
    ahead = np.zeros((16, 2, 3)) + np.array([0.5, 0.0, -0.6])
    ahead[:, :, 1] = 0.1, -0.1
    there = rewards.capture(replace(motion, velocity=velocity, foot_offset=ahead))
    np.testing.assert_allclose(there, 1.0)
    short = rewards.capture(replace(motion, velocity=velocity, foot_offset=ahead * np.array([0.5, 1.0, 1.0])))
    assert (short < 0.3).all()


def test_tracking_is_best_on_the_command() -> None:
    task = WalkTask()
    state, reading = _random_motion(task)
    _, motion = task.motion(state, reading)
    on = replace(
        motion,
        velocity=np.concatenate([motion.command[:, :2], np.zeros((16, 1))], axis=1),
        yaw_rate=motion.command[:, 2],
        mean_velocity=motion.command,
    )
    for term in (
        rewards.track_velocity,
        rewards.track_yaw_rate,
        rewards.track_velocity_closely,
        rewards.track_yaw_rate_closely,
        rewards.track_mean_velocity,
        rewards.track_mean_yaw_rate,
    ):
        np.testing.assert_allclose(term(on), 1.0)
        assert (
            term(
                replace(
                    on, velocity=on.velocity + 0.5, yaw_rate=on.yaw_rate + 0.5, mean_velocity=on.mean_velocity + 0.5
                )
            )
            < 0.6
        ).all()


def test_close_tracking_tells_a_sway_of_five_centimetres_per_second_from_one_of_ten() -> None:
    """The wide terms hardly do: this is what they are for."""
    _, motion = (task := WalkTask()).motion(*_random_motion(task))
    on = replace(motion, velocity=np.concatenate([motion.command[:, :2], np.zeros((16, 1))], axis=1))
    small, large = (replace(on, velocity=on.velocity + np.array([0.0, sway, 0.0])) for sway in (0.05, 0.1))
    assert (rewards.track_velocity_closely(small) - rewards.track_velocity_closely(large) > 0.2).all()
    assert (rewards.track_velocity(small) - rewards.track_velocity(large) < 0.05).all()


def test_only_joints_near_their_speed_limit_cost_something() -> None:
    _, motion = (task := WalkTask()).motion(*_random_motion(task))
    speed = np.zeros((16, 25))
    speed[:, 3], speed[:, 13], speed[:, 17] = 0.79 * VELOCITY_LIMIT[3], -0.9 * VELOCITY_LIMIT[13], VELOCITY_LIMIT[17]
    fast = replace(motion, reading=replace(motion.reading, joint_velocity=speed))
    np.testing.assert_allclose(rewards.joint_speed(fast), 0.1 + 0.2)


def test_standing_still_does_not_earn_the_step_reward() -> None:
    """While asked to walk, feet that stay down must earn clearly less than feet that follow the clock."""
    task = WalkTask()
    state, reading = _random_motion(task, n=50)
    state = replace(state, command=np.tile([0.5, 0.0, 0.0], (50, 1)), phase=np.linspace(0, 2 * np.pi, 50))
    _, motion = task.motion(state, reading)
    down = replace(motion, foot_height=np.zeros((50, 2)))
    following = replace(motion, foot_height=0.08 * np.clip(motion.swing, 0, 1))
    assert rewards.foot_height(following).mean() == pytest.approx(1.0)
    assert rewards.foot_height(down).mean() < 0.6


def test_penalties_scale_with_their_level_and_the_sum_stays_positive() -> None:
    task = WalkTask()
    _, motion = task.motion(*_random_motion(task))
    full, shares = task.reward(motion, 1.0)
    _, light = task.reward(motion, 0.1)
    for name, weight in task.config.rewards.items():
        factor = 0.1 if weight < 0 else 1.0
        np.testing.assert_allclose(light[name], shares[name] * factor, err_msg=name)
    assert (full >= 0.0).all()
    np.testing.assert_allclose(full, np.clip(sum(shares.values()), 0, None) * walk.DT)


def test_targets_hold_the_neck_and_stay_in_range() -> None:
    task = WalkTask()
    state, _ = _random_motion(task)
    state = replace(state, action=8.0 * state.action, delay=np.zeros(16, dtype=int))
    targets = task.targets(state)
    assert targets.shape == (16, 4, 25)
    assert (targets >= RANGE[:, 0] - 1e-9).all() and (targets <= RANGE[:, 1] + 1e-9).all()
    neck = [JOINT_NAMES.index("neck_pitch_joint"), JOINT_NAMES.index("neck_yaw_joint")]
    assert (targets[..., neck] == STAND_POSITION[neck]).all()
    small = replace(state, action=0.1 * np.ones((16, 3, 23)))
    inside = np.clip(STAND_POSITION[POLICY_TO_JOINT] + 0.025, RANGE[POLICY_TO_JOINT, 0], RANGE[POLICY_TO_JOINT, 1])
    np.testing.assert_allclose(task.targets(small)[..., POLICY_TO_JOINT], np.broadcast_to(inside, (16, 4, 23)))


def test_commands_fill_their_ranges_and_stand_now_and_then() -> None:
    task = WalkTask()
    commands, lifetimes = draw_command(task.config.command, np.random.default_rng(0).random((20000, COMMAND_DRAWS)))
    c = task.config.command
    for axis, (low, high) in enumerate((c.vx, c.vy, c.wz)):
        assert low <= commands[:, axis].min() < low + 0.02 and high - 0.02 < commands[:, axis].max() <= high
    assert (commands == 0).all(axis=1).mean() == pytest.approx(c.standing_share, abs=0.01)
    single = ((commands != 0).sum(axis=1) == 1).mean()
    assert single == pytest.approx(c.single_axis_share, abs=0.01)
    assert lifetimes.min() >= c.interval_s[0] * 50 and lifetimes.max() <= c.interval_s[1] * 50


def test_commands_come_from_the_corners_of_their_ranges_too() -> None:
    config = CommandConfig(vx=(-0.5, 0.8), standing_share=0.2, single_axis_share=0.1, corner_share=0.54)
    commands, _ = draw_command(config, np.random.default_rng(0).random((20000, COMMAND_DRAWS)))
    places = np.array([[*config.vx, 0.0], [*config.vy, 0.0], [*config.wz, 0.0]])
    corner = (commands[:, :, None] == places).any(axis=2).all(axis=1) & ((commands != 0.0).sum(axis=1) > 1)
    assert corner.mean() == pytest.approx(0.54 * 20 / 27, abs=0.01)  # two velocities or three
    kinds, counts = np.unique(commands[corner], axis=0, return_counts=True)
    assert len(kinds) == 20 and counts.min() > 0.8 * counts.max()
    assert (commands == 0).all(axis=1).mean() == pytest.approx(0.2 + 0.54 / 27, abs=0.01)
    with pytest.raises(ValueError, match=r"command.corner_share must lie in \[0, 0.7\], got 0.71"):
        replace(config, corner_share=0.71)


def test_clock_rests_while_standing_and_commands_are_renewed() -> None:
    task = WalkTask()
    state, _ = _random_motion(task, n=2)
    state = replace(
        state, command=np.array([[0.0, 0, 0], [0.5, 0, 0]]), command_left=np.array([5, 1]), phase=np.array([1.0, 1.0])
    )
    assert (task.clock(state)[0] == 0).all() and np.allclose(task.clock(state)[1], [np.cos(1), np.sin(1)])
    after = task.advance(state, np.full((2, COMMAND_DRAWS), 0.5))
    assert after.phase[0] == 1.0 and after.phase[1] == pytest.approx(1.0 + 2 * np.pi * 1.5 * 0.02)
    assert (after.command[0] == 0).all() and after.command_left[0] == 4
    assert after.command_left[1] > 100


def test_falls_are_tilts_beyond_60_degrees_and_sinking_below_35_cm() -> None:
    task = WalkTask()
    _, reading = _random_motion(task, n=4)
    tilt = np.deg2rad([0.0, 59.0, 61.0, 0.0])
    gravity = np.stack([np.sin(tilt), 0 * tilt, -np.cos(tilt)], axis=1)
    height = np.array([[0, 0, 0.6], [0, 0, 0.6], [0, 0, 0.6], [0, 0, 0.34]])
    fallen = task.fallen(replace(reading, gravity=gravity, base_position=height))
    assert fallen.tolist() == [False, False, True, True]


def test_noise_stays_within_its_bounds_and_spares_the_critic() -> None:
    task = WalkTask()
    state, reading = _random_motion(task)
    state = replace(state, joint_zero=np.zeros((16, 25)))
    clean = task.observe(state, reading)
    edge = task.observe(state, reading, np.ones((16, SENSOR_DRAWS)))
    slices, n = task.layout.slices, task.config.noise
    np.testing.assert_allclose((edge - clean)[:, slices["gyro"]], 0.25 * n.gyro, atol=1e-5)
    np.testing.assert_allclose((edge - clean)[:, slices["joint_velocity_1"]], 0.1 * n.joint_velocity, atol=1e-5)
    np.testing.assert_allclose((edge - clean)[:, slices["command"]], 0.0)
    noisy, quiet = WalkBatch(copies=2, seed=0, noise=True), WalkBatch(copies=2, seed=0, noise=False)
    assert np.abs(noisy._observe()[0] - noisy.task.observe(noisy.state, noisy.reading)).max() > 0.0
    np.testing.assert_array_equal(quiet._observe()[0], quiet.task.observe(quiet.state, quiet.reading))


@pytest.mark.parametrize(
    ("data", "words"),
    [
        ({"episode_s": -1}, "episode_s must lie in"),
        ({"layout": "asimov-81"}, "layout must be one of asimov-80, asimov-78"),
        ({"command": {"vx": [0.5, -0.5]}}, "command.vx must be ordered"),
        ({"command": {"speed": 1}}, r"unknown keys \['speed'\] in command"),
        ({"rewards": {"bonus": 1.0}}, r"unknown terms \['bonus'\]"),
        ({"noise": {"gyro": "much"}}, "noise.gyro must be a number"),
        ({"randomisation": {"foot_friction": [0.0, 1.0]}}, "randomisation.foot_friction"),
    ],
)
def test_bad_settings_name_the_field(data: dict, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        from_mapping(WalkConfig, data)


def test_settings_survive_yaml() -> None:
    config = from_mapping(WalkConfig, {"command": {"vx": [-0.1, 0.2]}, "rewards": {"slip": -1.5}})
    assert from_mapping(WalkConfig, to_mapping(config)) == config
    assert config.rewards["slip"] == -1.5 and config.rewards["alive"] == WalkConfig().rewards["alive"]


def test_batch_continues_exactly_from_a_snapshot() -> None:
    actions = np.random.default_rng(3).standard_normal((60, 8, 23))
    batch = WalkBatch(WalkConfig(episode_s=0.5), copies=8, seed=5, curriculum=True)
    for action in actions[:30]:
        batch.step(action)
    saved = batch.snapshot()
    first = [batch.step(action) for action in actions[30:]]
    other = WalkBatch(WalkConfig(episode_s=0.5), copies=8, seed=99, curriculum=True)
    other.restore(saved)
    for action, step in zip(actions[30:], first, strict=True):
        again = other.step(action)
        for f in fields(step):
            if f.name in ("observation", "privileged", "reward", "terminated", "truncated", "final_observation"):
                np.testing.assert_array_equal(getattr(again, f.name), getattr(step, f.name), err_msg=f.name)
    assert sum(step.terminated.sum() + step.truncated.sum() for step in first) > 0


def test_batch_clips_and_counts_actions_and_refuses_nan() -> None:
    batch = WalkBatch(copies=2, seed=0)
    action = np.zeros((2, 23))
    action[0, 0], action[1, 1] = 100.0, -np.inf
    assert batch.step(action).clipped == 2
    assert batch.state.action[0, 0, 0] == 8.0 and batch.state.action[1, 0, 1] == -8.0
    action[0, 5] = np.nan
    with pytest.raises(ValueError, match=r"action is NaN at \[0, 5\]"):
        batch.step(action)
    with pytest.raises(ValueError, match=r"action has shape \(2, 25\), allowed is \(2, 23\)"):
        batch.step(np.zeros((2, 25)))


def test_curriculum_grows_only_while_episodes_last() -> None:
    batch = WalkBatch(copies=2, seed=0, curriculum=True)
    for _ in range(10):
        batch.advance_curriculum()
    assert batch.curriculum.penalty == 0.1
    batch.curriculum.mean_length = 900.0
    for _ in range(2000):
        batch.advance_curriculum()
    assert batch.curriculum.penalty == 1.0 and 0.0 < batch.curriculum.kick <= 1.0
