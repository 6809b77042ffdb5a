"""The robot's cameras: pictures of what it does, with the time at which it did it."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable

import numpy as np

from asimov_gym.edge.events import Code
from asimov_gym.edge.robot import SimulatedRobot
from asimov_gym.edge.wire import cloud_pb2
from asimov_gym.rendering.camera_process import CameraConfig, CameraProcess, Frame
from asimov_gym.rendering.frame_tally import FrameCounts

_log = logging.getLogger(__name__)

SLOW_SHARE = 0.9
"""Cameras that reach less than this share of the asked rate are said to be slow, once."""
SLOW_CHECK_S = 5.0
"""How long the cameras have run when that is decided, s."""


class VideoSource:
    """Pictures from the cameras of a running robot, to be sent by whoever subscribes.

    The robot is never kept waiting: its pose is copied `fps` times a second of real time, and drawn in another process,
    as many times as the machine can. In lockstep the pictures show whatever the robot has come to.

    Args:
        robot: whose cameras these are.
        config: cameras, size and rate.
        backend: OpenGL backend; by default the first that works here.

    Raises:
        ValueError: the robot has no such camera.
    """

    def __init__(self, robot: SimulatedRobot, config: CameraConfig | None = None, backend: str | None = None) -> None:
        self.config = config or CameraConfig()
        self._robot = robot
        self._process = CameraProcess(robot.physics.model, self.config, self._hand_on, self._fail, backend)
        self._listeners: list[Callable[[Frame], None]] = []
        self._feed = PoseFeed(robot, self._process, self.config.fps)

    # -- clients -------------------------------------------------------------------------------------------------------

    def subscribe(self, on_frame: Callable[[Frame], None]) -> None:
        """Give every picture to a function from now on.

        It is called in one thread for all cameras; the pixels are valid during the call. While it takes its time,
        pictures are dropped. A transport reports to `edge.note_video` when it has sent one.
        """
        self._listeners = [*self._listeners, on_frame]

    def unsubscribe(self, on_frame: Callable[[Frame], None]) -> None:
        """Stop that; no effect if it was not subscribed."""
        self._listeners = [known for known in self._listeners if known != on_frame]

    def counts(self, camera: str) -> FrameCounts:
        """What became of the pictures of a camera so far."""
        return self._process.counts(camera)

    @property
    def error(self) -> str:
        """Why the cameras are off for good; empty if they are not."""
        return self._process.error

    # -- life ----------------------------------------------------------------------------------------------------------

    def start(self) -> None:
        """Switch the cameras on. The first picture comes a second or two later. They can be switched on once.

        Raises:
            asimov_gym.rendering.offscreen.RenderError: no OpenGL works here; says what to install.
        """
        self._process.start()
        self._feed.start()

    def wait_ready(self, timeout: float) -> bool:
        """Wait until the cameras draw; False after `timeout` seconds, or at once if they failed."""
        return self._process.wait_ready(timeout)

    def stop(self) -> None:
        """Switch the cameras off. No effect if they are."""
        self._feed.stop()
        self._process.stop()

    @property
    def running(self) -> bool:
        """Whether the cameras are on."""
        return self._process.running

    def __enter__(self) -> VideoSource:
        self.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self.stop()

    def _hand_on(self, frame: Frame) -> None:
        for listener in self._listeners:
            try:
                listener(frame)
            except Exception:  # a listener's fault must not blind the others
                _log.exception("a picture of %s could not be handed on", frame.camera)

    def _fail(self, reason: str) -> None:
        _log.error("the cameras are off: %s", reason)
        self._robot.edge.lanes.camera_active = False
        self._robot.edge.error(Code.CAMERA, f"the cameras are off: {reason}", cloud_pb2.SUBSYSTEM_CAMERA)


class PoseFeed:
    """Copies the robot's pose out of its physics at the rate of the cameras, in a thread of its own.

    A copy takes some ten microseconds under the edge's lock, 30 times a second: the 200 Hz loop does not notice.

    Args:
        robot: whose pose it is.
        cameras: where it goes.
        fps: poses per second of real time.
    """

    def __init__(self, robot: SimulatedRobot, cameras: CameraProcess, fps: int) -> None:
        self._robot, self._cameras = robot, cameras
        self._period = 1.0 / fps
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Begin. No effect if it has begun."""
        if self._thread is None:
            self._stop.clear()
            self._thread = threading.Thread(target=self._run, name="pose-feed", daemon=True)
            self._thread.start()

    def stop(self) -> None:
        """End. No effect if it has ended."""
        self._stop.set()
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join()
        self._thread = None

    def pose(self) -> tuple[np.ndarray, int]:
        """Generalised positions, (nq,), and the edge's wall clock when the robot was there, µs."""
        firmware, clock = self._robot.firmware, self._robot.clock
        with self._robot.edge.lock:
            qpos = self._robot.physics.state().qpos[0]
            age_us = max(0, firmware.now_us - firmware.snapshot.timestamp_us)
            return qpos, clock.realtime_us() - age_us

    def _run(self) -> None:
        while not self._cameras.wait_ready(0.1):
            if self._stop.is_set() or not self._cameras.running:
                return
        begin, number, judged = time.monotonic(), 0, False
        while not self._stop.wait(max(0.0, begin + number * self._period - time.monotonic())):
            if self._cameras.error:
                return
            missed = max(0, int((time.monotonic() - begin) / self._period) - number)
            self._cameras.post(*self.pose(), missed)
            number += 1 + missed
            if not judged and number * self._period > SLOW_CHECK_S:
                judged = True
                self._judge()

    def _judge(self) -> None:
        """Say which cameras are slow."""
        for camera in self._cameras.config.cameras:
            rate, asked = self._cameras.counts(camera).achieved_fps, self._cameras.config.fps
            if rate < SLOW_SHARE * asked:
                _log.warning("camera %s: %.0f of %d pictures per second; the rest is dropped", camera, rate, asked)
