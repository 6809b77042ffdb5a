"""`Asimov-Trajectory-v0` as pure functions: follow a reference motion with direct joint targets."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import jax.numpy as jnp
import numpy as np

from asimov_gym.envs.functional.env import Advance, Draws, FunctionalEnv
from asimov_gym.envs.spaces import trajectory_spaces
from asimov_gym.envs.trajectory_batch import standing_height
from asimov_gym.physics import DECIMATION, PhysicsProfile
from asimov_gym.physics.functional import Engine, Simulation
from asimov_gym.physics.functional.engine import register
from asimov_gym.tasks.ground_truth import critic_view, ground_truth
from asimov_gym.tasks.trajectory import TrajectoryConfig, TrajectoryState, TrajectoryTask
from asimov_gym.tasks.trajectory.task import DT, START_DRAWS


@dataclass(frozen=True)
class TrajectoryWorld:
    """N robots that follow a motion, between two steps."""

    simulation: Simulation
    task: TrajectoryState


for _cls in (TrajectoryState, TrajectoryWorld):
    register(_cls)


class FunctionalTrajectory(FunctionalEnv):
    """The trajectory task; see `asimov_gym.envs.trajectory.TrajectoryEnv` for what it asks.

    The actor's observation is the Gymnasium environment's, its fields one after the other in the order of the keys;
    `gym_observation` takes it apart.

    Args:
        config: the task.
        physics: `c`, `mjx`, `warp`, or an engine.
        profile: physics profile of a named engine.
        threads: size of the thread pool of C physics.
        autoreset: whether episodes follow each other.
        dump_dir: where the state of diverged copies is written.
    """

    step_draws: dict[str, int] = {}  # noqa: RUF012
    start_draws = {"pose": START_DRAWS}  # noqa: RUF012
    dt = DT

    def __init__(
        self,
        config: TrajectoryConfig | None = None,
        physics: str | Engine = "mjx",
        profile: str | PhysicsProfile = "training",
        threads: int | None = None,
        *,
        autoreset: bool = True,
        dump_dir: Path | None = None,
    ) -> None:
        super().__init__(physics, profile, threads, autoreset, dump_dir)
        self.task = TrajectoryTask(config)
        self.observation_space, self.action_space = trajectory_spaces(self.task)
        first = jnp.asarray(self.task.motion.frames[:1], dtype=jnp.float32)
        pose = self.engine.configuration(first, jnp.zeros((1, 3)), jnp.array([[1.0, 0.0, 0.0, 0.0]]))
        self._height = standing_height(self.engine.model, np.asarray(pose[0], dtype=np.float64))

    def begin(self, draws: Draws, before: TrajectoryWorld | None) -> TrajectoryWorld:
        joints, heading = self.task.initial_pose(draws["pose"])
        zero = jnp.zeros_like(heading)
        position = jnp.stack([zero, zero, zero + self._height], axis=-1)
        quat = jnp.stack([jnp.cos(0.5 * heading), zero, zero, jnp.sin(0.5 * heading)], axis=-1)
        qpos = self.engine.configuration(joints, position, quat)
        simulation = self.engine.start(qpos, jnp.zeros((qpos.shape[0], self.engine.model.nv)))
        return TrajectoryWorld(simulation, self.task.initial_state(joints))

    def advance(self, world: TrajectoryWorld, action: Any, draws: Draws) -> Advance:
        target, clipped = self.task.target(action.astype(jnp.float32))
        simulation, diverged = self.engine.step(world.simulation, target, DECIMATION)
        outcome = self.task.conclude(world.task, target, self.engine.read(simulation), diverged)
        report = {"reward_terms": dict(outcome.shares), "clipped": clipped}
        return Advance(TrajectoryWorld(simulation, outcome.state), outcome, diverged, report)

    def observe(self, world: TrajectoryWorld, draws: Draws) -> dict[str, Any]:
        reading = self.engine.read(world.simulation)
        fields = self.task.observe(world.task, reading)
        n = reading.gyro.shape[0]
        state = jnp.concat([jnp.reshape(fields[name], (n, -1)).astype(jnp.float32) for name in self._fields], axis=-1)
        return {"state": state, "privileged_state": critic_view(state, list(ground_truth(reading).values()))}

    @property
    def _fields(self) -> dict[str, tuple[int, ...]]:
        """Shape of each field of the observation, in order; whole numbers are exact in float32."""
        spaces = self.observation_space
        assert isinstance(spaces, gym.spaces.Dict)
        return {name: tuple(space.shape or ()) for name, space in spaces.items()}

    def gym_observation(self, state: Any) -> dict[str, Any]:
        fields, start = {}, 0
        spaces = self.observation_space
        assert isinstance(spaces, gym.spaces.Dict)
        for name, shape in self._fields.items():
            width = int(np.prod(shape))
            block = state[..., start : start + width].reshape(*state.shape[:-1], *shape)
            whole = spaces[name].dtype == np.int64
            fields[name] = block.astype(np.int64 if isinstance(block, np.ndarray) else jnp.int32) if whole else block
            start += width
        return fields

    def figures(self, world: TrajectoryWorld) -> dict[str, Any]:
        return {"sequence": world.task.step}

    def blank_report(self, copies: int) -> dict[str, Any]:
        terms = {name: jnp.zeros(copies, dtype=jnp.float32) for name in self.task.config.rewards}
        return {"reward_terms": terms, "clipped": jnp.zeros(copies, dtype=jnp.int32)}
