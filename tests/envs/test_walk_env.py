"""`Asimov-Walk-v0`: arguments, action, command, end of an episode."""

import gymnasium as gym
import numpy as np
import pytest

from asimov_gym.tasks.walk import WalkConfig

ID = "Asimov-Walk-v0"
REST = np.zeros(23, dtype=np.float32)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"layout": "asimov-79"}, "layout must be one of asimov-80, asimov-78, got 'asimov-79'"),
        ({"profile": "fast"}, "physics profile 'fast' is unknown; known profiles: evaluation, training"),
        ({"command": (0.5, 0.0)}, r"command must be \(vx, vy, wz\)"),
        ({"command": (0.5, 1.5, 0.0)}, r"command vy must lie in \[-1, 1\], got 1.5"),
        ({"command": (0.5, np.nan, 0.0)}, r"command vy must lie in \[-1, 1\], got nan"),
        ({"config": {"step_hight": 0.1}}, r"unknown keys \['step_hight'\] in config; known keys: layout"),
        ({"config": {"command": {"vx": [1.0, -1.0]}}}, "command.vx must be ordered low to high"),
        ({"config": {"rewards": {"joy": 1.0}}}, r"rewards has unknown terms \['joy'\]; known terms: track_velocity"),
        ({"config": 3}, "config must be a WalkConfig, a mapping of overrides or None, got 3"),
        ({"noise": 1}, "noise must be True or False, got 1"),
        ({"randomise": "yes"}, "randomise must be True or False, got 'yes'"),
        ({"kicks": None}, "kicks must be True or False, got None"),
        ({"episode_s": -1.0}, r"episode_s must lie in \[0.02, 1e\+06\], got -1.0"),
        ({"threads": 0}, "threads must be at least 1, got 0"),
        ({"camera": "above"}, "camera must be one of third_person, side, front, first_person, got 'above'"),
        ({"width": 1}, r"width must be a whole number in \[16, 1920\], got 1"),
    ],
)
def test_arguments_are_checked(arguments, message):
    with pytest.raises(ValueError, match=message):
        gym.make(ID, **arguments)


def test_unknown_argument_is_named():
    with pytest.raises(TypeError, match="speed"):
        gym.make(ID, speed=1)


def test_layouts():
    with_clock, without = gym.make(ID), gym.make(ID, layout="asimov-78")
    assert with_clock.observation_space.shape == (80,)
    assert without.observation_space.shape == (78,)
    a, b = with_clock.reset(seed=0)[0], without.reset(seed=0)[0]
    assert np.array_equal(a[:78], b)


def test_reset_options():
    env = gym.make(ID)
    observation, info = env.reset(seed=0, options={"command": (0.4, -0.2, 0.5)})
    assert np.allclose(info["command"], (0.4, -0.2, 0.5))
    assert np.allclose(observation[6:9], (0.4, -0.2, 0.5))
    for _ in range(400):  # longer than the time after which commands are drawn anew
        *_, info = env.step(REST)
    assert np.allclose(info["command"], (0.4, -0.2, 0.5))
    with pytest.raises(ValueError, match=r"reset options \['comand'\] are unknown; known options: command"):
        env.reset(options={"comand": (0, 0, 0)})
    with pytest.raises(ValueError, match=r"options\['command'\] vx must lie in \[-2, 2\], got 3.0"):
        env.reset(options={"command": (3.0, 0.0, 0.0)})


def test_commands_are_drawn_anew():
    env = gym.make(ID, config={"command": {"interval_s": [0.1, 0.1], "standing_share": 0.0, "single_axis_share": 0.0}})
    env.reset(seed=0)
    commands = [tuple(env.step(REST)[4]["command"]) for _ in range(20)]
    assert len(set(commands)) == 4 or len(set(commands)) == 5


def test_clipping_is_counted():
    env = gym.make(ID, command=(0.0, 0.0, 0.0))
    env.reset(seed=0)
    action = REST.copy()
    action[[2, 7]] = 5.0, -1.5
    observation, *_, info = env.step(action)
    assert info["clipped"] == 2
    assert observation[55 + 2] == 1.0
    assert observation[55 + 7] == -1.0
    assert env.step(REST)[4]["clipped"] == 0


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_action_that_is_not_finite(value):
    env = gym.make(ID)
    env.reset(seed=0)
    action = REST.copy()
    action[4] = value
    with pytest.raises(ValueError, match=r"action\[4\] must be a finite number"):
        env.step(action)


def test_wrong_shape():
    env = gym.make(ID)
    env.reset(seed=0)
    with pytest.raises(ValueError, match=r"action must have shape \(23,\), got \(25,\)"):
        env.step(np.zeros(25))


def test_stands_until_time_is_up():
    env = gym.make(ID, command=(0.0, 0.0, 0.0), episode_s=2.0, profile="evaluation")
    _, info = env.reset(seed=6)  # a start from which the drives' stiffness alone keeps it up
    total = 0.0
    for step in range(1, 101):
        observation, reward, terminated, truncated, info = env.step(REST)
        assert env.observation_space.contains(observation)
        assert not terminated
        assert truncated == (step == 100)
        total += reward
        assert reward == pytest.approx(0.02 * max(0.0, sum(info["reward_terms"].values())), abs=1e-6)
    assert total > 1.0
    assert info["privileged"].shape == (96,)


def test_falls():
    env = gym.make(ID)
    env.reset(seed=0)
    for _ in range(200):
        *_, terminated, truncated, _ = env.step(np.ones(23, dtype=np.float32))
        if terminated:
            break
    assert terminated
    assert not truncated


def test_configuration_object_is_taken_as_it_is():
    env = gym.make(ID, config=WalkConfig())
    assert isinstance(env.action_space, gym.spaces.Box)
    assert env.action_space.high[0] == WalkConfig().action_clip
