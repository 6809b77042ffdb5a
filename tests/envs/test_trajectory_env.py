"""`Asimov-Trajectory-v0`: the telemetry observation, playing motions, gains, clipping, end of an episode."""

import gymnasium as gym
import numpy as np
import pytest

from asimov_gym.edge.wire import cloud_pb2
from asimov_gym.firmware.alerts import AlertId
from asimov_gym.robot.joints import JOINT_NAMES, MOTOR_NAMES, STAND_POSITION

ID = "Asimov-Trajectory-v0"


def play(env, steps, seed=0):
    """Follow the reference open loop; the largest root mean square error, the heights, the mean reward, and the last
    step."""
    observation, _ = env.reset(seed=seed)
    worst, heights, rewards = 0.0, [], []
    for _ in range(steps):
        observation, reward, terminated, truncated, info = env.step(observation["reference"][1])
        error = observation["joint_pos"] - observation["reference"][0]
        worst = max(worst, float(np.sqrt(np.mean(error**2))))
        rewards.append(reward)
        heights.append(env.unwrapped._batch.physics.state().qpos[0, 2])
        assert not terminated
        assert info["clipped"] == 0
        assert info["active_alerts"] == ()
    return worst, heights, observation, float(np.mean(rewards)), truncated, info


@pytest.mark.parametrize("motion", ["squat", "arm_wiggle"])
def test_playing_the_reference_follows_the_motion(motion):
    env = gym.make(ID, motion=motion)
    worst, heights, observation, reward, truncated, info = play(env, 600)
    assert truncated
    assert worst < 0.12
    assert reward > 0.9 * 0.02 * 3.5, "nearly all that there is to earn"
    assert env.observation_space.contains(observation)
    depth = max(heights) - min(heights)
    assert depth > 0.07 if motion == "squat" else depth < 0.02
    assert info["fw_timestamp_us"] == 600 * 20_000
    assert info["sequence"] == 600


def test_fields_are_those_of_the_message():
    env = gym.make(ID)
    observation, info = env.reset(seed=0)
    message = cloud_pb2.EdgeTelemetry()
    names = {field.name for field in message.DESCRIPTOR.fields}
    goal = {"reference", "phase"}
    assert set(observation) - goal < names
    assert set(info) < names
    elsewhere = {"last_video_timestamp_us", "last_audio_timestamp_us", "applied_cmd"}
    assert (set(observation) - goal) | set(info) == names - elsewhere
    assert observation["fw_mode"] == cloud_pb2.FW_MODE_MOVE


def test_at_rest_the_observation_is_the_standing_robot():
    env = gym.make(ID, config={"start_noise": 0.0})
    observation, _ = env.reset(seed=0)
    ankles = [MOTOR_NAMES.index(f"{side}_Ankle_{motor}") for side in "LR" for motor in "AB"]
    rest = [i for i in range(25) if i not in ankles]
    assert np.allclose(observation["joint_pos"][rest], STAND_POSITION[rest])
    # Pitch -0.3 rad is -0.606 rad of motor A and +0.606 rad of motor B; the right side is the mirrored one.
    assert np.allclose(observation["joint_pos"][ankles], (-0.606, 0.606, 0.606, -0.606))
    pose = observation["reference"][0]
    for _ in range(25):
        observation, *_ = env.step(pose)
    assert observation["imu_gravity"][2] == pytest.approx(-1.0, abs=0.01)
    assert np.linalg.norm(observation["imu_quat"]) == pytest.approx(1.0, abs=1e-5)
    assert np.all(observation["joint_temp"] >= 25.0)
    knee = MOTOR_NAMES.index("L_Knee")
    assert abs(observation["joint_current"][knee]) > 0.1, "a bent knee carries"


def test_motors_heat_with_their_load():
    env = gym.make(ID)
    observation, _ = env.reset(seed=0)
    knee, wrist = MOTOR_NAMES.index("L_Knee"), MOTOR_NAMES.index("L_Wrist_Yaw")
    for _ in range(200):
        observation, *_ = env.step(observation["reference"][1])
    assert observation["joint_temp"][knee] > observation["joint_temp"][wrist] >= 25.0


def test_gains_act():
    env = gym.make(ID, gains=True, config={"start_noise": 0.0})
    elbow = MOTOR_NAMES.index("L_Elbow")
    reached = {}
    for kp in (0.0, 40.0):
        observation, _ = env.reset(seed=0)
        action = np.concatenate([observation["reference"][0], np.full(25, 100.0), np.full(25, 5.0)]).astype(np.float32)
        action[elbow], action[25 + elbow] = 1.2, kp
        for _ in range(40):
            observation, *_ = env.step(action)
        reached[kp] = observation["joint_pos"][elbow]
    assert reached[40.0] > 1.0
    assert reached[0.0] < 0.9


def test_clipping_is_counted():
    env = gym.make(ID, gains=True)
    observation, _ = env.reset(seed=0)
    action = np.concatenate([observation["reference"][0], np.full(25, 100.0), np.full(25, 5.0)]).astype(np.float32)
    assert env.step(action)[4]["clipped"] == 0
    action[JOINT_NAMES.index("left_knee_joint")] = 3.0
    action[25], action[50] = 600.0, -1.0
    assert env.step(action)[4]["clipped"] == 3


def test_a_fall_latches_the_robots_error_bits():
    env = gym.make(ID)
    observation, _ = env.reset(seed=0)
    action = observation["reference"][0].copy()
    action[[0, 6]] = -1.5, 1.5  # both legs forward
    for _ in range(200):
        observation, _, terminated, _, info = env.step(action)
        if terminated:
            break
    assert terminated
    assert observation["error_flags"] == [0x101]
    assert observation["alert_count"] == [1]
    assert info["active_alerts"] == ((AlertId.FALL_DETECTED, 0),)


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"motion": "cartwheel"}, ValueError, "motion must be one of arm_wiggle, squat or a path to a .yaml file"),
        ({"motion": "nowhere/dance.yaml"}, FileNotFoundError, "dance.yaml"),
        ({"gains": 1}, ValueError, "gains must be True or False, got 1"),
        ({"ankle": "springy"}, ValueError, "ankle must be one of linear, exact, got 'springy'"),
        ({"episode_s": 0.0}, ValueError, r"episode_s must lie in \[0.1, 1e\+06\], got 0.0"),
        ({"config": {"ahead": [-1]}}, ValueError, r"ahead must be whole numbers in \[0, 500\]"),
        ({"config": {"speed": 2}}, ValueError, r"unknown keys \['speed'\] in config; known keys: motion"),
        (
            {"config": {"rewards": {"grace": 1.0}}},
            ValueError,
            r"unknown terms \['grace'\]; known terms: track_position",
        ),
        ({"profile": "fast"}, ValueError, "known profiles: evaluation, training"),
    ],
)
def test_arguments_are_checked(arguments, error, message):
    with pytest.raises(error, match=message):
        gym.make(ID, **arguments)


def test_nan_action():
    env = gym.make(ID)
    observation, _ = env.reset(seed=0)
    action = observation["reference"][0].copy()
    action[24] = np.nan
    with pytest.raises(ValueError, match=r"action\[24\] must be a finite number, got nan"):
        env.step(action)
