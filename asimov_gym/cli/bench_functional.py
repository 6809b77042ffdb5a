"""The environment as JAX functions, for `asimov bench env`. Needs JAX."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import jax

from asimov_gym.cli.bench_subjects import POLICY, WARM_UP
from asimov_gym.envs.functional import FunctionalWalk
from asimov_gym.physics import DECIMATION, JointTarget
from asimov_gym.policy.network import read_network
from asimov_gym.tasks.walk import WalkConfig


class Functional:
    """The environment as a compiled JAX function, on C physics by callback or on MJX.

    The same steps are measured each time, from the same state and with recorded actions; the bare engine starts each of
    them from the recorded state.
    """

    compile_seconds: float | None

    def __init__(self, physics: str, copies: int, threads: int, steps: int) -> None:
        self._env = env = FunctionalWalk(WalkConfig(), physics, threads=threads, stagger=True)
        network = read_network(POLICY)
        state = jax.jit(env.reset)(jax.random.split(jax.random.key(0), copies))

        def walk(state: Any, _: None) -> tuple[Any, Any]:
            action = network.infer(state.obs["state"])
            world = state.pipeline_state
            pushed = env.task.push_action(world.task, env.task.clip_action(action))
            return env.step(state, action), (action, world.simulation, env.task.targets(pushed), world.body)

        def environment(state: Any, actions: Any) -> Any:
            def step(state: Any, action: Any) -> tuple[Any, Any]:
                after = env.step(state, action)
                return after, after.reward.sum()

            return jax.lax.scan(step, state, actions)

        def physics_alone(taped: Any) -> Any:
            def step(total: Any, inputs: Any) -> tuple[Any, None]:
                simulation, target, body = inputs
                after, _ = env.engine.step(simulation, JointTarget(target), DECIMATION, body)
                return total + after.qpos.sum(), None  # so that nothing is left out as unused

            return jax.lax.scan(step, 0.0, taped)[0]

        self._state, _ = jax.jit(lambda s: jax.lax.scan(walk, s, length=WARM_UP))(state)
        _, (self._actions, *self._taped) = jax.jit(lambda s: jax.lax.scan(walk, s, length=steps))(self._state)
        began = time.perf_counter()
        self._run = jax.jit(environment).lower(self._state, self._actions).compile()
        self.compile_seconds = time.perf_counter() - began
        self._raw = jax.jit(physics_alone).lower(self._taped).compile()
        self._steps = steps
        self.environment_seconds(steps)
        self.physics_seconds(steps)

    def environment_seconds(self, steps: int) -> float:
        """As `Subject` has it; `steps` is the number that was compiled."""
        return self._seconds(steps, self._run, self._state, self._actions)

    def physics_seconds(self, steps: int) -> float:
        """As `Subject` has it; `steps` is the number that was compiled."""
        return self._seconds(steps, self._raw, self._taped)

    def _seconds(self, steps: int, run: Callable[..., Any], *arguments: Any) -> float:
        if steps != self._steps:
            raise ValueError(f"steps must be {self._steps}, as compiled, got {steps}")
        began = time.perf_counter()
        jax.block_until_ready(run(*arguments))
        return time.perf_counter() - began

    def close(self) -> None:
        """As `Subject` has it."""
