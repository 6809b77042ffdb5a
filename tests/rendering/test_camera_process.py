"""The camera process: true pictures, the newest wins, honest counts, and nothing left behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest

from asimov_gym.physics import compile_model
from asimov_gym.rendering import camera_process
from asimov_gym.rendering.backends import headless_backend, install_line
from asimov_gym.rendering.camera_process import CameraConfig, CameraProcess, Frame

SMALL = CameraConfig(width=160, height=96)
PATIENCE_S = 20.0

SCRIPTED = """
import sys, time
from asimov_gym.rendering import camera_worker, offscreen

class Renderer:
    '''Takes its time, and paints the first coordinate of the pose.'''

    def __init__(self, model, width, height, quality):
        pass

    def draw(self, qpos, camera, out=None):
        if out is not None:
            time.sleep({seconds})
            out[...] = int(qpos[0])

offscreen.OffscreenRenderer = Renderer
camera_worker.main()
"""


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return compile_model()


class Album:
    """Keeps copies of the pictures."""

    def __init__(self) -> None:
        self.frames: list[Frame] = []

    def __call__(self, frame: Frame) -> None:
        self.frames.append(Frame(frame.camera, frame.timestamp_us, frame.rgb.copy()))

    def times(self, camera: str) -> list[int]:
        return [frame.timestamp_us for frame in self.frames if frame.camera == camera]

    def last(self, camera: str) -> Frame:
        return [frame for frame in self.frames if frame.camera == camera][-1]


def wait_until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline, "it never happened"
        time.sleep(0.005)


def scripted(seconds: float) -> type[CameraProcess]:
    """A camera process that needs no OpenGL and `seconds` for each picture."""

    class Scripted(CameraProcess):
        command = (sys.executable, "-c", SCRIPTED.format(seconds=seconds))

    return Scripted


def pose(model: mujoco.MjModel, value: float) -> np.ndarray:
    qpos = model.key("stand").qpos.copy()
    qpos[0] = value
    return qpos


def test_pictures_show_the_pose_from_each_camera(model: mujoco.MjModel) -> None:
    backend = headless_backend()
    if backend is None:
        pytest.skip(install_line())
    stand = model.key("stand").qpos.copy()
    bowed = stand.copy()
    bowed[3:7] = np.cos(0.3), 0.0, np.sin(0.3), 0.0
    album, cameras = Album(), ("first_person", "third_person")
    with CameraProcess(model, SMALL, album, backend=backend) as process:
        assert process.wait_ready(PATIENCE_S), process.error
        for timestamp_us, qpos in ((1111, stand), (2222, bowed)):
            process.post(qpos, timestamp_us)
            wait_until(lambda: all(album.times(c)[-1:] == [timestamp_us] for c in cameras))  # noqa: B023, used at once
        assert process.counts("first_person").delivered == process.counts("third_person").delivered == 2
    pictures = {(frame.camera, frame.timestamp_us): frame.rgb.astype(float) for frame in album.frames}
    assert len(pictures) == 4
    for rgb in pictures.values():
        assert rgb.shape == (96, 160, 3)
        assert rgb.mean() > 60.0  # lit
        assert rgb[:20].mean() > rgb[-20:].mean()  # sky above, floor below
    third = pictures["third_person", 1111]
    assert third[35:60, 75:90].mean() < 0.6 * third[35:60, :40].mean()  # a dark robot in mid-picture
    for camera in cameras:
        assert np.abs(pictures[camera, 1111] - pictures[camera, 2222]).mean() > 2.0
    assert np.abs(pictures["first_person", 1111] - third).mean() > 5.0


def test_newest_pose_wins_and_the_rest_is_counted(model: mujoco.MjModel) -> None:
    album = Album()
    with scripted(0.02)(model, SMALL, album, backend="disable") as process:
        assert process.wait_ready(PATIENCE_S), process.error
        for number in range(100):
            process.post(pose(model, number), number, missed=1 if number == 50 else 0)
            time.sleep(0.002)
        wait_until(lambda: all(album.times(c)[-1:] == [99] for c in SMALL.cameras))
        for camera in SMALL.cameras:
            counts, times = process.counts(camera), album.times(camera)
            assert counts.asked == 101
            assert counts.pending == 0
            assert counts.delivered == len(times)
            assert counts.dropped == 101 - len(times)
            assert 2 <= len(times) < 60
            assert times == sorted(set(times))
    for frame in album.frames:
        assert (frame.rgb == frame.timestamp_us).all()  # the picture is that of its time


def test_slow_client_gets_fewer_pictures_and_new_ones(model: mujoco.MjModel) -> None:
    behind: list[int] = []
    torn: list[int] = []
    posted = [0]

    def look(frame: Frame) -> None:
        behind.append(posted[0] - frame.timestamp_us)
        before = frame.rgb.copy()
        time.sleep(0.05)
        if not (before == frame.timestamp_us).all() or not (frame.rgb == before).all():
            torn.append(frame.timestamp_us)
        if len(behind) == 2:
            raise RuntimeError("a client's mistake")

    one = CameraConfig(cameras=("side",), width=160, height=96)
    with scripted(0.0)(model, one, look, backend="disable") as process:
        assert process.wait_ready(PATIENCE_S), process.error
        for number in range(100):
            posted[0] = number
            process.post(pose(model, number), number)
            time.sleep(0.004)
        counts = process.counts("side")
    assert counts.dropped > 50
    assert counts.asked == counts.delivered + counts.dropped + counts.pending == 100
    assert not torn  # nobody paints over a picture while it is looked at
    assert len(behind) > 2  # the mistake cost nobody else a picture
    # Three slots: what is drawn while all are full waits for at most one look.
    assert max(behind) < 60


def test_posting_never_waits_for_a_hung_process(model: mujoco.MjModel, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(camera_process, "_STOP_S", 0.2)
    failures: list[str] = []
    process = scripted(3600.0)(model, SMALL, Album(), failures.append, backend="disable")
    process.start()
    assert process.wait_ready(PATIENCE_S), process.error
    began = time.perf_counter()
    for number in range(1000):
        process.post(pose(model, number), number)
    assert time.perf_counter() - began < 1.0
    assert process.counts("first_person").asked == process.counts("first_person").pending == 1000
    process.stop()
    assert not process.running
    assert not failures  # ended on request


def test_death_is_told_once(model: mujoco.MjModel) -> None:
    failures: list[str] = []
    with scripted(0.0)(model, SMALL, Album(), failures.append, backend="disable") as process:
        assert process.wait_ready(PATIENCE_S), process.error
        os.kill(process._process.pid, signal.SIGKILL)
        wait_until(lambda: bool(failures))
        process.post(pose(model, 0.0), 0)
        assert process.counts("first_person").asked == 0
        assert not process.running
        assert not process.wait_ready(1.0)
    assert failures == [process.error] == ["the camera process ended with -9"]


def test_broken_backend_is_told(model: mujoco.MjModel) -> None:
    failures: list[str] = []
    with CameraProcess(model, SMALL, Album(), failures.append, backend="no-such-backend") as process:
        assert not process.wait_ready(PATIENCE_S)
        wait_until(lambda: bool(failures))
    assert "no-such-backend" in process.error


@pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="needs /proc to see open files")
def test_nothing_is_left_behind(model: mujoco.MjModel) -> None:
    kind = scripted(0.0)

    def run() -> int:
        album = Album()
        with kind(model, SMALL, album, backend="disable") as process:
            assert process.wait_ready(PATIENCE_S), process.error
            process.post(pose(model, 1.0), 1)
            wait_until(lambda: bool(album.frames))
            return process._process.pid

    def mapped() -> int:
        return Path("/proc/self/maps").read_text().count("asimov-frames")

    run()  # what is opened once, stays
    files, threads = len(os.listdir("/proc/self/fd")), threading.active_count()
    pids = [run() for _ in range(3)]
    assert len(os.listdir("/proc/self/fd")) == files
    assert threading.active_count() == threads
    assert mapped() == 0
    assert not [pid for pid in pids if Path(f"/proc/{pid}").exists()]  # a zombie would still be listed


@pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="needs /proc to see processes")
def test_killed_robot_takes_its_camera_process_along() -> None:
    worker = SCRIPTED.format(seconds=0.0)
    robot = f"""
import os, signal, sys
from asimov_gym.physics import compile_model
from asimov_gym.rendering.camera_process import CameraConfig, CameraProcess
CameraProcess.command = (sys.executable, "-c", {worker!r})
process = CameraProcess(compile_model(), CameraConfig(width=160, height=96), print, backend="disable")
process.start()
assert process.wait_ready(20.0)
print(process._process.pid, flush=True)
os.kill(os.getpid(), signal.SIGKILL)
"""
    done = subprocess.run([sys.executable, "-c", robot], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == -signal.SIGKILL, done.stderr
    state = Path(f"/proc/{done.stdout.strip()}/stat")
    # Where nobody adopts orphans it stays listed as a zombie.
    wait_until(lambda: not state.exists() or state.read_text().rpartition(")")[2].split()[0] == "Z")


def test_wrong_arguments_are_named(model: mujoco.MjModel) -> None:
    for field, value, message in (
        ("width", 1281, "width must be an even number from 64 to 1920, got 1281"),
        ("height", 2000, "height must be an even number from 64 to 1080, got 2000"),
        ("fps", 0, "fps must be from 1 to 60, got 0"),
        ("cameras", ("side", "side"), "cameras must be 1 to 8 different names"),
        ("cameras", (), "cameras must be 1 to 8 different names"),
    ):
        with pytest.raises(ValueError, match=message):
            CameraConfig(**{field: value})
    with pytest.raises(ValueError, match=r"camera must be one of .*third_person.*, got 'roof'"):
        CameraProcess(model, CameraConfig(cameras=("roof",)), Album())
    with pytest.raises(ValueError, match="qpos must have shape"):
        CameraProcess(model, SMALL, Album()).post(np.zeros(3), 0)
