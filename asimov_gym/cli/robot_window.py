"""A running robot in MuJoCo's window."""

from __future__ import annotations

import threading
from types import TracebackType
from typing import Any

import mujoco
import mujoco.viewer

from asimov_gym.cli.view import follow
from asimov_gym.edge import SimulatedRobot

CLOSING_S = 5.0
"""The window gets this long to close, s."""


class RobotWindow:
    """Shows a robot that runs elsewhere; the mouse turns the camera, and nothing in the window moves the robot.

    Args:
        robot: to show.

    Raises:
        RuntimeError: on entering, the viewer's own refusal, such as a missing launcher on macOS.
    """

    def __init__(self, robot: SimulatedRobot) -> None:
        self._robot = robot
        self._model = robot.physics.model
        self._data = mujoco.MjData(self._model)
        self._viewer: Any = None
        self._threads: set[threading.Thread] = set()

    def __enter__(self) -> RobotWindow:
        before = set(threading.enumerate())
        self._viewer = mujoco.viewer.launch_passive(self._model, self._data, show_left_ui=False, show_right_ui=False)
        started = set(threading.enumerate()) - before
        self._threads = {thread for thread in started if "_launch" in thread.name}  # not those of a lane beside it
        self._viewer.__enter__()
        follow(self._viewer, self._model)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._viewer.__exit__(kind, value, trace)
        # The viewer draws in a daemon thread. If the process ends first, it crashes on a window that is gone.
        for thread in self._threads:
            thread.join(CLOSING_S)

    @property
    def closed(self) -> bool:
        """Whether somebody has closed it."""
        return not self._viewer.is_running()

    def draw(self) -> None:
        """Show the robot as it is now."""
        with self._robot.edge.lock:
            self._data.qpos[:] = self._robot.physics.state().qpos[0]
        mujoco.mj_forward(self._model, self._data)
        self._viewer.sync()
