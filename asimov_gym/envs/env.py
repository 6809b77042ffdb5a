"""One robot as a Gymnasium environment: any batch of one, with rendering."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np

from asimov_gym.envs.batch import EnvBatch, check_action, check_options, row
from asimov_gym.envs.camera import OffscreenCamera, Window
from asimov_gym.rendering.offscreen import check_camera

_ALL = np.ones(1, dtype=bool)


class RobotEnv(gym.Env[Any, np.ndarray]):
    """Base of the environments; each subclass says what its task is.

    Args:
        batch: a batch of one robot.
        render_mode: `human` (a window, updated by every step), `rgb_array`, or None.
        camera: camera of `rgb_array` pictures: `third_person`, `first_person`, `side` or `front`.
        width: of `rgb_array` pictures, pixels.
        height: of `rgb_array` pictures, pixels.

    Raises:
        ValueError: an argument is out of its range; names it.
    """

    metadata: dict[str, Any] = {"render_modes": ["human", "rgb_array"], "render_fps": 50}  # noqa: RUF012

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
        self._window: Window | None = None
        self._seeded = False
        self.observation_space = batch.observation_space
        self.action_space = batch.action_space

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode.

        Args:
            seed: everything random of this and the following episodes follows from it.
            options: see the class; unknown names are refused.

        Raises:
            ValueError: an unknown option, or one with a wrong value.
        """
        options_ = check_options(options, self._batch.option_names)
        super().reset(seed=seed)
        if seed is not None or not self._seeded:
            self._batch.seed([int(self.np_random.integers(2**63)) if seed is None else seed])
            self._seeded = True
        observation, info = self._batch.restart(_ALL, options_)
        if self.render_mode == "human":
            self.render()
        return row(observation, 0), row(info, 0)

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """One control step; see the class.

        Raises:
            ValueError: the action has a wrong shape or an entry that is not finite.
            gymnasium.error.ResetNeeded: `reset` has never been called.
        """
        if not self._seeded:
            raise gym.error.ResetNeeded("call reset() before the first step()")
        s = self._batch.step(check_action(action, self.action_space.shape or ())[None])
        if self.render_mode == "human":
            self.render()
        return row(s.observation, 0), float(s.reward[0]), bool(s.terminated[0]), bool(s.truncated[0]), row(s.info, 0)

    def render(self) -> np.ndarray | None:  # type: ignore[override]
        """The present picture, (height, width, 3) uint8; in mode `human` it goes to the window and None returns.

        Raises:
            asimov_gym.rendering.offscreen.RenderError: nothing can be drawn here; says what to do.
        """
        model, qpos, markers = self._batch.physics.model, self._batch.physics.state().qpos[0], self._batch.markers(0)
        if self.render_mode == "human":
            if self._window is None:
                self._window = Window(model, 1.0 / self.metadata["render_fps"])
            self._window.show(qpos, markers)
            return None
        if self.render_mode == "rgb_array":
            if self._offscreen is None:
                self._offscreen = OffscreenCamera(model, *self._picture)
            return self._offscreen.picture(qpos, markers)
        gym.logger.warn(f"render() does nothing without a render_mode; the modes are {self.metadata['render_modes']}")
        return None

    def close(self) -> None:
        """Close window, renderer and physics."""
        for drawing in (self._window, self._offscreen):
            if drawing is not None:
                drawing.close()
        self._window = self._offscreen = None
        self._batch.close()


def check_render_mode(render_mode: str | None, known: list[str]) -> str | None:
    """Raise ValueError unless the mode is None or known."""
    if render_mode is not None and render_mode not in known:
        raise ValueError(f"render_mode must be None or one of {', '.join(known)}, got {render_mode!r}")
    return render_mode


def check_size(name: str, value: int) -> int:
    """Raise ValueError unless a picture's side is a whole number that the model's frame buffer can hold."""
    if isinstance(value, bool) or not isinstance(value, int) or not 16 <= value <= 1920:
        raise ValueError(f"{name} must be a whole number in [16, 1920], got {value!r}")
    return value
