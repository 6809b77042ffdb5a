"""The same seed gives the same trajectory, alone or among others."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest

RESTLESS = {"randomise": True, "noise": True, "kicks": True}


def rollout(env: gym.Env, seed: int | None, steps: int = 40) -> list[Any]:
    """Observations and rewards under a fixed sequence of actions, across episodes."""
    rng = np.random.default_rng(0)
    space = env.action_space
    assert isinstance(space, gym.spaces.Box)
    seen: list[Any] = [env.reset(seed=seed)[0]]
    for _ in range(steps):
        observation, reward, terminated, truncated, _ = env.step(rng.uniform(space.low, space.high).astype(np.float32))
        seen += [observation, reward]
        if terminated or truncated:
            seen.append(env.reset()[0])
    return seen


def equal(a: Any, b: Any) -> bool:
    if isinstance(a, dict):
        return all(np.array_equal(a[key], b[key]) for key in a)
    return np.array_equal(a, b)


def test_same_seed_same_trajectory(env_id, arguments):
    env = gym.make(env_id, **arguments)
    first, second = rollout(env, 7), rollout(gym.make(env_id, **arguments), 7)
    again = rollout(env, 7)
    assert len(first) == len(second) == len(again)
    assert all(equal(a, b) for a, b in zip(first, second, strict=True))
    assert all(equal(a, b) for a, b in zip(first, again, strict=True))


def test_other_seed_other_trajectory(env_id, arguments):
    env = gym.make(env_id, **arguments)
    assert not equal(env.reset(seed=1)[0], env.reset(seed=2)[0])


def test_next_episode_differs(env_id, arguments):
    env = gym.make(env_id, **arguments)
    assert not equal(env.reset(seed=1)[0], env.reset()[0])


@pytest.mark.parametrize("extra", [{}, RESTLESS])
def test_copy_of_a_batch_does_what_a_single_environment_does(extra):
    check_copy("Asimov-Walk-v0", extra, steps=250, scale=1.0)


def test_copy_of_a_trajectory_batch_does_what_a_single_environment_does():
    check_copy("Asimov-Trajectory-v0", {}, steps=100, scale=1.0)


def test_copy_of_a_velocity_batch_does_what_a_single_environment_does(policy):
    check_copy("Asimov-Velocity-v0", {"policy": policy, "episode_s": 0.5}, steps=12, scale=1.0)


def check_copy(env_id: str, arguments: dict[str, Any], steps: int, scale: float) -> None:
    """Copy 1 of a batch seeded with 5 against a single environment seeded with 6, over several episodes; this also
    compares the batch's final observations with those of an environment that does not reset by itself."""
    envs = gym.make_vec(env_id, num_envs=3, vectorization_mode="vector_entry_point", **arguments)
    env = gym.make(env_id, **arguments)
    rng = np.random.default_rng(3)
    space = envs.action_space
    assert isinstance(space, gym.spaces.Box)
    batch, batch_info = envs.reset(seed=5)
    alone, info = env.reset(seed=6)
    assert close(of_copy(batch), alone)
    assert close(of_copy(batch_info), info)
    episodes = 0
    for _ in range(steps):
        actions = rng.uniform(scale * space.low, scale * space.high).astype(np.float32)
        batch, rewards, terminations, truncations, batch_info = envs.step(actions)
        alone, reward, terminated, truncated, info = env.step(actions[1])
        assert rewards[1] == pytest.approx(reward, abs=1e-5)
        assert (terminations[1], truncations[1]) == (terminated, truncated)
        if terminated or truncated:
            episodes += 1
            assert close(batch_info["final_obs"][1], alone)
            assert close(of_copy(batch_info["final_info"]), info)
            alone, info = env.reset()
        assert close(of_copy(batch), alone)
        assert close(of_copy(batch_info), info)
    assert episodes >= 2, "the test is to see the start of later episodes too"


def of_copy(values: Any, copy: int = 1) -> Any:
    if isinstance(values, dict):
        return {key: of_copy(value, copy) for key, value in values.items()}
    return values[copy]


def close(batched: Any, single: Any) -> bool:
    """Every value of the single environment is in the batch too; the batch may hold more, such as masks."""
    if isinstance(single, dict):
        return all(batched.get(f"_{key}", True) for key in single) and all(
            close(batched[key], value) for key, value in single.items()
        )
    if isinstance(single, tuple):
        return batched == single
    return np.allclose(batched, single, atol=1e-5)
