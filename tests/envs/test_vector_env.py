"""The vector environments: shapes, masks, final observations, seeds."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode


def make(env_id, num_envs=3, **arguments):
    return gym.make_vec(env_id, num_envs=num_envs, vectorization_mode="vector_entry_point", **arguments)


def test_shapes_and_types(env_id, arguments):
    envs = make(env_id, **arguments)
    observation, _ = envs.reset(seed=0)
    assert envs.observation_space.contains(observation)
    observation, reward, terminated, truncated, _ = envs.step(np.zeros(envs.action_space.shape))
    assert envs.observation_space.contains(observation)
    assert reward.shape == terminated.shape == truncated.shape == (3,)
    assert (reward.dtype, terminated.dtype, truncated.dtype) == (np.float32, bool, bool)
    assert envs.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    envs.close()


def test_final_observation_and_masks():
    envs = make("Asimov-Walk-v0", 4, command=(0.3, 0.0, 0.0))
    envs.reset(seed=[3, 6, 7, 8])
    action = np.zeros((4, 23), dtype=np.float32)
    action[2] = 1.0  # this one throws itself to the ground, the others stand
    for _ in range(200):
        observation, _, terminated, _, info = envs.step(action)
        if terminated.any():
            break
        assert "final_obs" not in info
    assert terminated.tolist() == [False, False, True, False]
    assert info["_final_obs"].tolist() == info["_final_info"].tolist() == [False, False, True, False]
    assert [entry is None for entry in info["final_obs"]] == [True, True, False, True]
    height = 83  # of the pelvis in the critic's view, from 0.6 m in units of 0.1 m
    assert info["final_info"]["privileged"][2, height] < -2.0 or info["final_obs"][2][5] > -0.6, (
        "the old one ends fallen"
    )
    assert info["privileged"][2, height] > 0.0, "the new one begins standing"
    assert not np.array_equal(info["final_obs"][2], observation[2])
    assert info["_clipped"].tolist() == [True, True, False, True], "a fresh copy has clipped nothing yet"
    assert info["final_info"]["_clipped"].tolist() == [False, False, True, False]
    assert info["final_info"]["_reward_terms"].tolist() == [False, False, True, False]
    assert np.allclose(info["command"], (0.3, 0.0, 0.0)), "a fixed command outlives the episode"
    envs.close()


def test_returned_arrays_are_not_reused(env_id, arguments):
    envs = make(env_id, **arguments)
    envs.reset(seed=0)
    action = np.zeros(envs.action_space.shape, dtype=np.float32)
    first, second = envs.step(action), envs.step(action)
    for a, b in zip(leaves(first), leaves(second), strict=True):
        assert not np.shares_memory(a, b)


def leaves(values):
    if isinstance(values, dict):
        return [leaf for value in values.values() for leaf in leaves(value)]
    if isinstance(values, tuple):
        return [leaf for value in values for leaf in leaves(value)]
    return [values]


def test_seeds(env_id, arguments):
    envs = make(env_id, **arguments)
    by_number = leaves(envs.reset(seed=4)[0])
    by_list = leaves(envs.reset(seed=[4, 5, 6])[0])
    assert all(np.array_equal(a, b) for a, b in zip(by_number, by_list, strict=True))
    swapped = leaves(envs.reset(seed=[5, 4, 6])[0])
    assert all(np.array_equal(a[[1, 0, 2]], b) for a, b in zip(by_number, swapped, strict=True))
    with pytest.raises(ValueError, match="3 of them, one for each copy, got 2"):
        envs.reset(seed=[1, 2])


def test_statistics_wrapper_understands_it():
    envs = gym.wrappers.vector.RecordEpisodeStatistics(make("Asimov-Walk-v0", 2, episode_s=0.1))
    envs.reset(seed=0)
    for _ in range(5):
        *_, info = envs.step(np.zeros((2, 23), dtype=np.float32))
    assert info["episode"]["l"].tolist() == [5, 5]


def test_bad_input(env_id, arguments):
    with pytest.raises(ValueError, match="num_envs must be a whole number of at least 1, got 0"):
        make(env_id, 0, **arguments)
    envs = make(env_id, 2, **arguments)
    with pytest.raises(gym.error.ResetNeeded):
        envs.step(np.zeros(envs.action_space.shape))
    envs.reset()
    action = np.zeros(envs.action_space.shape, dtype=np.float32)
    action[1, 2] = np.nan
    with pytest.raises(ValueError, match=r"action\[1, 2\] must be a finite number, got nan"):
        envs.step(action)
    with pytest.raises(ValueError, match="action must have shape"):
        envs.step(action[0])
    with pytest.raises(ValueError, match="render_mode must be None or one of rgb_array, got 'human'"):
        make(env_id, 2, render_mode="human", **arguments)
