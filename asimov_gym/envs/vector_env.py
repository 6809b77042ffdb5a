"""Many robots as a Gymnasium vector environment: any batch, on one thread pool, without a process for each robot."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector.utils import batch_space

from asimov_gym.envs.batch import EnvBatch, check_action, check_options, masked_info, replace_rows, row
from asimov_gym.envs.camera import OffscreenCamera
from asimov_gym.envs.env import check_render_mode, check_size
from asimov_gym.physics import ENGINES
from asimov_gym.rendering.offscreen import check_camera


class RobotVectorEnv(gym.vector.VectorEnv[Any, np.ndarray, np.ndarray]):
    """Base of the vector environments; the tasks are described with their single environments.

    An episode that ends is followed by the next one in the same step (`AutoresetMode.SAME_STEP`): the row of the
    observation is already the new episode's, and `info` holds the last observation and info of the old one under
    `final_obs` (an object array with an observation where `_final_obs`) and `final_info` (masked by `_final_info`).

    Args:
        batch: the robots.
        render_mode: `rgb_array`, or None.
        camera: camera of the pictures.
        width: of the pictures, pixels.
        height: of the pictures, pixels.

    Raises:
        ValueError: an argument is out of its range; names it.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012
        "render_modes": ["rgb_array"],
        "render_fps": 50,
        "autoreset_mode": gym.vector.AutoresetMode.SAME_STEP,
    }

    def __init__(
        self,
        batch: EnvBatch,
        render_mode: str | None = None,
        camera: str = "third_person",
        width: int = 640,
        height: int = 480,
    ) -> None:
        self._batch = batch
        self.render_mode = check_render_mode(render_mode, self.metadata["render_modes"])
        self._picture = (
            check_camera(batch.physics.model, camera),
            check_size("width", width),
            check_size("height", height),
        )
        self._offscreen: OffscreenCamera | None = None
        self._seeded = False
        self.num_envs = batch.copies
        self.single_observation_space = batch.observation_space
        self.single_action_space = batch.action_space
        self.observation_space = batch_space(batch.observation_space, self.num_envs)
        self.action_space = batch_space(batch.action_space, self.num_envs)

    def reset(  # type: ignore[override]
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start an episode of every copy.

        Args:
            seed: copy i behaves as a single environment with `seed[i]`, or with `seed + i` where one number is given.
            options: as of the single environment, for all copies.

        Raises:
            ValueError: the number of seeds is not that of the copies; an unknown option or one with a wrong value.
        """
        options_ = check_options(options, self._batch.option_names)
        super().reset(seed=seed if seed is None or isinstance(seed, int) else None)
        if seed is not None or not self._seeded:
            self._batch.seed(seeds_of_copies(seed, self.num_envs, self.np_random))
            self._seeded = True
        everyone = np.ones(self.num_envs, dtype=bool)
        observation, info = self._batch.restart(everyone, options_)
        return observation, masked_info([(everyone, info)])

    def step(self, actions: np.ndarray) -> tuple[Any, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """One control step of every copy.

        Raises:
            ValueError: the actions have a wrong shape or an entry that is not finite.
            gymnasium.error.ResetNeeded: `reset` has never been called.
        """
        if not self._seeded:
            raise gym.error.ResetNeeded("call reset() before the first step()")
        s = self._batch.step(check_action(actions, self.action_space.shape or ()))
        done = s.terminated | s.truncated
        if not done.any():
            return s.observation, s.reward, s.terminated, s.truncated, masked_info([(~done, s.info)])
        fresh, fresh_info = self._batch.restart(done, {})
        info = masked_info([(~done, s.info), (done, fresh_info)])
        final = np.full(self.num_envs, None, dtype=object)
        for copy in np.flatnonzero(done):
            final[copy] = row(s.observation, int(copy))
        info["final_obs"], info["_final_obs"] = final, done
        info["final_info"], info["_final_info"] = masked_info([(done, s.info)]), done.copy()
        return replace_rows(s.observation, done, fresh), s.reward, s.terminated, s.truncated, info

    def render(self) -> tuple[np.ndarray, ...] | None:  # type: ignore[override]
        """A picture of each copy, (height, width, 3) uint8.

        Raises:
            asimov_gym.rendering.offscreen.RenderError: nothing can be drawn here; says what to do.
        """
        if self.render_mode is None:
            gym.logger.warn("render() does nothing without render_mode='rgb_array'")
            return None
        if self._offscreen is None:
            self._offscreen = OffscreenCamera(self._batch.physics.model, *self._picture)
        poses = self._batch.physics.state().qpos
        return tuple(self._offscreen.picture(poses[i], self._batch.markers(i)) for i in range(self.num_envs))

    def close_extras(self, **kwargs: Any) -> None:
        """Close renderer and physics."""
        if self._offscreen is not None:
            self._offscreen.close()
        self._batch.close()


def seeds_of_copies(seed: int | Sequence[int | None] | None, copies: int, rng: np.random.Generator) -> list[int]:
    """A seed for each copy, from what `reset` was given; those that were not given are drawn.

    Raises:
        ValueError: the number of seeds is not that of the copies.
    """
    if isinstance(seed, int | np.integer):
        return [int(seed) + i for i in range(copies)]
    given = [None] * copies if seed is None else list(seed)
    if len(given) != copies:
        raise ValueError(f"seed must be a number or {copies} of them, one for each copy, got {len(given)}")
    return [int(rng.integers(2**63)) if s is None else int(s) for s in given]


def check_engine(physics: str, arrays: str, arguments: dict[str, Any]) -> str:
    """The engine of a vector environment; takes what does nothing on MJX out of the other arguments.

    Raises:
        ValueError: the engine is unknown, or something is asked that it cannot do; says what can be done.
    """
    if physics not in ENGINES:
        raise ValueError(f"physics must be one of {', '.join(ENGINES)}, got {physics!r}")
    if physics == "c":
        if arrays != "numpy":
            raise ValueError(f"arrays must be 'numpy' with physics='c', got {arrays!r}")
        return physics
    if arguments.pop("render_mode", None) is not None:
        raise ValueError(f"render_mode must be None with physics={physics!r}: replay a state on physics='c' to see it")
    for name in ("camera", "width", "height", "threads"):
        arguments.pop(name, None)
    return physics


def check_c_physics(physics: str) -> None:
    """Raise ValueError unless the engine is C MuJoCo, on which alone single environments run."""
    if physics != "c":
        raise ValueError(
            f"physics must be 'c' here, got {physics!r}; 'mjx' and 'warp' step many robots at once: "
            "gym.make_vec(id, num_envs=N, physics='mjx')"
        )


def check_copies(num_envs: Any) -> int:
    """Raise ValueError unless the number of copies is a whole number of at least 1."""
    if isinstance(num_envs, bool) or not isinstance(num_envs, int | np.integer) or num_envs < 1:
        raise ValueError(f"num_envs must be a whole number of at least 1, got {num_envs!r}")
    return int(num_envs)
