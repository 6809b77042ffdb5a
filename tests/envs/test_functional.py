"""The functional environments as learners use them: keys, batches, restarts, broken simulations, Brax's wrappers."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

if importlib.util.find_spec("jax") is None or importlib.util.find_spec("mujoco.mjx") is None:
    pytest.skip("needs JAX and MJX: pip install 'asimov-gym[mjx]'", allow_module_level=True)

from asimov_gym.envs.functional import EnvState, FunctionalTrajectory, FunctionalWalk, enable_compile_cache
from asimov_gym.envs.functional.dump import read_dump
from asimov_gym.physics import JointTarget
from asimov_gym.physics.functional import CEngine
from asimov_gym.robot.joints import STAND_POSITION
from asimov_gym.tasks.walk import WalkConfig
from asimov_gym.tasks.walk.config import CurriculumConfig

# isort: split
import jax
import jax.numpy as jnp

N = 6
SHORT = WalkConfig(
    episode_s=0.2,  # ten steps
    curriculum=CurriculumConfig(long_episode_steps=1.0, penalty_growth=1.0, kick_growth=0.1),
)
FIXED = (0.4, 0.1, -0.2)
"""Command of the first copy; the others draw theirs."""


@pytest.fixture(scope="module")
def engine() -> CEngine:
    return CEngine()


@pytest.fixture(scope="module")
def dump_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("dumps")


@pytest.fixture(scope="module")
def walk(engine: CEngine, dump_dir: Path) -> FunctionalWalk:
    """One environment with all that the tests ask of one: compiling takes seconds."""
    command = np.full((N, 3), np.nan, dtype=np.float32)
    command[0] = FIXED
    return FunctionalWalk(SHORT, engine, curriculum=True, command=command, dump_dir=dump_dir)


@pytest.fixture(scope="module")
def reset(walk: FunctionalWalk) -> Callable[..., EnvState]:
    return walk.compiled_reset


@pytest.fixture(scope="module")
def step(walk: FunctionalWalk) -> Callable[..., EnvState]:
    return walk.compiled_step


def keys(seed: int = 0, n: int = N) -> jax.Array:
    return jax.random.split(jax.random.PRNGKey(seed), n)


def assert_equal(a: Any, b: Any) -> None:
    jax.tree.map(np.testing.assert_array_equal, a, b)


def test_sizes_are_those_of_the_spaces(walk, reset):
    state = reset(keys())
    assert walk.observation_size == {"state": (80,), "privileged_state": (96,)} and walk.action_size == 23
    assert {name: value.shape for name, value in state.obs.items()} == {"state": (N, 80), "privileged_state": (N, 96)}
    assert walk.observation_space.contains(np.asarray(state.obs["state"][0]))
    assert all(leaf.shape[0] == N for leaf in jax.tree.leaves(state))
    assert all(value.dtype == jnp.float32 for value in (*state.obs.values(), state.reward, state.done))


def test_a_state_keeps_its_structure(walk, reset, step):
    before = reset(keys())
    after = step(before, jnp.zeros((N, 23)))
    assert jax.tree.structure(before) == jax.tree.structure(after)
    assert [(a.shape, a.dtype) for a in jax.tree.leaves(before)] == [(a.shape, a.dtype) for a in jax.tree.leaves(after)]


def test_same_keys_same_path_and_copies_do_not_touch_each_other(reset, step):
    def path(key: jax.Array) -> list[EnvState]:
        states = [reset(key)]
        for k in range(25):
            states.append(step(states[-1], 0.3 * jnp.sin(jnp.arange(23.0) + k) * jnp.ones((N, 1))))
        return states

    first, again = path(keys()), path(keys())
    assert_equal(first, again)
    other = path(keys().at[0].set(keys(9)[0]))
    for a, b in zip(first, other, strict=True):
        np.testing.assert_array_equal(a.obs["state"][1:], b.obs["state"][1:])
        assert not np.array_equal(a.obs["state"][0], b.obs["state"][0])


def test_an_ended_episode_is_followed_by_the_next(reset, step):
    state = reset(keys())
    for k in range(1, 11):
        state = step(state, jnp.zeros((N, 23)))
        if k < 10:
            assert not state.done.any() and (state.info["steps"] == k).all()
            assert_equal(state.obs, state.info["final_obs"])
    assert state.done.all() and state.info["truncated"].all() and (state.info["truncation"] == 1.0).all()
    world = state.pipeline_state
    assert (world.task.step == 0).all() and (world.simulation.time == 0.0).all()
    assert not np.array_equal(state.obs["state"], state.info["final_obs"]["state"])
    after = step(state, jnp.zeros((N, 23)))
    assert not after.done.any() and (after.info["steps"] == 1.0).all()


@pytest.mark.slow
def test_without_autoreset_nothing_starts_anew(engine):
    env = FunctionalWalk(SHORT, engine, autoreset=False)
    state, step = jax.jit(env.reset)(keys()), jax.jit(env.step)
    for _ in range(12):
        state = step(state, jnp.zeros((N, 23)))
    assert state.info["truncated"].all() and not state.done.any() and (state.pipeline_state.task.step == 12).all()


def test_bodies_differ_and_some_stay_over_restarts(reset, step):
    first = state = reset(keys(3))
    for _ in range(10):
        state = step(state, jnp.zeros((N, 23)))
    before, after = first.pipeline_state.body.kp_scale, state.pipeline_state.body.kp_scale
    same = np.all(np.asarray(before == after), axis=1)
    assert 0 < same.sum() < N, same  # redraw_share is a quarter
    assert len(np.unique(np.asarray(after)[:, 0])) == N


@pytest.mark.slow
def test_single_environments_under_vmap_are_the_batch(engine):
    env = FunctionalWalk(SHORT, engine)
    one = jax.jit(env.reset)(keys()[0])
    assert one.obs["state"].shape == (80,) and one.reward.shape == () and one.done.shape == ()
    mapped = jax.jit(jax.vmap(env.step))(jax.jit(jax.vmap(env.reset))(keys()), jnp.zeros((N, 23)))
    batch = jax.jit(env.step)(jax.jit(env.reset)(keys()), jnp.zeros((N, 23)))
    np.testing.assert_allclose(mapped.obs["state"], batch.obs["state"], atol=1e-5)
    typed = jax.jit(env.reset)(jax.random.wrap_key_data(keys()))
    np.testing.assert_array_equal(typed.obs["state"][0], one.obs["state"])


def test_first_episodes_can_be_staggered(engine):
    env = FunctionalWalk(WalkConfig(), engine, stagger=True)
    steps = jax.jit(env.reset)(keys(n=64)).pipeline_state.task.step
    assert steps.min() < 200 and steps.max() > 800 and (steps < env.task.episode_steps).all()


def test_curriculum_begins_low_and_grows_while_episodes_last(reset, step):
    state = reset(keys())
    levels = [state.pipeline_state.levels]
    for _ in range(20):
        state = step(state, jnp.zeros((N, 23)))
        levels.append(state.pipeline_state.levels)
    first = SHORT.curriculum.start
    assert (levels[0].penalty == first).all() and (levels[9].penalty == first).all()
    assert (levels[20].penalty == 1.0).all() and (levels[20].kick > 0.5).all()
    assert np.allclose(levels[10].mean_length, 10.0)


def test_a_broken_copy_is_restarted_counted_and_dumped(walk, reset, step, dump_dir):
    state = reset(keys())
    simulation = state.pipeline_state.simulation
    fast = replace(simulation, qvel=simulation.qvel.at[2, 0].set(1e6))
    state = state.replace(pipeline_state=replace(state.pipeline_state, simulation=fast))
    action = jnp.zeros((N, 23)).at[4, 7].set(jnp.nan)
    after = step(state, action)
    jax.effects_barrier()
    assert after.info["diverged"].tolist() == [False, False, True, False, True, False]
    assert after.done.tolist() == [0, 0, 1, 0, 1, 0] and (after.reward[jnp.array([2, 4])] == 0.0).all()
    assert after.metrics["diverged"].tolist() == after.done.tolist()
    for leaf in jax.tree.leaves((after.obs, after.reward, after.info["final_obs"], after.pipeline_state)):
        assert np.isfinite(leaf).all()
    (file,) = dump_dir.glob("diverged_*.npz")
    world, actions, draws = read_dump(walk, file)
    assert world.simulation.qvel[0, 0] == 1e6 and np.isnan(actions[1, 7])
    target = JointTarget(jnp.asarray(np.tile(STAND_POSITION, (2, 1)), dtype=jnp.float32))
    _, repeated = walk.engine.step(jax.tree.map(jnp.asarray, world.simulation), target, 4)
    assert repeated.tolist() == [True, False] and draws["kick"].shape == (2, 7)
    with pytest.raises(ValueError, match=r"it lacks world\.task"):
        read_dump(FunctionalTrajectory(physics=walk.engine), file)


def test_a_fixed_command_stays(reset, step):
    state = reset(keys())
    for _ in range(12):
        state = step(state, jnp.zeros((N, 23)))
        np.testing.assert_allclose(state.info["now"]["command"][0], FIXED)
    assert np.isfinite(state.info["now"]["command"]).all()


def test_compile_cache_goes_where_it_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    before = jax.config.values["jax_compilation_cache_dir"]
    try:
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
        assert enable_compile_cache() == tmp_path / "asimov-gym" / "xla"
        assert jax.config.values["jax_compilation_cache_dir"] == str(tmp_path / "asimov-gym" / "xla")
    finally:
        jax.config.update("jax_compilation_cache_dir", before)


@pytest.mark.slow
def test_brax_wrappers_take_it(engine):
    training = pytest.importorskip("brax.envs.wrappers.training", reason="needs brax, whose wrappers it is for")
    env = FunctionalWalk(WalkConfig(), engine, autoreset=False)
    wrapped = training.EvalWrapper(training.wrap(env, episode_length=5))
    state, step = jax.jit(wrapped.reset)(keys()), jax.jit(wrapped.step)
    first = state.obs["state"]
    for k in range(1, 6):
        state = step(state, jnp.zeros((N, 23)))
        assert (state.done == (k == 5)).all()
    assert (state.info["truncation"] == 1.0).all()
    np.testing.assert_array_equal(state.obs["state"], first)  # Brax goes back to the first state
    assert (state.info["eval_metrics"].episode_steps == 5).all()
    alive = 5 * env.config.rewards["alive"]
    np.testing.assert_allclose(state.info["eval_metrics"].episode_metrics["reward/alive"], alive)


@pytest.mark.slow
def test_brax_collects_from_the_batch_itself(walk, reset):
    acting = pytest.importorskip("brax.training.acting", reason="needs brax, whose learners collect like this")

    def policy(obs: Any, key: Any) -> tuple[jax.Array, dict[str, Any]]:
        return jnp.zeros((*obs["state"].shape[:-1], 23)), {}

    fields = ("truncation", "time_out", "episode_metrics", "episode_done")
    collect = jax.jit(lambda s, k: acting.generate_unroll(walk, s, policy, k, 12, extra_fields=fields))
    _, data = collect(reset(keys()), jax.random.PRNGKey(0))
    assert data.observation["privileged_state"].shape == (12, N, 96)
    assert data.extras["state_extras"]["truncation"].sum() == N  # each copy once in twelve steps of ten
    extras = data.extras["state_extras"]
    assert (extras["episode_metrics"]["length"][9] == 10.0).all() and (extras["episode_done"][9] == 1.0).all()
    np.testing.assert_allclose(extras["episode_metrics"]["sum_reward"][9], data.reward[:10].sum(axis=0), rtol=1e-5)
    assert (data.discount[9] == 0.0).all() and jnp.isfinite(data.reward).all()
