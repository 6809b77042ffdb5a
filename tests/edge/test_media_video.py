"""The robot's cameras: the right picture with the right time, and a robot that is never kept waiting."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable

import numpy as np
import pytest

from asimov_gym.edge import SimulatedRobot
from asimov_gym.edge.events import Code
from asimov_gym.edge.listener import EdgeListener
from asimov_gym.edge.media import CameraConfig, Frame, VideoSource
from asimov_gym.edge.media.video import PoseFeed
from asimov_gym.edge.wire import cloud_pb2
from asimov_gym.firmware import MICROSECONDS, StepClock, WallClock
from asimov_gym.rendering.backends import headless_backend, install_line

SMALL = CameraConfig(cameras=("third_person",), width=160, height=96)
PATIENCE_S = 20.0


@pytest.fixture(scope="module")
def backend() -> str:
    found = headless_backend()
    if found is None:
        pytest.skip(install_line())
    return found


class Posted:
    """Stands where the camera process does, and keeps the poses."""

    config = SMALL
    error = ""
    running = True

    def __init__(self) -> None:
        self.poses: list[tuple[float, np.ndarray, int, int]] = []

    def wait_ready(self, timeout: float) -> bool:
        return True

    def post(self, qpos: np.ndarray, timestamp_us: int, missed: int = 0) -> None:
        self.poses.append((time.monotonic(), qpos, timestamp_us, missed))


class Events(EdgeListener):
    def __init__(self) -> None:
        self.errors: list[cloud_pb2.EdgeError] = []

    def on_event(self, timestamp_us: int, packet: bytes) -> None:
        event = cloud_pb2.EdgeEvent.FromString(packet)
        if event.HasField("error"):
            self.errors.append(event.error)


def wait_until(condition: Callable[[], object]) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline, "it never happened"
        time.sleep(0.005)


def test_picture_has_the_time_of_the_state_it_shows(make_robot: Callable[..., SimulatedRobot], backend: str) -> None:
    robot = make_robot()
    frames: list[tuple[int, np.ndarray]] = []

    def look(frame: Frame) -> None:
        frames.append((frame.timestamp_us, frame.rgb.copy()))

    def newest() -> int:
        return frames[-1][0] if frames else -1

    with VideoSource(robot, SMALL, backend) as video:
        video.subscribe(look)
        assert video.wait_ready(PATIENCE_S), video.error
        robot.advance(0.5)
        wait_until(lambda: newest() == StepClock.EPOCH_US + MICROSECONDS // 2)
        before = frames[-1][1]
        state = robot.physics.state()
        state.qpos[0, 3:7] = np.cos(0.4), 0.0, np.sin(0.4), 0.0
        robot.physics.set_state(state)
        robot.advance(0.005)
        wait_until(lambda: newest() == StepClock.EPOCH_US + MICROSECONDS // 2 + 5000)
        after = frames[-1][1]
        video.unsubscribe(look)
        counts = video.counts("third_person")
        assert counts.asked == counts.delivered + counts.dropped + counts.pending
        assert counts.delivered > 1
    assert before.mean() > 60.0
    assert np.abs(before.astype(float) - after).mean() > 1.0
    assert not video.running


def test_dead_cameras_make_one_event(make_robot: Callable[..., SimulatedRobot], backend: str) -> None:
    robot, events = make_robot(), Events()
    robot.edge.attach(events)
    with VideoSource(robot, SMALL, backend) as video:
        assert video.wait_ready(PATIENCE_S), video.error
        robot.edge.lanes.camera_active = True
        os.kill(video._process._process.pid, signal.SIGKILL)
        wait_until(lambda: events.errors)
        assert not robot.edge.lanes.camera_active
        robot.advance(0.1)  # the robot goes on
    told = [error for error in events.errors if error.code == Code.CAMERA.value]
    assert len(told) == 1
    assert told[0].subsystem == cloud_pb2.SUBSYSTEM_CAMERA
    assert "-9" in told[0].message
    assert video.error in told[0].message


def test_poses_come_at_the_camera_rate(make_robot: Callable[..., SimulatedRobot]) -> None:
    robot, posted = make_robot(clock=WallClock()), Posted()
    feed = PoseFeed(robot, posted, 50)
    with robot:
        feed.start()
        time.sleep(0.6)
        feed.stop()
        ended = time.time_ns() // 1000
    due = len(posted.poses) + sum(missed for *_, missed in posted.poses)
    assert due == pytest.approx(30, abs=3)
    times = [timestamp_us for _, _, timestamp_us, _ in posted.poses]
    assert times == sorted(times)
    assert 0 < ended - times[-1] < 200_000
    assert posted.poses[0][1].shape == (robot.physics.model.nq,)
    posted.poses[-1][1][:] = np.nan  # a copy: the robot does not notice
    assert np.isfinite(robot.physics.state().qpos).all()


def test_late_feed_owns_up_to_what_it_missed(make_robot: Callable[..., SimulatedRobot]) -> None:
    robot, posted = make_robot(), Posted()
    feed = PoseFeed(robot, posted, 50)
    feed.start()
    wait_until(lambda: len(posted.poses) > 3)
    with robot.edge.lock:  # a control loop that hangs for a fifth of a second
        time.sleep(0.2)
    seen = len(posted.poses)
    wait_until(lambda: len(posted.poses) > seen + 2)
    feed.stop()
    assert sum(missed for *_, missed in posted.poses) >= 7
