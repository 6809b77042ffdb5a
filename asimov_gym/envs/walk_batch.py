"""A batch of walking robots on C physics: the engine room of the Gymnasium environments and the trainer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, TypeVar

import mujoco
import numpy as np

from asimov_gym.envs.streams import CopyStreams
from asimov_gym.physics import (
    DECIMATION,
    BodyParameters,
    CPhysics,
    JointTarget,
    PhysicsProfile,
    PhysicsState,
    Reading,
    compile_model,
)
from asimov_gym.robot.joints import JOINT_NAMES, POLICY_JOINT_NAMES
from asimov_gym.tasks.walk import WalkConfig, WalkState, WalkTask
from asimov_gym.tasks.walk import curriculum as levels
from asimov_gym.tasks.walk.curriculum import Levels
from asimov_gym.tasks.walk.draws import draw_body, draw_kick
from asimov_gym.tasks.walk.state import SHOVE_DRAWS

_ACTIONS = len(POLICY_JOINT_NAMES)
_Rows = TypeVar("_Rows", WalkState, BodyParameters)
_FOREVER = np.iinfo(np.int64).max // 2
"""Steps left of a command that is never drawn anew."""


@dataclass(frozen=True)
class WalkStep:
    """What a step of the batch returns. Rows of `observation` and `privileged` are already those of the next episode
    where an episode has ended and the batch resets by itself."""

    observation: np.ndarray
    """(N, width) float32."""
    privileged: np.ndarray
    """(N, privileged width) float32."""
    reward: np.ndarray
    """(N,) float32."""
    terminated: np.ndarray
    """Fallen or diverged, (N,) bool."""
    truncated: np.ndarray
    """Out of time, (N,) bool."""
    final_observation: np.ndarray
    """The last observation of the episodes that ended, (N, width); equal to `observation` in other rows."""
    shares: dict[str, np.ndarray]
    """Each reward term's weighted value per second, (N,)."""
    reading: Reading
    """Before any reset, float32."""
    clipped: int
    """How many action entries were out of bounds and clipped."""


@dataclass
class Curriculum:
    """Levels that grow while episodes last; part of a checkpoint."""

    penalty: float
    kick: float
    mean_length: float
    """Running mean length of finished episodes, policy steps."""

    @property
    def levels(self) -> Levels:
        """The same as numbers of NumPy."""
        return Levels(*(np.float64(value) for value in vars(self).values()))

    @classmethod
    def of(cls, levels: Levels) -> Curriculum:
        """Plain numbers of levels."""
        return cls(**{name: float(value) for name, value in vars(levels).items()})


class WalkBatch:
    """N walking robots.

    Args:
        config: the task.
        copies: N.
        profile: physics profile.
        threads: size of the physics thread pool.
        seed: of everything random.
        randomise: give each copy its own body figures and action delay; otherwise nominal figures and no delay.
        noise: add sensor noise to the actor's observation.
        kicks: disturb the robot now and then, by the configuration's kicks and shoves.
        curriculum: start penalties and kicks at their first level; otherwise at their last.
        autoreset: start the next episode in the same step that ends one.
        stagger: start episodes at random times of their life, so that they do not all end together.
        dump_dir: where the state of diverged copies is written.
        model: another compiled model of the robot, on the terrain of the configuration.
    """

    def __init__(
        self,
        config: WalkConfig | None = None,
        copies: int = 1,
        profile: str | PhysicsProfile = "training",
        threads: int | None = None,
        seed: int | None = None,
        *,
        randomise: bool = True,
        noise: bool = True,
        kicks: bool = True,
        curriculum: bool = False,
        autoreset: bool = True,
        stagger: bool = False,
        dump_dir: Path | None = None,
        model: mujoco.MjModel | None = None,
    ) -> None:
        self.task = WalkTask(config)
        self.config = self.task.config
        self.copies = copies
        if model is None and not self.task.terrain.is_flat:
            model = compile_model(profile, visuals=copies == 1, terrain=self.task.terrain)
        self._aged = noise and self.config.noise.can_slot_delay
        trail = self.task.trail if self._aged else 0
        self.physics = CPhysics(
            copies, profile, threads, model=model, dump_dir=dump_dir, trail=trail, reading_type=np.float32
        )
        self._widths = {**self.task.step_draws, **self.task.start_draws}
        self.randomise, self.noise, self.kicks, self.autoreset = randomise, noise, kicks, autoreset
        self.stagger = stagger
        first = self.config.curriculum.start if curriculum else 1.0
        self.curriculum = Curriculum(penalty=first, kick=0.0 if curriculum else 1.0, mean_length=0.0)
        self.rng = np.random.default_rng(seed)
        self._streams: CopyStreams | None = None
        self._given: Mapping[str, np.ndarray] | None = None
        """Uniform numbers to use instead of own ones, during a replayed step."""
        self.body = nominal_body(copies)
        self._body_drawn = np.zeros(copies, dtype=bool)
        self.state: WalkState
        self.reset()

    def close(self) -> None:
        """Stop the physics threads."""
        self.physics.close()

    # -- start ---------------------------------------------------------------------------------------------------------

    def reset(self, seed: int | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Start all copies anew; with a seed, everything random restarts from it.

        Returns:
            The actor's observation (N, width) and the critic's (N, privileged width).
        """
        if seed is not None:
            self.rng = np.random.default_rng(seed)
            self._streams = None
            self._body_drawn[:] = False
        self.state = self.task.initial_state(self._draw("state"))
        self._start(np.arange(self.copies))
        if self.stagger:
            steps = self.rng.integers(0, self.task.episode_steps, self.copies)
            self.state = replace(self.state, step=steps)
        return self._observe()

    @property
    def reading(self) -> Reading:
        """The robots as they are now, float32."""
        return self.physics.read()

    def seed_copies(self, seeds: Sequence[int]) -> None:
        """Give each copy a random stream of its own: from its next start on, copy i does what a batch of one does with
        seed i. `snapshot` does not cover such streams.

        Raises:
            ValueError: the number of seeds is not that of the copies.
        """
        if len(seeds) != self.copies:
            raise ValueError(f"seeds must be {self.copies} numbers, one for each copy, got {len(seeds)}")
        self._streams = CopyStreams(seeds)
        self._body_drawn[:] = False

    def restart(self, which: np.ndarray, command: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Start the next episode of some copies.

        Args:
            which: mask of the copies, (N,) bool.
            command: velocity command to keep for the whole episode, (N, 3); rows of NaN are drawn as usual.

        Returns:
            The actor's observation (N, width) and the critic's (N, privileged width); only the rows of `which` count.
        """
        copies = np.flatnonzero(which)
        self._start(copies)
        if command is not None:
            fixed = which & np.isfinite(command).all(axis=1)
            self.state.command[fixed] = command[fixed]
            self.state.command_left[fixed] = _FOREVER
        rows = self._observe(copies)
        observation, privileged = (np.zeros((self.copies, part.shape[1]), dtype=part.dtype) for part in rows)
        observation[copies], privileged[copies] = rows
        return observation, privileged

    def _start(self, copies: np.ndarray) -> None:
        """Put copies, by their indices, into a fresh episode: physics, body figures and task state."""
        joints, height, quat, velocity = self.task.initial_pose(self._draw("pose", copies))
        position = np.zeros((len(copies), 3))
        position[:, 2] = height
        if not self.task.terrain.is_flat:
            position += self.task.place(self._draw("place", copies))
        qvel = np.zeros((len(copies), self.physics.model.nv))
        qvel[:, 0:6] = velocity
        self.physics.reset(self.physics.configuration(joints, position, quat), qvel, copies)
        fresh = self.task.initial_state(self._draw("state", copies), self.randomise, self.noise)
        for name, rows in vars(fresh).items():
            getattr(self.state, name)[copies] = rows
        if self.randomise:
            redrawn = copies[self._lucky(copies) | ~self._body_drawn[copies]]
            if redrawn.size:
                for name, rows in vars(draw_body(self.config.randomisation, self._draw("body", redrawn))).items():
                    getattr(self.body, name)[redrawn] = rows
                self.physics.set_parameters(self.body, redrawn)
                self._body_drawn[redrawn] = True

    # -- stepping ------------------------------------------------------------------------------------------------------

    def step(self, action: np.ndarray, draws: Mapping[str, np.ndarray] | None = None) -> WalkStep:
        """One policy step (20 ms) of every copy.

        Args:
            action: network outputs in policy order, (N, 23); finite values out of bounds are clipped and counted.
            draws: uniform numbers to use instead of the batch's own, by the names in `step_draws` and `start_draws` of
                the task, (N, width) each: with those that another engine recorded, its rollout is replayed here.

        Raises:
            ValueError: a wrong shape, or NaN.
        """
        self._given = draws
        try:
            return self._step(action)
        finally:
            self._given = None

    def _step(self, action: np.ndarray) -> WalkStep:
        wanted = check_action(action, (self.copies, _ACTIONS))
        clipped_action = self.task.clip_action(wanted)
        state = self.task.push_action(self.state, clipped_action)
        if self.kicks:
            state = self._kick(state)
            state = self._shove(state)
        target = JointTarget(self.task.targets(state))
        reading = self.physics.step(target, DECIMATION, self._wrench(state))
        outcome = self.task.conclude(
            state, reading, self.physics.diverged, self._draw("command"), self.curriculum.penalty
        )
        self.state = outcome.state
        done = outcome.terminated | outcome.truncated
        observation, privileged = self._observe()
        final_observation = observation
        if done.any():
            self.curriculum = Curriculum.of(levels.after_episodes(self.curriculum.levels, self.state.step, done))
            if self.autoreset:
                final_observation = observation.copy()
                over = np.flatnonzero(done)
                self._start(over)
                observation[over], privileged[over] = self._observe(over)
        return WalkStep(
            observation=observation,
            privileged=privileged,
            reward=outcome.reward.astype(np.float32),
            terminated=outcome.terminated,
            truncated=outcome.truncated,
            final_observation=final_observation,
            shares=dict(outcome.shares),
            reading=reading,
            clipped=int((clipped_action != wanted).sum()),
        )

    @property
    def calm(self) -> np.ndarray:
        """Copies whose episode nothing disturbs, (N,) bool."""
        return self.task.is_calm(self.state)

    def set_command(self, command: np.ndarray, steps: int | None = None) -> None:
        """Fix the velocity command of all copies, (3,) or (N, 3), for `steps` policy steps or for good."""
        lifetime = np.full(self.copies, _FOREVER if steps is None else steps)
        value = np.broadcast_to(np.asarray(command, dtype=np.float32), (self.copies, 3)).copy()
        self.state = replace(self.state, command=value, command_left=lifetime)

    def _kick(self, state: WalkState) -> WalkState:
        due = np.flatnonzero(state.kick_left <= 0)
        if not due.size:
            return state
        # As `task.kick`, for few rows.
        kick, wait = draw_kick(self.config.kick, self._draw("kick", due), self.curriculum.kick)
        self.physics.kick(kick, due)
        left = state.kick_left.copy()
        left[due] = wait
        return replace(state, kick_left=left)

    def _shove(self, state: WalkState) -> WalkState:
        if not self.config.shove.bodies:
            return state
        due = np.flatnonzero(state.shove_wait <= 0)
        draws = np.zeros((self.copies, SHOVE_DRAWS), dtype=np.float32)
        if due.size:
            draws[due] = self._draw("shove", due)
        return self.task.shove(state, draws, self.curriculum.kick)

    def _wrench(self, state: WalkState) -> dict[str, np.ndarray] | None:
        """Forces of the shoves as the physics takes them; None when there is none."""
        return self.task.wrench(state) if state.shove.any() else None

    def advance_curriculum(self) -> None:
        """Let the levels grow by one step if episodes last. The trainer calls it once per policy step."""
        self.curriculum = Curriculum.of(levels.grown(self.curriculum.levels, self.config.curriculum))

    def _observe(self, copies: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Both observations of all copies, or of those with these indices."""
        draws = self._draw("sensors", copies) if self.noise else None
        state, reading, body = self.state, self.physics.read(copies), self.body
        if copies is not None:
            state, body = _rows(state, copies), _rows(body, copies)
        return self.task.views(state, reading, body, draws, self._sensed(reading, copies))

    def _sensed(self, reading: Reading, copies: np.ndarray | None) -> Reading | None:
        """The reading as the motor bus delivers it, where that is another one; `copies` as for `_observe`."""
        if not self._aged:
            return None
        trail = self.physics.joint_trail()[slice(None) if copies is None else copies]
        return self.task.sensed(reading, trail.astype(np.float32), self._draw("bus", copies))

    def _draw(self, purpose: str, copies: np.ndarray | None = None) -> np.ndarray:
        """Uniform numbers for a purpose, a row for each of the copies with these indices, or for all."""
        if self._given is not None:
            return np.asarray(self._given[purpose])[slice(None) if copies is None else copies]
        width = self._widths[purpose]
        if self._streams is not None:
            return self._streams.draw(width, copies)
        return self.rng.random((self.copies if copies is None else len(copies), width), dtype=np.float32)

    def _lucky(self, copies: np.ndarray) -> np.ndarray:
        """Which of these copies get a new body, a bool for each."""
        return self._draw("redraw", copies)[:, 0] < self.config.randomisation.redraw_share

    # -- checkpoints ---------------------------------------------------------------------------------------------------

    def snapshot(self) -> dict[str, Any]:
        """Everything needed to continue this batch exactly, as plain arrays and dictionaries."""
        return {
            "physics": dict(vars(self.physics.state())),
            "task": {f.name: getattr(self.state, f.name).copy() for f in fields(WalkState)},
            "body": {f.name: getattr(self.body, f.name).copy() for f in fields(BodyParameters)},
            "body_drawn": self._body_drawn.copy(),
            "curriculum": dict(vars(self.curriculum)),
            "rng": self.rng.bit_generator.state,
        }

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Continue from a snapshot of a batch of the same size; the next `step` is the one that would have followed.

        Raises:
            ValueError: the snapshot is of another batch size.
        """
        count = len(snapshot["task"]["step"])
        if count != self.copies:
            raise ValueError(f"copies of the snapshot must be {self.copies}, got {count}")
        self.physics.set_state(PhysicsState(**snapshot["physics"]))
        self.state = WalkState(**{name: value.copy() for name, value in snapshot["task"].items()})
        self.body = BodyParameters(**{name: value.copy() for name, value in snapshot["body"].items()})
        self._body_drawn = snapshot["body_drawn"].copy()
        if self._body_drawn.any():
            self.physics.set_parameters(self.body, copies=self._body_drawn)
        self.curriculum = Curriculum(**snapshot["curriculum"])
        self.rng.bit_generator.state = snapshot["rng"]


def check_action(action: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """The action as float32 of the given shape.

    Raises:
        ValueError: a wrong shape, or an entry that is NaN; infinities pass, they are clipped.
    """
    array = np.asarray(action, dtype=np.float32)
    if array.shape != shape:
        raise ValueError(f"action has shape {array.shape}, allowed is {shape}")
    if np.isnan(array).any():
        place = np.argwhere(np.isnan(array))[0].tolist()
        raise ValueError(f"action is NaN at {place}; entries must be finite numbers")
    return array


def _rows(quantities: _Rows, copies: np.ndarray) -> _Rows:
    """The rows of some copies in a dataclass of arrays."""
    return type(quantities)(**{name: array[copies] for name, array in vars(quantities).items()})


def nominal_body(copies: int) -> BodyParameters:
    """The robot's own figures, N rows of them."""
    joints = len(JOINT_NAMES)
    return BodyParameters(
        foot_friction=np.full(copies, 0.6, dtype=np.float32),
        kp_scale=np.ones((copies, joints), dtype=np.float32),
        kd_scale=np.ones((copies, joints), dtype=np.float32),
        torso_mass=np.zeros(copies, dtype=np.float32),
        torso_com=np.zeros((copies, 3), dtype=np.float32),
    )
