"""Pictures of a robot, drawn off screen."""

from __future__ import annotations

import copy
import os
import sys
from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np


class RenderError(RuntimeError):
    """Nothing can be drawn here; the message says what to do."""


@dataclass(frozen=True)
class Quality:
    """What a picture may cost. In software, at 1280 × 720, leaving out shadows drew 3 times as many pictures a second,
    and leaving out samples as well another 2.4 times.

    Raises:
        ValueError: `samples` is out of range.
    """

    shadows: bool = True
    reflections: bool = True
    samples: int | None = None
    """Samples per pixel that smooth edges, 0 to 16; None leaves it to the model."""

    def __post_init__(self) -> None:
        if self.samples is not None and not 0 <= self.samples <= 16:
            raise ValueError(f"samples must be from 0 to 16, got {self.samples}")


STILL = Quality()
"""For single pictures."""
FILM = Quality(shadows=False)
"""For videos that nobody waits for."""
LIVE = Quality(shadows=False, reflections=False, samples=0)
"""For cameras that have to keep up with the robot."""


def check_camera(model: mujoco.MjModel, name: str) -> str:
    """The name of a camera of the model.

    Raises:
        ValueError: no such camera; the message lists the known ones.
    """
    known = [model.camera(i).name for i in range(model.ncam)]
    if name not in known:
        raise ValueError(f"camera must be one of {', '.join(known)}, got {name!r}")
    return name


def is_headless() -> bool:
    """Whether this is a Linux session without a display."""
    return sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


class OffscreenRenderer:
    """Draws one robot at one configuration after another.

    Args:
        model: the robot and its surroundings. It is copied: pictures may be larger than its own frame buffer.
        width: of the pictures, pixels.
        height: of the pictures, pixels.
        quality: what a picture may cost.

    Raises:
        RenderError: no off-screen renderer works here.
    """

    def __init__(self, model: mujoco.MjModel, width: int, height: int, quality: Quality = STILL) -> None:
        backend = os.environ.get("MUJOCO_GL", "")
        way_out = (
            "set the environment variable MUJOCO_GL to egl (or osmesa) before Python starts; "
            "`asimov doctor` says which of them works here and what to install"
        )
        if not backend and is_headless():
            raise RenderError(f"there is no display to draw with: {way_out}")
        self.model = copy.copy(model)
        self.model.vis.global_.offwidth, self.model.vis.global_.offheight = width, height
        if quality.samples is not None:
            self.model.vis.quality.offsamples = quality.samples
        self._data = mujoco.MjData(self.model)
        try:
            self._renderer = mujoco.Renderer(self.model, height, width)
        except Exception as error:  # each backend raises its own kind
            raise RenderError(f"the renderer (MUJOCO_GL={backend!r}) does not work: {error}; {way_out}") from error
        flags = self._renderer.scene.flags
        flags[mujoco.mjtRndFlag.mjRND_SHADOW] = quality.shadows
        flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = quality.reflections

    def draw(
        self,
        qpos: np.ndarray,
        camera: str | mujoco.MjvCamera,
        out: np.ndarray | None = None,
        decorate: Callable[[mujoco.MjvScene], None] | None = None,
    ) -> np.ndarray:
        """A picture, (height, width, 3) uint8, red, green, blue; the first row is the upper one.

        Args:
            qpos: generalised positions of the robot, (nq,).
            camera: name of a camera of the model, or a free camera.
            out: array for the picture; a new one when None.
            decorate: called with the scene before it is drawn, to add things to it.
        """
        self._data.qpos[:] = qpos
        # What is seen depends on poses alone: no need for contacts and forces.
        mujoco.mj_kinematics(self.model, self._data)
        mujoco.mj_comPos(self.model, self._data)
        mujoco.mj_camlight(self.model, self._data)
        self._renderer.update_scene(self._data, camera)
        if decorate is not None:
            decorate(self._renderer.scene)
        return self._renderer.render(out=out)

    def close(self) -> None:
        """Free the graphics memory."""
        self._renderer.close()
