"""Walking robots on a JAX engine as rsl-rl's trainer uses them: `WalkBatch`'s surface, arrays on the device."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from asimov_gym.envs.functional import EnvState, FunctionalWalk

# isort: split
import jax
import jax.numpy as jnp
import numpy as np
import torch

from asimov_gym.envs.walk_batch import Curriculum
from train.config import PpoConfig
from train.figures import step_figures
from train.trees import filled, named


@dataclass(frozen=True)
class FunctionalStep:
    """What a step returns; arrays of JAX. Observations are already those of the next episode where one has ended."""

    observation: jax.Array
    """(N, width) float32."""
    privileged: jax.Array
    """(N, privileged width) float32."""
    reward: jax.Array
    """(N,) float32."""
    terminated: jax.Array
    """Fallen or diverged, (N,) bool."""
    truncated: jax.Array
    """Out of time, (N,) bool."""
    shares: dict[str, jax.Array]
    """Each reward term's weighted value per second, (N,)."""
    figures: dict[str, jax.Array]
    """What to report of the step; see `train.figures`."""


class FunctionalBatch:
    """N walking robots on MJX, or on another engine under JAX.

    Args:
        config: of the run.
        first: number of the first copy among those of all ranks; everything random of a copy follows from the seed and
            its number.
        dump_dir: where the state of diverged copies is written.
    """

    def __init__(self, config: PpoConfig, first: int = 0, dump_dir: Path | None = None) -> None:
        self.env = FunctionalWalk(
            config.walk,
            config.physics or "c",
            config.profile,
            config.threads,
            curriculum=True,
            stagger=True,
            dump_dir=dump_dir,
        )
        self.task, self.copies = self.env.task, config.copies
        numbers = jnp.arange(first, first + config.copies)
        keys = jax.vmap(jax.random.fold_in, in_axes=(None, 0))(jax.random.PRNGKey(config.seed), numbers)
        self._keys = _home(keys)
        self._step = jax.jit(self._stepped)
        self._state: EnvState | None = None

    @property
    def state(self) -> EnvState:
        """After the last step.

        Raises:
            RuntimeError: the batch was never reset.
        """
        if self._state is None:
            raise RuntimeError("reset the batch before its first step")
        return self._state

    def close(self) -> None:
        """Nothing to stop."""

    def reset(self) -> tuple[jax.Array, jax.Array]:
        """Start all copies anew, from the seed.

        Returns:
            The actor's observation (N, width) and the critic's (N, privileged width).
        """
        state = self._state = self.env.compiled_reset(self._keys)
        jax.block_until_ready(state)
        return state.obs["state"], state.obs["privileged_state"]

    def step(self, action: torch.Tensor) -> FunctionalStep:
        """One policy step (20 ms) of every copy.

        Args:
            action: network outputs in policy order, (N, 23). Where one is not finite, that copy's episode ends.
        """
        self._state, step = self._step(self.state, _on_device(action))
        return jax.block_until_ready(step)

    def _stepped(self, state: EnvState, action: jax.Array) -> tuple[EnvState, FunctionalStep]:
        after = self.env.step(state, action)
        info, task = after.info, after.pipeline_state.task
        shares = dict(info["report"]["reward_terms"])
        error = task.mean_velocity - task.command
        step = FunctionalStep(
            observation=after.obs["state"],
            privileged=after.obs["privileged_state"],
            reward=after.reward,
            terminated=info["terminated"],
            truncated=info["truncated"],
            shares=shares,
            figures=step_figures(after.reward, info["terminated"], info["diverged"], error, shares),
        )
        return after, step

    @property
    def calm(self) -> jax.Array:
        """Copies whose episode nothing disturbs, (N,) bool."""
        return self.task.is_calm(self.state.pipeline_state.task)

    # -- curriculum ----------------------------------------------------------------------------------------------------

    def advance_curriculum(self) -> None:
        """Nothing: the levels are part of the state and grow with its steps."""

    @property
    def curriculum(self) -> Curriculum:
        """Levels of all copies."""
        levels = vars(self.state.pipeline_state.levels)
        return Curriculum(**{name: float(value[0]) for name, value in levels.items()})

    @curriculum.setter
    def curriculum(self, curriculum: Curriculum) -> None:
        state, world = self.state, self.state.pipeline_state
        full = {name: np.full(self.copies, value, dtype=np.float32) for name, value in vars(curriculum).items()}
        levels = {name: _home(value) for name, value in full.items()}
        self._state = state.replace(pipeline_state=replace(world, levels=replace(world.levels, **levels)))

    # -- checkpoints ---------------------------------------------------------------------------------------------------

    def snapshot(self) -> dict[str, np.ndarray]:
        """Everything needed to continue this batch exactly, random keys included."""
        return named(self.state)

    def restore(self, snapshot: Mapping[str, np.ndarray]) -> None:
        """Continue from a snapshot of a batch of the same size and task.

        Raises:
            ValueError: the snapshot is of another one.
        """
        self._state = filled(jax.eval_shape(self.env.reset, self._keys), snapshot, _home)


jax.tree_util.register_dataclass(FunctionalStep, data_fields=[*FunctionalStep.__dataclass_fields__], meta_fields=[])


def _home(array: Any) -> jax.Array:
    """An array where JAX calculates. All of a state must be said to be there, else JAX compiles the step again."""
    return jax.device_put(array, jax.devices()[0])


def _on_device(action: torch.Tensor) -> jax.Array:
    """A tensor where JAX calculates; without a copy where it is there already."""
    if action.device.type == "cuda" and jax.default_backend() == "cpu":
        action = action.cpu()
    return _home(jnp.from_dlpack(action.detach().contiguous()))
