"""Many robots on a JAX engine as a Gymnasium vector environment."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import gymnasium as gym
import jax
import jax.numpy as jnp
import numpy as np
from gymnasium.vector.utils import batch_space

from asimov_gym.envs.batch import check_action, check_options, masked_info, row
from asimov_gym.envs.functional.env import FunctionalEnv
from asimov_gym.envs.functional.kept_program import KeptProgram, identity
from asimov_gym.envs.functional.state import EnvState
from asimov_gym.envs.vector_env import seeds_of_copies
from asimov_gym.physics.memory import batch_of

ARRAYS = ("numpy", "device")


class FunctionalVectorEnv(gym.vector.VectorEnv[Any, Any, Any]):
    """A functional environment with a state of its own, behind Gymnasium's interface.

    An episode that ends is followed by the next one in the same step (`AutoresetMode.SAME_STEP`). With NumPy arrays
    `info` is laid out as in the vector environments on C physics: the last observation and info of an episode that
    ended are in `final_obs` and `final_info`. With arrays on the device nothing is copied or waited for, `info`
    holds whole arrays, `final_obs` counts where `_final_obs` is true, and an action that is not finite is no error but
    ends that copy's episode. A device array goes to another library through DLPack: `torch.from_dlpack(observation)`;
    actions may come the same way.

    Args:
        env: the functional environment; it must restart by itself.
        num_envs: number of copies.
        arrays: `numpy`, or `device` for JAX arrays.
        begin_options: what `options` of a reset may hold: name to a function that checks the value and makes it an
            argument of the environment's `begin`.

    Raises:
        ValueError: `arrays` is neither of the two.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012
        "render_modes": [],
        "autoreset_mode": gym.vector.AutoresetMode.SAME_STEP,
    }
    render_mode = None

    def __init__(
        self,
        env: FunctionalEnv,
        num_envs: int,
        arrays: str = "numpy",
        begin_options: Mapping[str, Callable[[Any], Any]] | None = None,
    ) -> None:
        if arrays not in ARRAYS:
            raise ValueError(f"arrays must be one of {', '.join(ARRAYS)}, got {arrays!r}")
        self.functional = env
        """The functions behind it."""
        self.num_envs = num_envs
        self.metadata = self.metadata | {"render_fps": round(1.0 / env.dt)}
        self.single_observation_space, self.single_action_space = env.observation_space, env.action_space
        self.observation_space = batch_space(env.observation_space, num_envs)
        self.action_space = batch_space(env.action_space, num_envs)
        self._on_device = arrays == "device"
        self._options = begin_options or {}
        self._state: EnvState | None = None
        self._identity = identity(env)
        self._programs: dict[tuple[str, ...], KeptProgram] = {}

    @property
    def state(self) -> EnvState:
        """The functional state after the last step.

        Raises:
            gymnasium.error.ResetNeeded: `reset` has never been called.
        """
        if self._state is None:
            raise gym.error.ResetNeeded("call reset() before the first step()")
        return self._state

    def reset(  # type: ignore[override]
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start an episode of every copy.

        Args:
            seed: copy i does what it follows from `seed[i]`, or from `seed + i` where one number is given. The random
                numbers are JAX's, not those of the environments on C physics with the same seed.
            options: see the task's environment; unknown names are refused.

        Raises:
            ValueError: the number of seeds is not that of the copies; an unknown option or one with a wrong value.
            MemoryError: so many copies do not fit into the memory of JAX's device.
        """
        given = check_options(options, tuple(self._options))
        start = {name: self._options[name](value) for name, value in given.items() if value is not None}
        super().reset(seed=seed if isinstance(seed, int) else None)
        if seed is None and self._state is not None:
            keys = self._state.info["key"]
        else:
            seeds = seeds_of_copies(seed, self.num_envs, self.np_random)
            keys = jnp.asarray(np.stack([_key(s) for s in seeds]))
        with batch_of(self.num_envs):
            state = self._state = self._program("reset", *sorted(start))(keys, start)
        everyone = np.ones(self.num_envs, dtype=bool)
        if self._on_device:
            return self._observation(state.obs["state"]), dict(state.info["now"]) | _privileged(state.obs)
        state = jax.tree.map(np.array, state)
        fresh = dict(state.info["now"]) | _privileged(state.obs)
        return self._observation(state.obs["state"]), masked_info([(everyone, fresh)])

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """One control step of every copy.

        Raises:
            ValueError: the actions have a wrong shape, or (with NumPy arrays) an entry that is not finite.
            gymnasium.error.ResetNeeded: `reset` has never been called.
        """
        before = self.state
        if self._on_device:
            action = _on_device(actions)
            if action.shape != self.action_space.shape:
                raise ValueError(f"action must have shape {self.action_space.shape}, got {action.shape}")
        else:
            action = jnp.asarray(check_action(actions, self.action_space.shape or ()))
        with batch_of(self.num_envs):
            state = self._state = self._program("step")(before, action)
        return self._on_device_result(state) if self._on_device else self._numpy_result(state)

    def _program(self, name: str, *options: str) -> KeptProgram:
        """A function of the environment, for a reset with these options."""
        if (name, *options) not in self._programs:
            compiled = self.functional.compiled_reset if name == "reset" else self.functional.compiled_step
            self._programs[name, *options] = KeptProgram(compiled, name, self._identity)
        return self._programs[name, *options]

    def _on_device_result(self, state: EnvState) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        i, done = state.info, state.done > 0
        info = dict(i["now"]) | dict(i["report"]) | _privileged(state.obs) | {"diverged": i["diverged"]}
        info |= {"final_obs": self._observation(i["final_obs"]["state"]), "_final_obs": done}
        info |= {"final_info": dict(i["final"]) | _privileged(i["final_obs"]), "_final_info": done}
        return self._observation(state.obs["state"]), state.reward, i["terminated"], i["truncated"], info

    def _numpy_result(self, state: EnvState) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        wanted = (state.obs, state.reward, state.done, {k: v for k, v in state.info.items() if k != "key"})
        obs, reward, done, i = jax.tree.map(np.array, jax.device_get(wanted))
        done = done > 0
        report = dict(i["report"]) | {"diverged": i["diverged"]}
        last = dict(i["final"]) | _privileged(i["final_obs"]) | report
        observation = self._observation(obs["state"])
        if not done.any():
            return observation, reward, i["terminated"], i["truncated"], masked_info([(~done, last)])
        fresh = dict(i["now"]) | _privileged(obs)
        info = masked_info([(~done, last), (done, fresh)])
        ended = self._observation(i["final_obs"]["state"])
        final = np.full(self.num_envs, None, dtype=object)
        for copy in np.flatnonzero(done):
            final[copy] = row(ended, int(copy))
        info["final_obs"], info["_final_obs"] = final, done
        info["final_info"], info["_final_info"] = masked_info([(done, last)]), done.copy()
        return observation, reward, i["terminated"], i["truncated"], info

    def _observation(self, actor: Any) -> Any:
        return self.functional.gym_observation(actor)


def _key(seed: int) -> np.ndarray:
    """A random key of JAX for a seed of any size, (2,)."""
    return np.random.SeedSequence(seed).generate_state(2, np.uint32)


def _privileged(obs: Mapping[str, Any]) -> dict[str, Any]:
    return {"privileged": obs["privileged_state"]}


def _on_device(array: Any) -> jax.Array:
    """An array of JAX, of another library on its device, or of NumPy, as float32 of JAX."""
    if not isinstance(array, jax.Array | np.ndarray) and hasattr(array, "__dlpack__"):
        array = jnp.from_dlpack(array)
    return jnp.asarray(array, dtype=jnp.float32)
