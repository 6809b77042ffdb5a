"""What `asimov bench env` measures: an environment, and the bare engine under it doing the same work.

All robots walk as the shipped policy has them, with randomised bodies, sensor noise and kicks, so that falls and
restarts are as rare as late in training. The policy's own time does not count.
"""

from __future__ import annotations

import copy
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Protocol

import gymnasium as gym
import mujoco
import numpy as np
from mujoco import rollout

from asimov_gym.assets import asset_path
from asimov_gym.envs.walk_batch import WalkBatch, WalkStep
from asimov_gym.physics import DECIMATION
from asimov_gym.policy import load_policy
from asimov_gym.tasks.walk import WalkConfig

WARM_UP = 25
"""Policy steps before anything is measured."""
POLICY = asset_path("policies", "asimov_walk.onnx")
"""The shipped network."""


class Subject(Protocol):
    """N robots, ready to be measured."""

    compile_seconds: float | None
    """How long the environment took to compile; None where nothing is compiled."""

    def environment_seconds(self, steps: int) -> float:
        """Time of so many policy steps of all robots: observation, reward, randomisation and restarts included."""
        ...

    def physics_seconds(self, steps: int) -> float:
        """Time of the same physics steps with nothing around them."""
        ...

    def close(self) -> None:
        """Free what it holds."""
        ...


@dataclass(frozen=True)
class Moment:
    """Input of one policy step's physics, of every robot."""

    start: np.ndarray
    """The engine's rows of time, positions and velocities, (N, size)."""
    warmstart: np.ndarray
    """(N, nv)."""
    control: np.ndarray
    """(N, DECIMATION, nu)."""


class RawPhysics:
    """`mujoco.rollout` and nothing else, on the models, states and controls of a batch.

    Args:
        batch: the robots; their present body figures are taken over.
        threads: size of the thread pool.
    """

    def __init__(self, batch: WalkBatch, threads: int) -> None:
        self._batch, physics = batch, batch.physics
        self._models = [copy.copy(physics.model) for _ in range(batch.copies)]
        for index, model in enumerate(self._models):
            physics.figures.write(model, batch.body, index)
        pool = min(threads, batch.copies)
        self._datas = [mujoco.MjData(physics.model) for _ in range(pool)]
        self._rollout = rollout.Rollout(nthread=pool if pool > 1 else 0)
        size = mujoco.mj_stateSize(physics.model, int(mujoco.mjtState.mjSTATE_FULLPHYSICS))
        self.rows = np.empty((batch.copies, DECIMATION, size))
        """States after each physics step of the last replay."""
        self._sensed = np.empty((batch.copies, DECIMATION, physics.model.nsensordata))

    def record(self, steps: int, advance: Callable[[], object]) -> list[Moment]:
        """Physics inputs of so many calls of `advance`, each of which steps the batch once."""
        physics, moments = self._batch.physics, []
        for _ in range(steps):
            s = physics.state()
            advance()
            control = np.zeros((self._batch.copies, DECIMATION, physics.model.nu))
            control[:, :, physics.figures.servos] = self._batch.task.targets(self._batch.state)
            moments.append(Moment(np.column_stack([s.time, s.qpos, s.qvel]), s.warmstart, control))
        return moments

    def seconds(self, moments: list[Moment]) -> float:
        """Time of the physics of these moments."""
        began = time.perf_counter()
        for moment in moments:
            self._rollout.rollout(
                self._models,
                self._datas,
                moment.start,
                moment.control,
                skip_checks=True,
                nstep=DECIMATION,
                initial_warmstart=moment.warmstart,
                state=self.rows,
                sensordata=self._sensed,
            )
        return time.perf_counter() - began

    def close(self) -> None:
        """Stop the threads."""
        self._rollout.close()


class NumpyBatch:
    """The batch that the trainer and the Gymnasium environments are made of, on C physics."""

    compile_seconds: float | None = None

    def __init__(self, copies: int, threads: int) -> None:
        self.batch = WalkBatch(WalkConfig(), copies, "training", threads, seed=0, stagger=True)
        self._policy = load_policy(POLICY)
        self._observation, _ = self.batch.reset()
        self._raw = RawPhysics(self.batch, threads)
        for _ in range(WARM_UP):
            self._step(self._act())

    def _act(self) -> np.ndarray:
        return self._policy(self._observation)

    def _step(self, action: np.ndarray) -> WalkStep:
        step = self.batch.step(action)
        self._observation = step.observation
        return step

    def environment_seconds(self, steps: int) -> float:
        """As `Subject` has it."""
        total = 0.0
        for _ in range(steps):
            action = self._act()
            began = time.perf_counter()
            self._step(action)
            total += time.perf_counter() - began
        return total

    def physics_seconds(self, steps: int) -> float:
        """As `Subject` has it."""
        return self._raw.seconds(self._raw.record(steps, lambda: self._step(self._act())))

    def close(self) -> None:
        """As `Subject` has it."""
        self._raw.close()
        self.batch.close()


class GymVector(NumpyBatch):
    """`gym.make_vec("Asimov-Walk-v0")` on C physics; a batch of the same size beside it gives the physics."""

    def __init__(self, copies: int, threads: int) -> None:
        super().__init__(copies, threads)
        self._env = gym.make_vec(
            "Asimov-Walk-v0",
            num_envs=copies,
            config=WalkConfig(),
            randomise=True,
            noise=True,
            kicks=True,
            threads=threads,
        )
        self._seen, _ = self._env.reset(seed=0)
        self.environment_seconds(WARM_UP)

    def environment_seconds(self, steps: int) -> float:
        """As `Subject` has it."""
        total = 0.0
        for _ in range(steps):
            action = self._policy(self._seen)
            began = time.perf_counter()
            self._seen, *_ = self._env.step(action)
            total += time.perf_counter() - began
        return total

    def close(self) -> None:
        """As `Subject` has it."""
        self._env.close()
        super().close()


def _functional(physics: str, copies: int, threads: int, steps: int) -> Subject:
    import asimov_gym.physics.functional  # noqa: F401  (says what is missing, and prepares JAX)
    from asimov_gym.cli.bench_functional import Functional

    return Functional(physics, copies, threads, steps)


SUBJECTS: Mapping[str, Callable[[int, int, int], Subject]] = MappingProxyType(
    {
        "batch": lambda copies, threads, steps: NumpyBatch(copies, threads),
        "gym": lambda copies, threads, steps: GymVector(copies, threads),
        "jax-c": lambda *size: _functional("c", *size),
        "jax-mjx": lambda *size: _functional("mjx", *size),
        "jax-warp": lambda *size: _functional("warp", *size),
    }
)
"""What can be measured, by name: from the number of robots, of threads, and of steps in a measurement."""
