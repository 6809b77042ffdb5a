"""Live cameras, drawn in a process of their own.

Poses go in without waiting, pictures come out as fast as the machine draws them. The newest pose wins: what cannot be
drawn in time is dropped and counted.
"""

from __future__ import annotations

import logging
import os
import pickle
import select
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from typing import IO

import mujoco
import numpy as np

from asimov_gym.rendering.backends import environment, headless_backend, install_line
from asimov_gym.rendering.camera_worker import NOTICE, POSE_HEADER, READY, Job, pose_record
from asimov_gym.rendering.frame_ring import FrameRing, anonymous_file
from asimov_gym.rendering.frame_tally import FrameCounts, FrameTally
from asimov_gym.rendering.offscreen import RenderError, check_camera

_log = logging.getLogger(__name__)

_NOTICES_READ = 4096
_STOP_S = 3.0
"""Longest wait for the process to finish its picture and end, s."""


@dataclass(frozen=True)
class CameraConfig:
    """Which cameras, how large, how often.

    Raises:
        ValueError: a field is out of range; names the field, the value and the range.
    """

    cameras: tuple[str, ...] = ("first_person", "third_person")
    """Cameras of the model: 1 to 8 different ones."""
    width: int = 1280
    """Pixels, even, 64 to 1920."""
    height: int = 720
    """Pixels, even, 64 to 1080."""
    fps: int = 30
    """Pictures per second asked of each camera, 1 to 60. How many there are, the machine decides."""

    def __post_init__(self) -> None:
        if not 1 <= len(self.cameras) <= 8 or len(set(self.cameras)) != len(self.cameras):
            raise ValueError(f"cameras must be 1 to 8 different names, got {self.cameras}")
        for field, value, high in (("width", self.width, 1920), ("height", self.height, 1080)):
            if not 64 <= value <= high or value % 2:  # video codecs halve the colour planes
                raise ValueError(f"{field} must be an even number from 64 to {high}, got {value}")
        if not 1 <= self.fps <= 60:
            raise ValueError(f"fps must be from 1 to 60, got {self.fps}")


@dataclass(frozen=True)
class Frame:
    """One picture of one camera."""

    camera: str
    timestamp_us: int
    """When the robot was as shown, on the clock of whoever posted the pose."""
    rgb: np.ndarray
    """(height, width, 3) uint8, red, green, blue, read-only, contiguous. It lies in shared memory and is drawn over
    after the call that brought it: copy what is to be kept."""

    @property
    def width(self) -> int:
        return self.rgb.shape[1]

    @property
    def height(self) -> int:
        return self.rgb.shape[0]


class CameraProcess:
    """Draws what the cameras of a model see.

    Args:
        model: the robot and its surroundings.
        config: cameras, size and rate.
        on_frame: gets every picture, in a thread of this object. While it is slow, pictures are dropped.
        on_failure: told once, in one line, when the process died by itself; it stays dead. Same thread.
        backend: OpenGL backend; by default the first that works here.

    Raises:
        ValueError: the model has no such camera.
    """

    command = (sys.executable, "-m", "asimov_gym.rendering.camera_worker")
    """Starts the process that draws; its job is added as the last argument."""

    def __init__(
        self,
        model: mujoco.MjModel,
        config: CameraConfig,
        on_frame: Callable[[Frame], None],
        on_failure: Callable[[str], None] = lambda reason: None,
        backend: str | None = None,
    ) -> None:
        for camera in config.cameras:
            check_camera(model, camera)
        if (size := POSE_HEADER.size + 8 * model.nq) > select.PIPE_BUF:
            raise ValueError(f"a pose of {model.nq} numbers is {size} bytes, more than the {select.PIPE_BUF} of a pipe")
        self.config = config
        self.error = ""
        """Why the process died; empty if it did not."""
        self._model = model
        self._on_frame, self._on_failure = on_frame, on_failure
        self._backend = backend
        self._tallies = {camera: FrameTally() for camera in config.cameras}
        self._lock = threading.Lock()
        self._poses: int | None = None
        """Our end of the pipe of poses, until `stop`."""
        self._ready = threading.Event()
        self._sequence = 0
        self._process: subprocess.Popen[bytes] | None = None
        self._reader: threading.Thread | None = None

    # -- life ----------------------------------------------------------------------------------------------------------

    def start(self) -> None:
        """Start the process. It can draw a second or two later; see `wait_ready`.

        Raises:
            RenderError: no OpenGL works here; says what to install.
            RuntimeError: it was started before.
        """
        if self._process is not None:
            raise RuntimeError("the camera process was started before: make a new one")
        backend = self._backend or headless_backend()
        if backend is None:
            raise RenderError(install_line())
        c = self.config
        with ExitStack() as theirs, ExitStack() as ours:
            model_file, ring_file = anonymous_file(), anonymous_file()
            pose_end, poses = os.pipe()
            notices, notice_end = os.pipe()
            for file in (model_file, ring_file, pose_end, notice_end):
                theirs.callback(os.close, file)
            for file in (poses, notices):
                ours.callback(os.close, file)
            log = ours.enter_context(tempfile.TemporaryFile("w+"))
            with open(model_file, "wb", closefd=False) as file:
                pickle.dump(self._model, file)
            os.lseek(model_file, 0, os.SEEK_SET)
            os.set_blocking(poses, False)
            ring = FrameRing(ring_file, len(c.cameras), c.width, c.height)
            job = Job(c.cameras, c.width, c.height, model_file, ring_file, notice_end)
            self._process = subprocess.Popen(
                [*self.command, job.to_json()],
                env=environment(backend),
                stdin=pose_end,
                stdout=subprocess.DEVNULL,
                stderr=log,
                pass_fds=(model_file, ring_file, notice_end),
            )
            ours.pop_all()  # from here on `stop` and the reader close them
        self._poses = poses
        self._reader = threading.Thread(
            target=self._read, args=(self._process, notices, ring, log), name="camera-frames", daemon=True
        )
        self._reader.start()

    def wait_ready(self, timeout: float) -> bool:
        """Wait until pictures can be drawn; False after `timeout` seconds, or at once if the process died."""
        return self._ready.wait(timeout) and self.running

    def stop(self) -> None:
        """End the process and free everything. No effect if it does not run."""
        with self._lock:
            poses, self._poses = self._poses, None
        if poses is not None:
            os.close(poses)
        if self._process is None or self._reader is None:
            return
        try:
            self._process.wait(_STOP_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        if self._reader is not threading.current_thread():
            self._reader.join()

    @property
    def running(self) -> bool:
        """Whether the process lives."""
        return self._process is not None and self._process.poll() is None

    def __enter__(self) -> CameraProcess:
        self.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self.stop()

    # -- poses in ------------------------------------------------------------------------------------------------------

    def post(self, qpos: np.ndarray, timestamp_us: int, missed: int = 0) -> None:
        """Ask for a picture of every camera. Takes microseconds and never waits; no effect until the process is ready.

        Args:
            qpos: generalised positions, (nq,).
            timestamp_us: comes back with the pictures.
            missed: pictures that were due since the last call and for which there was no pose; counted as dropped.
        """
        if qpos.shape != (self._model.nq,):
            raise ValueError(f"qpos must have shape ({self._model.nq},), got {qpos.shape}")
        values = np.ascontiguousarray(qpos, dtype=np.float64).tobytes()
        with self._lock:
            if self._poses is None or not self._ready.is_set() or self.error:
                return
            self._sequence += missed
            for tally in self._tallies.values():
                tally.ask(1 + missed)
            # A full pipe or a dead process: this pose is lost, which its number tells.
            with suppress(BlockingIOError, BrokenPipeError):
                os.write(self._poses, pose_record(self._sequence, timestamp_us, values))
            self._sequence += 1

    # -- pictures out --------------------------------------------------------------------------------------------------

    def counts(self, camera: str) -> FrameCounts:
        """What became of the pictures of a camera so far."""
        with self._lock:
            return self._tallies[camera].counts()

    def _read(self, process: subprocess.Popen[bytes], notices: int, ring: FrameRing, log: IO[str]) -> None:
        """Bring the newest picture of each camera to `on_frame` until the process ends."""
        while records := os.read(notices, _NOTICES_READ * NOTICE.size):
            newest: dict[int, tuple[int, int, int]] = {}
            for sequence, timestamp_us, camera, slot in NOTICE.iter_unpack(records):
                if sequence == READY:
                    self._ready.set()
                    continue
                if camera in newest:
                    ring.release(camera, newest[camera][2])
                newest[camera] = sequence, timestamp_us, slot
            for camera, (sequence, timestamp_us, slot) in newest.items():
                self._deliver(ring.picture(camera, slot), self.config.cameras[camera], sequence, timestamp_us)
                ring.release(camera, slot)
        os.close(notices)
        self._end(process, log)

    def _deliver(self, picture: np.ndarray, camera: str, sequence: int, timestamp_us: int) -> None:
        rgb = picture.view()
        rgb.flags.writeable = False
        with self._lock:
            self._tallies[camera].deliver(sequence)
        try:
            self._on_frame(Frame(camera, timestamp_us, rgb))
        except Exception:  # a client's fault must not stop the pictures of the others
            _log.exception("a picture of %s could not be handed on", camera)

    def _end(self, process: subprocess.Popen[bytes], log: IO[str]) -> None:
        """The process has closed its pipe: find out why."""
        try:
            code = process.wait(_STOP_S)
        except subprocess.TimeoutExpired:
            process.kill()
            code = process.wait()
        with log:
            log.seek(0)
            lines = [line.strip() for line in log if line.strip()]
        with self._lock:
            asked_to = self._poses is None
            if not asked_to:
                self.error = lines[-1] if code > 0 and lines else f"the camera process ended with {code}"
        self._ready.set()  # nobody should go on waiting
        if not asked_to:
            self._on_failure(self.error)
