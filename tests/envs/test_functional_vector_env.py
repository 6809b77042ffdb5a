"""`gym.make_vec(id, num_envs=N, physics="mjx")`."""

from __future__ import annotations

import importlib.util
from functools import cache
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import asimov_gym  # noqa: F401 - registers the environments

needs_jax = pytest.mark.skipif(
    importlib.util.find_spec("jax") is None or importlib.util.find_spec("mujoco.mjx") is None,
    reason="needs JAX and MJX: pip install 'asimov-gym[mjx]'",
)
N = 4


@cache
def functions() -> Any:
    """A functional environment on C physics: compiled in seconds, and once for all tests."""
    from asimov_gym.envs.functional import FunctionalWalk
    from asimov_gym.envs.walk import NORMALISED_ACTIONS
    from asimov_gym.tasks.walk import WalkConfig

    return FunctionalWalk(WalkConfig(episode_s=0.2, **NORMALISED_ACTIONS), "c", noise=False, kicks=False)


def on_c(**arguments: Any) -> Any:
    from asimov_gym.envs.functional.vector_env import FunctionalVectorEnv
    from asimov_gym.envs.walk import check_command

    options = {"command": lambda command: check_command("command", command, N)}
    return FunctionalVectorEnv(functions(), N, begin_options=options, **arguments)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"physics": "gpu"}, "physics must be one of c, mjx, warp, got 'gpu'"),
        ({"arrays": "device"}, "arrays must be 'numpy' with physics='c', got 'device'"),
        ({"physics": "mjx", "render_mode": "rgb_array"}, "render_mode must be None with physics='mjx'"),
    ],
)
def test_what_cannot_be_is_named(env_id: str, arguments: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        gym.make_vec(env_id, num_envs=2, **arguments)


def test_single_environments_run_on_c_only(env_id: str) -> None:
    with pytest.raises(ValueError, match=r"physics must be 'c' here, got 'mjx'.*gym\.make_vec"):
        gym.make(env_id, physics="mjx")


def test_c_stays_the_default(env_id: str, arguments: dict[str, Any]) -> None:
    envs = gym.make_vec(env_id, num_envs=2, physics="c", **arguments)
    observation, _ = envs.reset(seed=0)
    plain, _ = gym.make_vec(env_id, num_envs=2, **arguments).reset(seed=0)
    as_dict = observation if isinstance(observation, dict) else {"": observation}
    for name, value in as_dict.items():
        np.testing.assert_array_equal(value, plain[name] if name else plain)
    envs.close()


@needs_jax
def test_episodes_end_and_follow_each_other() -> None:
    envs = on_c()
    assert envs.metadata["autoreset_mode"] is gym.vector.AutoresetMode.SAME_STEP
    first, info = envs.reset(seed=3)
    assert envs.observation_space.contains(first) and info["privileged"].shape == (N, 96)
    for k in range(1, 11):
        last, reward, terminated, truncated, info = envs.step(envs.action_space.sample())
        assert envs.observation_space.contains(last) and reward.dtype == np.float32
        assert truncated.all() == (k == 10) and not terminated.any()
    assert info["_final_obs"].all() and info["final_obs"][0].shape == (80,)
    assert not np.array_equal(info["final_obs"][0], last[0])
    assert info["final_info"]["_reward_terms"].all() and not info["_reward_terms"].any()
    assert last.flags.writeable
    again, _ = envs.reset(seed=3)
    np.testing.assert_array_equal(again, first)
    one, _ = envs.reset(seed=[5, 4, 3, 2])
    np.testing.assert_array_equal(one[2], first[0])


@needs_jax
def test_options_and_actions_are_checked() -> None:
    envs = on_c()
    with pytest.raises(gym.error.ResetNeeded):
        envs.step(np.zeros((N, 23), dtype=np.float32))
    _, info = envs.reset(seed=0, options={"command": (0.3, 0.0, 0.1)})
    np.testing.assert_allclose(info["command"], np.tile([0.3, 0.0, 0.1], (N, 1)), rtol=1e-6)
    with pytest.raises(ValueError, match=r"reset options \['speed'\] are unknown; known options: command"):
        envs.reset(options={"speed": 1.0})
    with pytest.raises(ValueError, match="command vx must lie in"):
        envs.reset(options={"command": (9.0, 0.0, 0.0)})
    with pytest.raises(ValueError, match=r"action must have shape \(4, 23\), got \(3, 23\)"):
        envs.step(np.zeros((3, 23)))
    bad = np.zeros((N, 23))
    bad[1, 2] = np.nan
    with pytest.raises(ValueError, match=r"action\[1, 2\] must be a finite number"):
        envs.step(bad)
    with pytest.raises(ValueError, match="arrays must be one of numpy, device, got 'torch'"):
        on_c(arrays="torch")


@needs_jax
def test_arrays_can_stay_on_the_device() -> None:
    torch = pytest.importorskip("torch", reason="needs torch, to which the arrays are handed")
    numpy, device = on_c(), on_c(arrays="device")
    seen, wanted = device.reset(seed=1)[0], numpy.reset(seed=1)[0]
    np.testing.assert_array_equal(torch.from_dlpack(seen).numpy(), wanted)
    for k in range(12):
        action = np.random.default_rng(k).uniform(-1.0, 1.0, (N, 23)).astype(np.float32)
        seen, wanted = device.step(torch.from_numpy(action)), numpy.step(action)
        for part, other in zip(seen[:4], wanted[:4], strict=True):
            np.testing.assert_array_equal(np.asarray(part), other)
        if wanted[4].get("_final_obs") is not None:
            np.testing.assert_array_equal(seen[4]["_final_obs"], wanted[4]["_final_obs"])
            np.testing.assert_array_equal(seen[4]["final_obs"], np.stack(wanted[4]["final_obs"]))
    # What is not finite is no error here, but the end of that copy's episode.
    action[2] = np.nan
    _, _, terminated, _, info = device.step(action)
    assert terminated.tolist() == [False, False, True, False] and info["diverged"].tolist() == terminated.tolist()


@needs_jax
@pytest.mark.slow
def test_every_task_runs_on_mjx(env_id: str) -> None:
    envs = gym.make_vec(env_id, num_envs=N, physics="mjx")
    envs.reset(seed=0)
    rng = np.random.default_rng(0)
    space = envs.single_action_space
    assert isinstance(space, gym.spaces.Box)
    for _ in range(5):
        action = rng.uniform(space.low, space.high, envs.action_space.shape).astype(np.float32)
        observation, reward, _, _, info = envs.step(action)
        assert envs.observation_space.contains(observation) and np.isfinite(reward).all()
    assert not info["diverged"].any()
    envs.close()


@needs_jax
@pytest.mark.parametrize("function", ["compiled_reset", "compiled_step"])
def test_a_batch_that_does_not_fit_says_so(function: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*arguments: Any) -> Any:
        raise RuntimeError("RESOURCE_EXHAUSTED: Out of memory allocating 68719476736 bytes.")

    envs = on_c()
    if function == "compiled_step":
        envs.reset(seed=0)
    monkeypatch.setattr(functions(), function, full)
    with pytest.raises(MemoryError, match="4 robots do not fit into memory, use fewer"):
        envs.reset(seed=0) if function == "compiled_reset" else envs.step(np.zeros((N, 23), np.float32))
