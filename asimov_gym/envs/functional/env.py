"""What the functional environments share: random numbers, restarts, and the guard against broken simulations."""

from __future__ import annotations

import abc
import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import jax
import jax.numpy as jnp

from asimov_gym.envs.functional.dump import DivergenceDump
from asimov_gym.envs.functional.state import EnvState
from asimov_gym.physics.functional import Engine, make_engine
from asimov_gym.physics.functional.engine import choose
from asimov_gym.physics.profile import PhysicsProfile
from asimov_gym.robot.terrain import FLAT, Terrain
from asimov_gym.tasks.outcome import Outcome

Draws = Mapping[str, Any]
"""Uniform numbers in [0, 1) by what they are for, (N, width) each."""


@dataclass(frozen=True)
class Advance:
    """What an environment's own part of a step gives."""

    world: Any
    """After the step, before any copy starts anew."""
    outcome: Outcome
    diverged: Any
    """Copies whose simulation broke down, (N,) bool."""
    report: dict[str, Any]
    """What to tell of the step, by name."""


class FunctionalEnv(abc.ABC):
    """N robots at a task as pure functions. It has the attributes of a `brax.envs.Env`.

    `reset` takes a key for each copy, (N, 2), and everything random of a copy follows from its own key; one key alone
    gives one environment without a batch axis, which `jax.vmap` and Brax's wrappers then batch. Either way all copies
    are stepped in one call of the physics.

    With `autoreset` an episode that ends is followed by the next one in the same step: `state.obs` is already the new
    episode's. Without it nothing starts anew: `done` marks the end of an episode but not that time is up, which the
    caller's wrappers (such as Brax's) are to count.

    `state.info` holds, for each copy: `key`; `terminated`, `truncated`, `diverged` (bool) of the last step; `now` (the
    task's figures), and `report` (of the last step: reward terms and counts). With `autoreset` also `final_obs` and
    `final` (the observation and the figures before the restart), `steps` of the episode, and for Brax's learners
    `truncation` and `time_out` (1 where time was up), `episode_done` and `episode_metrics` (sums over the episode);
    those need no wrapper then: `wrap_env_fn=lambda env, **_: env`.

    A copy whose simulation breaks down or whose action is not finite ends its episode without reward, and is counted in
    `metrics["diverged"]`; with `dump_dir` everything needed to repeat its step is written to a file.

    Args:
        physics: `c`, `mjx`, `warp`, or an engine.
        profile: physics profile of a named engine.
        threads: size of the thread pool of C physics.
        autoreset: whether episodes follow each other.
        dump_dir: where the state of diverged copies is written; nothing is when None.
        terrain: the ground; an engine must have been made with the same.
        trail: how many earlier moments of the joints the engine has to remember.
    """

    step_draws: Mapping[str, int]
    """Uniform numbers per copy that a step needs, by what they are for."""
    start_draws: Mapping[str, int]
    """Uniform numbers per copy that the start of an episode needs."""
    observation_space: gym.Space[Any]
    """Of one copy, as in the Gymnasium environment."""
    action_space: gym.spaces.Box
    dt: float
    """Time between two steps, s."""
    copies: int | None = None
    """Size of the batch, where the environment was made for one size."""

    def __init__(
        self,
        physics: str | Engine,
        profile: str | PhysicsProfile,
        threads: int | None,
        autoreset: bool,
        dump_dir: Path | None,
        terrain: Terrain = FLAT,
        trail: int = 0,
    ) -> None:
        if isinstance(physics, str):
            physics = make_engine(physics, profile, threads, terrain, trail)
        if physics.terrain != terrain:
            raise ValueError(
                f"physics is an engine on terrain {physics.terrain.name!r}, the task needs {terrain.name!r}"
            )
        if physics.trail < trail:
            raise ValueError(f"physics is an engine with trail={physics.trail}, the task needs trail={trail}")
        self.engine = physics
        self.autoreset = autoreset
        self._dump = None if dump_dir is None else DivergenceDump(dump_dir)

    # -- each environment's own part -----------------------------------------------------------------------------------

    @abc.abstractmethod
    def begin(self, draws: Draws, before: Any | None) -> Any:
        """The world at the start of an episode of every copy; `before` is the one of the last episode, if any."""

    @abc.abstractmethod
    def advance(self, world: Any, action: Any, draws: Draws) -> Advance:
        """A step of every copy; `action` is finite."""

    @abc.abstractmethod
    def observe(self, world: Any, draws: Draws) -> dict[str, Any]:
        """`state` and `privileged_state`, (N, n) float32 each."""

    @abc.abstractmethod
    def figures(self, world: Any) -> dict[str, Any]:
        """What a learner may want to know of the world, by name, (N, ...) each."""

    @abc.abstractmethod
    def blank_report(self, copies: int) -> dict[str, Any]:
        """A report before the first step."""

    def gym_observation(self, state: Any) -> Any:
        """The Gymnasium environment's observation, from the actor's (N, n)."""
        return state

    # -- functions for learners ----------------------------------------------------------------------------------------

    def reset(self, key: jax.Array, start: Mapping[str, Any] | None = None) -> EnvState:
        """First state.

        Args:
            key: of `jax.random`: one for each copy, (N, 2) or (N,) of a key type; or a single one.
            start: arguments of the environment's `begin`, beside those listed here.
        """
        if jnp.issubdtype(key.dtype, jax.dtypes.prng_key):
            key = jax.random.key_data(key)
        if key.ndim == 1:
            return jax.tree.map(lambda a: a[0], self.reset(key[None], start))
        for_step, for_start, later = _split(key)
        draws = {**_draw(for_step, self.step_draws), **_draw(for_start, self.start_draws)}
        world = self.begin(draws, None, **(start or {}))
        obs, figures, n = self.observe(world, draws), self.figures(world), key.shape[0]
        no, zero = jnp.zeros(n, dtype=bool), jnp.zeros(n, dtype=jnp.float32)
        report = self.blank_report(n)
        info = {"key": later, "terminated": no, "truncated": no, "diverged": no, "now": figures, "report": report}
        if self.autoreset:
            info |= {"final_obs": obs, "final": figures, "steps": zero, "truncation": zero, "time_out": zero}
            sums = {"sum_reward": zero, "length": zero, **jax.tree.map(jnp.zeros_like, self._metrics(report, no))}
            info |= {"episode_metrics": sums, "episode_done": zero}
        return EnvState(world, obs, zero, zero, self._metrics(report, no), info)

    def step(self, state: EnvState, action: jax.Array, draws: Draws | None = None) -> EnvState:
        """State after a step.

        Args:
            state: before.
            action: (N, m); finite entries out of bounds are clipped.
            draws: uniform numbers to use instead of those that follow from the key: see `draws`.
        """
        if state.reward.ndim == 0:
            add = jax.tree.map(lambda a: a[None], (state, action, draws))
            return jax.tree.map(lambda a: a[0], self.step(*add))
        for_step, for_start, later = _split(state.info["key"])
        step_draws = _draw(for_step, self.step_draws) if draws is None else draws
        before = state.pipeline_state
        broken = ~jnp.all(jnp.isfinite(action), axis=-1)
        given = jnp.where(broken[:, None], 0.0, action)
        advance = self.advance(before, given, step_draws)
        outcome, world = advance.outcome, advance.world
        terminated, truncated = outcome.terminated | broken, outcome.truncated & ~broken
        diverged = advance.diverged | broken
        reward = jnp.where(diverged, 0.0, outcome.reward).astype(jnp.float32)
        if self._dump is not None:
            self._dump.watch(before, action, step_draws, diverged)
        obs, figures = self.observe(world, step_draws), self.figures(world)
        info = {**state.info, "key": later, "terminated": terminated, "truncated": truncated, "diverged": diverged}
        info |= {"now": figures, "report": advance.report}
        done, metrics = terminated, self._metrics(advance.report, diverged)
        if self.autoreset:
            done = terminated | truncated
            info |= {"final_obs": obs, "final": figures, "steps": jnp.where(state.done > 0, 0.0, info["steps"]) + 1.0}
            info["truncation"] = info["time_out"] = truncated.astype(jnp.float32)
            added = {"sum_reward": reward, "length": jnp.ones_like(reward), **metrics}
            sums = jax.tree.map(lambda a, b: jnp.where(state.done > 0, 0.0, a) + b, info["episode_metrics"], added)
            info |= {"episode_metrics": sums, "episode_done": done.astype(jnp.float32)}

            def restarted() -> Any:
                start_draws = _draw(for_start, self.start_draws) if draws is None else draws
                fresh = choose(done, self.begin(start_draws, world), world)
                return fresh, self.observe(fresh, step_draws), self.figures(fresh)

            # A real branch: without an end in the batch nothing of a restart is computed.
            world, obs, info["now"] = jax.lax.cond(jnp.any(done), restarted, lambda: (world, obs, figures))
        return EnvState(world, obs, reward, done.astype(jnp.float32), {**state.metrics, **metrics}, info)

    def draws(self, state: EnvState) -> dict[str, Any]:
        """The uniform numbers that the next step from a state will use, and a restart in it. They replay it elsewhere:
        hand them to `step` here or to that of another engine's environment."""
        for_step, for_start, _ = _split(state.info["key"])
        return {**_draw(for_step, self.step_draws), **_draw(for_start, self.start_draws)}

    def _metrics(self, report: Mapping[str, Any], diverged: Any) -> dict[str, Any]:
        shares = {f"reward/{name}": jnp.asarray(share, jnp.float32) for name, share in report["reward_terms"].items()}
        return shares | {"diverged": diverged.astype(jnp.float32)}

    @cached_property
    def compiled_reset(self) -> jax.stages.Wrapped:
        """`jax.jit` of `reset`, compiled once for each shape of its arguments."""
        return jax.jit(self.reset)

    @cached_property
    def compiled_step(self) -> jax.stages.Wrapped:
        """`jax.jit` of `step`, compiled once for each shape of its arguments."""
        return jax.jit(self.step)

    # -- what Brax asks an environment ---------------------------------------------------------------------------------

    @property
    def observation_size(self) -> dict[str, tuple[int, ...]]:
        """Shapes of the actor's and the critic's observation."""
        return {name: value.shape[1:] for name, value in self.shapes().obs.items()}

    @property
    def action_size(self) -> int:
        """Length of an action."""
        return int(self.action_space.shape[0])

    @property
    def backend(self) -> str:
        """Name of the engine."""
        return self.engine.name

    def shapes(self) -> EnvState:
        """A state with the shape of each array instead of the array."""
        return jax.eval_shape(self.reset, jax.ShapeDtypeStruct((self.copies or 1, 2), jnp.uint32))

    @property
    def unwrapped(self) -> FunctionalEnv:
        """Itself."""
        return self


def _split(keys: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Three fresh keys of each, (N, 2)."""
    fresh = jax.vmap(partial(jax.random.split, num=3))(keys)
    return fresh[:, 0], fresh[:, 1], fresh[:, 2]


def _draw(keys: jax.Array, widths: Mapping[str, int]) -> dict[str, jax.Array]:
    """Uniform numbers from keys (N, 2), for all purposes at once: a generator takes long to compile."""
    numbers = jax.vmap(partial(jax.random.uniform, shape=(sum(widths.values()),), dtype=jnp.float32))(keys)
    stops = list(itertools.accumulate(widths.values()))
    return {name: numbers[:, stop - width : stop] for (name, width), stop in zip(widths.items(), stops, strict=True)}
