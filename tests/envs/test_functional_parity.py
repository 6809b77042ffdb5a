"""The functional environments are the Gymnasium ones: on the same state, action and random numbers they give the same
observation, reward and end of an episode. What a rollout drew is enough to repeat it on another engine."""

from __future__ import annotations

import importlib.util
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

if importlib.util.find_spec("jax") is None or importlib.util.find_spec("mujoco.mjx") is None:
    pytest.skip("needs JAX and MJX: pip install 'asimov-gym[mjx]'", allow_module_level=True)

from asimov_gym.assets import asset_path
from asimov_gym.envs.functional import FunctionalTrajectory, FunctionalVelocity, FunctionalWalk
from asimov_gym.envs.functional.walk import batch_snapshot
from asimov_gym.envs.trajectory_batch import TrajectoryBatch
from asimov_gym.envs.velocity_batch import VelocityBatch
from asimov_gym.envs.walk_batch import WalkBatch
from asimov_gym.physics import PhysicsProfile, Reading
from asimov_gym.physics.functional import CEngine, Engine, MjxEngine
from asimov_gym.policy import PolicyState, load_policy
from asimov_gym.policy.network import read_network
from asimov_gym.tasks.trajectory import TrajectoryConfig
from asimov_gym.tasks.velocity import VelocityConfig
from asimov_gym.tasks.walk import WalkConfig
from asimov_gym.tasks.walk.config import ShoveConfig

# isort: split
import jax
import jax.numpy as jnp

N = 8
CONVERGED = PhysicsProfile(
    "converged", False, 1.0, 0, iterations=50, ls_iterations=50, bodies_collide=False, dry_friction=False
)
SHORT = WalkConfig(episode_s=0.4)
"""Episodes that end, and commands and kicks that change, within a test."""


@pytest.fixture
def walking_policy() -> Any:
    return asset_path("policies", "asimov_walk.onnx")


def keys(seed: int = 0, n: int = N) -> jax.Array:
    return jax.random.split(jax.random.PRNGKey(seed), n)


def close(seen: Any, wanted: Any, name: str, atol: float = 1e-5) -> None:
    np.testing.assert_allclose(np.asarray(seen), np.asarray(wanted), atol=atol, rtol=1e-5, err_msg=name)


def arrays(state: Any) -> dict[str, np.ndarray]:
    """Fields of a task's state as NumPy arrays in NumPy's own types."""
    values = {f.name: np.array(getattr(state, f.name)) for f in fields(state)}
    return {n: v.astype(np.int64 if v.dtype.kind == "i" else np.float64) for n, v in values.items()}


def walk_config() -> WalkConfig:
    short = SHORT
    return replace(
        short,
        command=replace(short.command, interval_s=(0.06, 0.2), corner_share=0.3),
        kick=replace(short.kick, interval_s=(0.06, 0.2)),
        shove=ShoveConfig(
            interval_s=(0.04, 0.1),
            pace_at_rest=2,
            duration_s=(0.04, 0.1),
            horizontal={"pelvis_link": 200.0},
            downward={"left_shoulder_pitch_link": 300.0},
        ),
        randomisation=replace(short.randomisation, redraw_share=0.5),
    )


@pytest.mark.parametrize("terrain", ["flat", "rough:0.03"])
def test_numpy_repeats_what_jax_recorded(terrain: str) -> None:
    """A walk on JAX and C physics, step for step again on NumPy and C physics with the recorded random numbers: bodies,
    delays, kicks, shoves, commands, noise, the curriculum and the starts of new episodes. On terrain also the places of
    these starts, and joints that are read late."""
    config = walk_config()
    if terrain != "flat":
        config = replace(config, terrain=terrain, noise=replace(config.noise, can_slot_delay=True))
    engine = CEngine(CONVERGED, terrain=terrain, trail=0 if terrain == "flat" else 2)
    env = FunctionalWalk(config, engine, curriculum=True, stagger=True)
    batch = WalkBatch(config, N, CONVERGED, curriculum=True, autoreset=True)
    step, draws = jax.jit(env.step), jax.jit(env.draws)
    state = jax.jit(env.reset)(keys())
    rng, ended = np.random.default_rng(0), 0
    for _ in range(40):
        action = rng.normal(0.0, 1.0, (N, 23)).astype(np.float32)
        batch.restore(dict(batch_snapshot(env, state.pipeline_state)))
        wanted = batch.step(action, jax.tree.map(np.asarray, draws(state)))
        batch.advance_curriculum()
        state = step(state, jnp.asarray(action))
        ended += int(state.done.sum())
        close(state.info["final_obs"]["state"], wanted.final_observation, "final observation")
        close(state.obs["state"], wanted.observation, "observation")
        close(state.obs["privileged_state"], wanted.privileged, "privileged", atol=2e-4)  # it has contact forces
        close(state.reward, wanted.reward, "reward")
        np.testing.assert_array_equal(state.info["terminated"], wanted.terminated)
        np.testing.assert_array_equal(state.info["truncated"], wanted.truncated)
        for name, value in vars(batch.curriculum.levels).items():
            close(getattr(state.pipeline_state.levels, name), np.full(N, value), name)
        for name, value in vars(batch.body).items():
            close(getattr(state.pipeline_state.body, name), value, name)
        assert int(state.info["report"]["clipped"].sum()) == wanted.clipped
    assert ended >= 2 * N
    batch.close()


def on_numpy(reading: Reading) -> Reading:
    return reading.__class__(**{name: np.array(value, dtype=np.float64) for name, value in vars(reading).items()})


def test_trajectory_equals_the_gymnasium_environment() -> None:
    config = TrajectoryConfig(motion="arm_wiggle", gains=True, episode_s=0.5)
    env = FunctionalTrajectory(config, CEngine(CONVERGED), autoreset=False)
    batch = TrajectoryBatch(N, config, CONVERGED)
    step, state = jax.jit(env.step), jax.jit(env.reset)(keys())
    rng = np.random.default_rng(0)
    low, high = batch.action_space.low, batch.action_space.high
    reference = env.gym_observation(np.asarray(state.obs["state"]))["reference"]
    for _ in range(30):
        action = rng.uniform(low, high, (N, 75)).astype(np.float32)
        action[:, :25] = reference[:, 1] + 0.2 * (action[:, :25] - reference[:, 1])
        batch.physics.set_state(env.engine.physics_state(state.pipeline_state.simulation))
        batch.state = batch.state.__class__(**arrays(state.pipeline_state.task))
        wanted = batch.step(action)
        state = step(state, jnp.asarray(action))
        seen = env.gym_observation(np.asarray(state.obs["state"]))
        reference = seen["reference"]
        assert set(seen) == set(wanted.observation)
        for name, value in wanted.observation.items():
            loose = {"joint_current": 1e-3, "joint_vel": 1e-3}.get(name, 2e-5)
            assert seen[name].shape == value.shape and seen[name].dtype == value.dtype, name
            close(seen[name], value, name, atol=loose)
        close(state.reward, wanted.reward, "reward")
        np.testing.assert_array_equal(state.info["terminated"], wanted.terminated)
        np.testing.assert_array_equal(state.info["truncated"], wanted.truncated)
        np.testing.assert_array_equal(state.info["report"]["clipped"], wanted.info["clipped"])
    assert state.info["truncated"].any() and not state.done.all()
    batch.close()


def test_velocity_equals_the_gymnasium_environment(walking_policy: Any) -> None:
    config = VelocityConfig(episode_s=2.0, distance=(0.3, 0.4))
    env = FunctionalVelocity(config, walking_policy, CEngine(CONVERGED), autoreset=False)
    batch = VelocityBatch(N, config, walking_policy, CONVERGED)
    step, state = jax.jit(env.step), jax.jit(env.reset)(keys())
    rng, reached = np.random.default_rng(0), 0
    for _ in range(20):
        action = rng.uniform([-0.5, -0.5, -2.5], [2.5, 0.5, 2.5], (N, 3)).astype(np.float32)
        world = state.pipeline_state
        batch.physics.set_state(env.engine.physics_state(world.simulation))
        batch.reading = batch.physics.read()
        batch.state = batch.state.__class__(**arrays(world.task))
        batch._driver.state = PolicyState(**arrays(world.policy))
        wanted = batch.step(action)
        state = step(state, jnp.asarray(action))
        # Five steps of network and physics lie between: contacts magnify the rounding of the joint velocities.
        close(state.obs["state"], wanted.observation, "observation", atol=2e-4)
        close(state.reward, wanted.reward, "reward", atol=1e-5)
        np.testing.assert_array_equal(state.info["terminated"], wanted.terminated)
        np.testing.assert_array_equal(state.info["truncated"], wanted.truncated)
        for name in ("clipped", "success", "applied_command"):
            close(state.info["report"][name], wanted.info[name], name)
        for name in ("waypoints_reached", "distance"):
            close(state.info["now"][name], wanted.info[name], name)
        reached = int(state.info["now"]["waypoints_reached"].sum())
    assert reached > 0 and state.info["truncated"].any()
    batch.close()


def test_network_in_the_graph_equals_the_runner(walking_policy: Any) -> None:
    runner, network = load_policy(walking_policy), read_network(walking_policy)
    assert network.contract == runner.contract
    observation = np.random.default_rng(0).normal(0.0, 1.0, (1000, 80)).astype(np.float32)
    wanted = runner.infer(observation)
    close(jax.jit(network.infer)(observation), wanted, "on JAX")
    close(network.infer(observation), wanted, "on NumPy")


def same_tape(engine: Engine, steps: int) -> list[Any]:
    """States of a walk without noise from the same start under the same actions."""
    config = replace(WalkConfig(), action_scale=0.25)
    env = FunctionalWalk(config, engine, noise=False, command=np.array([0.3, 0.0, 0.0]))
    step, state = jax.jit(env.step), jax.jit(env.reset)(keys(5))
    recorded = [state]
    rng = np.random.default_rng(1)
    phase = rng.uniform(0.0, 2.0 * np.pi, (N, 23))
    for k in range(steps):
        action = 0.4 * np.sin(2.0 * np.pi * 0.02 * k + phase) * min(1.0, k / 25)
        state = step(state, jnp.asarray(action, dtype=jnp.float32))
        recorded.append(state)
    return recorded


@pytest.mark.slow
def test_mjx_walks_like_c() -> None:
    """One task, two engines, the same keys: the same bodies, starts and kicks, and nearly the same path. A robot that
    lands or slips magnifies what little the engines differ, so most copies must agree, not each."""
    on_c, on_mjx = same_tape(CEngine(CONVERGED), 50), same_tape(MjxEngine(CONVERGED), 50)
    jax.tree.map(np.testing.assert_array_equal, on_c[0].pipeline_state.body, on_mjx[0].pipeline_state.body)
    apart = [
        np.abs(a.pipeline_state.simulation.qpos - b.pipeline_state.simulation.qpos).max(axis=1)
        for a, b in zip(on_c, on_mjx, strict=True)
    ]
    assert apart[1].max() < 1e-4
    assert np.median(apart[50]) < 5e-3
    reward = [np.abs(a.reward - b.reward).max() for a, b in zip(on_c, on_mjx, strict=True)]
    assert reward[1] < 1e-4 and np.median(reward) < 2e-3


@pytest.mark.slow
def test_mjx_states_mean_the_same_to_numpy() -> None:
    """Observation, reward and termination of MJX's states, by the task's functions on NumPy."""
    env = FunctionalWalk(walk_config(), MjxEngine(), autoreset=False, noise=True)
    step, draws, read = jax.jit(env.step), jax.jit(env.draws), jax.jit(env.engine.read)
    state, rng = jax.jit(env.reset)(keys()), np.random.default_rng(0)
    for _ in range(25):
        action = rng.normal(0.0, 1.0, (N, 23)).astype(np.float32)
        given, before = jax.tree.map(np.asarray, draws(state)), state.pipeline_state
        state = step(state, jnp.asarray(action))
        after = state.pipeline_state
        reading = on_numpy(read(after.simulation))
        task_state = before.task.__class__(**arrays(before.task))
        task_state = env.task.push_action(task_state, env.task.clip_action(action.astype(np.float64)))
        task_state, _ = env.task.kick(task_state, given["kick"].astype(np.float64), 1.0)
        diverged = np.asarray(state.info["diverged"])
        wanted = env.task.conclude(task_state, reading, diverged, given["command"].astype(np.float64))
        body = before.body.__class__(**arrays(before.body))
        close(state.obs["state"], env.task.observe(wanted.state, reading, given["sensors"]), "observation")
        close(state.obs["privileged_state"], env.task.privilege(wanted.state, reading, body), "privileged")
        close(state.reward, wanted.reward, "reward")
        np.testing.assert_array_equal(state.info["terminated"], wanted.terminated)
        np.testing.assert_array_equal(state.info["truncated"], wanted.truncated)
