"""`Asimov-Walk-v0` as pure functions: follow a velocity command."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from asimov_gym.envs.functional.env import Advance, Draws, FunctionalEnv
from asimov_gym.envs.spaces import walk_spaces
from asimov_gym.envs.walk_batch import nominal_body
from asimov_gym.physics import DECIMATION, BodyParameters, JointTarget, PhysicsProfile
from asimov_gym.physics.functional import Engine, Simulation
from asimov_gym.physics.functional.engine import choose, register
from asimov_gym.tasks.walk import WalkConfig, WalkState, WalkTask, curriculum
from asimov_gym.tasks.walk import task as walk
from asimov_gym.tasks.walk.curriculum import Levels
from asimov_gym.tasks.walk.draws import draw_body

_FOREVER = np.iinfo(np.int32).max // 2
"""Steps left of a command that is never drawn anew."""


@dataclass(frozen=True)
class WalkWorld:
    """N walking robots between two steps."""

    simulation: Simulation
    task: WalkState
    body: BodyParameters
    levels: Levels
    """Place in the curriculum, (N,) each; the same for all copies of a batch."""


for _cls in (WalkState, Levels, WalkWorld):
    register(_cls)


class FunctionalWalk(FunctionalEnv):
    """The walking task; see `asimov_gym.envs.walk.WalkEnv` for what it asks.

    Args:
        config: the task. (The Gymnasium environments change its actions: `asimov_gym.envs.walk.NORMALISED_ACTIONS`.)
        physics: `c`, `mjx`, `warp`, or an engine.
        profile: physics profile of a named engine.
        threads: size of the thread pool of C physics.
        command: velocity command to keep in every episode, (3,) or (N, 3); rows of NaN, or None, are drawn.
        randomise: give each copy its own body figures and action delay; otherwise nominal figures and no delay.
        noise: add sensor noise to the actor's observation.
        kicks: disturb the robot now and then, by the configuration's kicks and shoves.
        curriculum: start penalties and kicks at their first level, and let them grow; otherwise at their last.
        stagger: start the first episodes at random times of their life, so that they do not all end together.
        autoreset: whether episodes follow each other.
        dump_dir: where the state of diverged copies is written.
    """

    dt = walk.DT

    def __init__(
        self,
        config: WalkConfig | None = None,
        physics: str | Engine = "mjx",
        profile: str | PhysicsProfile = "training",
        threads: int | None = None,
        *,
        command: np.ndarray | None = None,
        randomise: bool = True,
        noise: bool = True,
        kicks: bool = True,
        curriculum: bool = False,
        stagger: bool = False,
        autoreset: bool = True,
        dump_dir: Path | None = None,
    ) -> None:
        self.task = WalkTask(config)
        self.config = self.task.config
        trail = self.task.trail if noise else 0
        super().__init__(physics, profile, threads, autoreset, dump_dir, self.task.terrain, trail)
        self.step_draws = self.task.step_draws
        self.start_draws = {**self.task.start_draws, "stagger": 1}
        self.observation_space, self.action_space = walk_spaces(self.task)
        self._command = command
        self.copies = None if command is None or np.ndim(command) == 1 else len(command)
        self.randomise, self._noise, self._kicks = randomise, noise, kicks
        self._curriculum, self._stagger = curriculum, stagger

    def begin(self, draws: Draws, before: WalkWorld | None, command: Any | None = None) -> WalkWorld:
        joints, height, quat, velocity = self.task.initial_pose(draws["pose"])
        n = height.shape[0]
        position = jnp.stack([jnp.zeros(n), jnp.zeros(n), height], axis=-1)
        if not self.task.terrain.is_flat:
            position = position + self.task.place(draws["place"])
        qvel = jnp.zeros((n, self.engine.model.nv)).at[:, 0:6].set(velocity)
        simulation = self.engine.start(self.engine.configuration(joints, position, quat), qvel)
        state = self.task.initial_state(draws["state"], self.randomise, self._noise)
        command = self._command if command is None else command
        if command is not None:
            kept = jnp.broadcast_to(jnp.asarray(command, dtype=jnp.float32), (n, 3))
            fixed = jnp.all(jnp.isfinite(kept), axis=-1)
            left = jnp.where(fixed, _FOREVER, state.command_left)
            state = replace(state, command=jnp.where(fixed[:, None], kept, state.command), command_left=left)
        if before is None and self._stagger:
            step = jnp.floor(draws["stagger"][:, 0] * self.task.episode_steps).astype(state.step.dtype)
            state = replace(state, step=step)
        return WalkWorld(simulation, state, self._body(draws, before, n), self._levels(before, n))

    def _body(self, draws: Draws, before: WalkWorld | None, copies: int) -> BodyParameters:
        if not self.randomise:
            nominal = vars(nominal_body(copies))
            return BodyParameters(**{name: jnp.asarray(value) for name, value in nominal.items()})
        drawn = draw_body(self.config.randomisation, draws["body"])
        if before is None:
            return drawn
        return choose(draws["redraw"][:, 0] < self.config.randomisation.redraw_share, drawn, before.body)

    def _levels(self, before: WalkWorld | None, copies: int) -> Levels:
        if before is not None:
            return before.levels
        penalty, kick = (self.config.curriculum.start, 0.0) if self._curriculum else (1.0, 1.0)
        return Levels(*(jnp.full(copies, value, dtype=jnp.float32) for value in (penalty, kick, 0.0)))

    def advance(self, world: WalkWorld, action: Any, draws: Draws) -> Advance:
        clipped = self.task.clip_action(action.astype(jnp.float32))
        state, simulation, levels = self.task.push_action(world.task, clipped), world.simulation, world.levels
        if self._kicks:
            state, velocity = self.task.kick(state, draws["kick"], levels.kick)
            simulation = self.engine.kick(simulation, velocity)
            state = self.task.shove(state, draws["shove"], levels.kick)
        wrench = self.task.wrench(state) if self.config.shove.bodies else None
        target = JointTarget(self.task.targets(state))
        body = world.body if self.randomise else None
        simulation, diverged = self.engine.step(simulation, target, DECIMATION, body, wrench)
        reading = self.engine.read(simulation)
        outcome = self.task.conclude(state, reading, diverged, draws["command"], levels.penalty)
        if self._curriculum:
            levels = curriculum.after_episodes(levels, outcome.state.step, outcome.terminated | outcome.truncated)
            levels = curriculum.grown(levels, self.config.curriculum)
        count = jnp.sum(clipped != action, axis=-1)
        report = {"reward_terms": dict(outcome.shares), "clipped": count}
        return Advance(WalkWorld(simulation, outcome.state, world.body, levels), outcome, diverged, report)

    def observe(self, world: WalkWorld, draws: Draws) -> dict[str, Any]:
        reading = self.engine.read(world.simulation)
        noise, sensed = draws["sensors"] if self._noise else None, None
        if self._noise and self.config.noise.can_slot_delay:
            trail = world.simulation.joint_trail
            assert trail is not None  # the engine was checked for it
            sensed = self.task.sensed(reading, trail[:, : self.task.trail], draws["bus"])
        actor, critic = self.task.views(world.task, reading, world.body, noise, sensed)
        return {"state": actor, "privileged_state": critic}

    def figures(self, world: WalkWorld) -> dict[str, Any]:
        return {"command": world.task.command}

    def blank_report(self, copies: int) -> dict[str, Any]:
        terms = {name: jnp.zeros(copies, dtype=jnp.float32) for name in self.config.rewards}
        return {"reward_terms": terms, "clipped": jnp.zeros(copies, dtype=jnp.int32)}


def batch_snapshot(env: FunctionalWalk, world: WalkWorld) -> Mapping[str, Any]:
    """A world as a snapshot that `asimov_gym.envs.walk_batch.WalkBatch.restore` takes, to go on from it with NumPy.

    The batch's own random numbers start from seed 0; give its `step` those of `FunctionalEnv.draws`.
    """

    def plain(value: Any) -> np.ndarray:
        array = np.array(value)
        return array.astype(np.int64) if array.dtype.kind == "i" else array

    levels = {name: float(np.asarray(value)[0]) for name, value in vars(world.levels).items()}
    return {
        "physics": dict(vars(env.engine.physics_state(world.simulation))),
        "task": {name: plain(value) for name, value in vars(world.task).items()},
        "body": {name: plain(value) for name, value in vars(world.body).items()},
        "body_drawn": np.full(len(world.simulation.time), env.randomise),
        "curriculum": levels,
        "rng": np.random.default_rng(0).bit_generator.state,
    }
