"""Pictures of a robot: drawn off screen, or shown in a window."""

from __future__ import annotations

import time

import mujoco
import mujoco.viewer
import numpy as np

from asimov_gym.rendering.offscreen import OffscreenRenderer, RenderError, is_headless

_MARKER_RADIUS = 0.06
_MARKER_COLOUR = np.array([0.95, 0.55, 0.10, 0.8], dtype=np.float32)


class OffscreenCamera:
    """Draws pictures of one robot after another from a named camera.

    Args:
        model: the robot and its surroundings.
        camera: name of the camera.
        width: of the picture, pixels.
        height: of the picture, pixels.

    Raises:
        RenderError: no off-screen renderer works here.
    """

    def __init__(self, model: mujoco.MjModel, camera: str, width: int, height: int) -> None:
        self._camera = camera
        self._renderer = OffscreenRenderer(model, width, height)

    def picture(self, qpos: np.ndarray, markers: np.ndarray) -> np.ndarray:
        """A picture, (height, width, 3) uint8.

        Args:
            qpos: generalised positions of the robot, (nq,).
            markers: points to show, world frame, (M, 3).
        """
        return self._renderer.draw(qpos, self._camera, decorate=lambda scene: _draw_markers(scene, markers))

    def close(self) -> None:
        """Free the graphics memory."""
        self._renderer.close()


_CLOSING_S = 2.0
"""Longest wait for a window to close, s."""


class Window:
    """Shows one robot in a window of MuJoCo's viewer, no faster than in real time.

    Args:
        model: the robot and its surroundings.
        period: simulated time between two pictures, s.

    Raises:
        RenderError: no window can be opened here.
    """

    def __init__(self, model: mujoco.MjModel, period: float) -> None:
        if is_headless():
            raise RenderError(
                "there is no display to open a window on (DISPLAY and WAYLAND_DISPLAY are unset): "
                "run on a desktop, or use render_mode='rgb_array'"
            )
        self._model, self._data, self._period = model, mujoco.MjData(model), period
        self._next = 0.0
        try:
            self._viewer = mujoco.viewer.launch_passive(model, self._data, show_left_ui=False, show_right_ui=False)
        except Exception as error:  # on macOS the script must run under mjpython; the error says so
            raise RenderError(f"the window cannot be opened: {error}; or use render_mode='rgb_array'") from error

    def show(self, qpos: np.ndarray, markers: np.ndarray) -> None:
        """Show the robot at generalised positions (nq,), with markers (M, 3), unless the window was closed."""
        if not self._viewer.is_running():
            return
        with self._viewer.lock():
            self._data.qpos[:] = qpos
            mujoco.mj_forward(self._model, self._data)
            scene = self._viewer.user_scn
            if scene is not None:
                scene.ngeom = 0
                _draw_markers(scene, markers)
        self._viewer.sync()
        now = time.perf_counter()
        time.sleep(min(self._period, max(0.0, self._next - now)))
        self._next = max(now, self._next) + self._period

    def close(self) -> None:
        """Close the window, and give its thread a moment to finish: it must not draw while the process ends."""
        self._viewer.close()
        deadline = time.perf_counter() + _CLOSING_S
        while self._viewer.is_running() and time.perf_counter() < deadline:
            time.sleep(0.01)


def _draw_markers(scene: mujoco.MjvScene, markers: np.ndarray) -> None:
    """Add a ball at each point to a scene, as far as it has room."""
    size, turn = np.full(3, _MARKER_RADIUS), np.eye(3).ravel()
    for point in markers[: scene.maxgeom - scene.ngeom]:
        geom = scene.geoms[scene.ngeom]
        mujoco.mjv_initGeom(geom, mujoco.mjtGeom.mjGEOM_SPHERE, size, np.asarray(point, float), turn, _MARKER_COLOUR)
        scene.ngeom += 1
