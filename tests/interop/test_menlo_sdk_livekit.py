"""The robot's public Python client, `menlo-sdk` 0.1.0, unmodified and in a process of its own, in a room."""

from __future__ import annotations

import contextlib
import time
import wave
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from asimov_gym.edge import Client, Dialect, SimulatedRobot, Verdict
from asimov_gym.edge.transports.livekit import LiveKitLane, Media
from asimov_gym.firmware import State, WallClock
from tests.interop import sdk_environment
from tests.interop.test_menlo_sdk import FALL_FLAGS, POLICY, Bench, Sdk
from tests.network_namespace import in_namespace

ROBOT = {"can_update_own_metadata": True}


@pytest.fixture(scope="module", autouse=True)
def environment() -> None:
    """The client's environment, made if need be (some ten seconds, once)."""
    reason = sdk_environment.make()
    if reason is not None:
        pytest.skip(reason)


class Stage:
    """A robot in real time, in a room with the client's process beside it."""

    def __init__(self, robot: SimulatedRobot, room: Any, sdk: Sdk) -> None:
        self.robot, self.room, self.sdk = robot, room, sdk
        self.streamed = 0
        """Commands that came on the client's data track."""
        receive = robot.edge.receive

        def count(packet: bytes, client: Client, streamed: bool = False) -> Verdict:
            self.streamed += streamed
            return receive(packet, client, streamed)

        robot.edge.receive = count  # type: ignore[method-assign]

    def connect(self, token: str | None = None) -> dict[str, Any]:
        token = token or self.room.token(None, "sdk")
        return self.sdk("connect_livekit", url=self.room.url, room="robot-sim", token=token, media_timeout=0.2)

    def until(self, condition: Callable[[], Any], timeout: float = 10.0) -> float:
        began = time.monotonic()
        while not condition():
            assert time.monotonic() - began < timeout, f"not within {timeout} s; {self.robot.firmware.state.value}"
            time.sleep(0.005)
        return time.monotonic() - began


@contextlib.contextmanager
def stage(dialects: tuple[Dialect, ...] = (Dialect.IO,)) -> Iterator[Stage]:
    from asimov_gym.room import RoomThread

    with (
        RoomThread() as room,
        SimulatedRobot(POLICY, clock=WallClock()) as robot,
        LiveKitLane(robot.edge, room.url, room.token(None, "robot", **ROBOT), dialects),
    ):
        sdk = Sdk()
        try:
            yield Stage(robot, room, sdk)
        finally:
            sdk.end()


@in_namespace(timeout=60)
def test_quick_round_in_a_room() -> None:
    """Connect, read, stand, balance, walk a little on the data track, damp; beside a client of the other dialect."""
    with stage((Dialect.IO, Dialect.CLOUD)) as scene:
        sdk = scene.sdk
        assert scene.connect()["dof"] == 25
        state = sdk("state")
        assert state["protocol_version"] == 1 and state["upright"] and state["names"][23:] == ["Neck_Yaw", "Neck_Pitch"]
        assert abs(state["edge_timestamp_us"] - time.time_ns() // 1000) < 2_000_000
        sdk("stand")
        sdk("balance")
        sdk("set_velocity", vx=0.2, duration=1.0)
        assert scene.robot.firmware.state is State.POLICY
        scene.until(lambda: not scene.robot.firmware.snapshot.velocity.any())
        assert scene.streamed >= 5
        sdk("damp")
        sdk("close")
        scene.until(lambda: scene.robot.edge.control.holder is None)
        assert scene.robot.edge.tally.dropped == {}


@pytest.mark.slow
@in_namespace(timeout=120)
def test_joints_faults_restart_and_leaving() -> None:
    with stage() as scene:
        sdk, robot = scene.sdk, scene.robot
        scene.connect()
        stream = sdk("stream")
        sdk("wait_for", seconds=2.0)
        stream = sdk("stream")
        gaps = np.diff(stream["times"])
        assert 0.05 < np.median(gaps) < 0.15 and gaps.max() < 0.25
        assert (np.diff(stream["sequences"]) >= 1).all() and (np.diff(stream["clocks"]) > 0).all()

        sdk("stand")
        robot.firmware.gantry.by_hand("hoist")
        sdk("wait_for", seconds=2.5)
        state = sdk("state")
        names, target = state["names"], list(state["positions"])
        for name, change in (("L_Shoulder_Pitch", 0.4), ("R_Elbow", -0.3), ("Neck_Yaw", 0.3), ("Neck_Pitch", -0.2)):
            target[names.index(name)] += change
        before = scene.streamed
        sdk("set_joints", positions=target, duration=1.0, timeout=8.0)
        assert np.abs(np.array(sdk("state")["positions"]) - target).max() <= 0.06
        assert robot.firmware.state is State.TRAJECTORY and scene.streamed > before + 20
        sdk("trajectory", positions=target)
        assert 1.5 < scene.until(lambda: robot.firmware.state is State.DAMP) < 3.0
        robot.firmware.gantry.by_hand("auto")
        scene.until(lambda: sdk("state")["mode"] == "DAMP")

        sdk("stand")
        robot.firmware.faults.raise_alert("FALL_DETECTED")
        scene.until(lambda: sdk("state")["faulted"])
        state = sdk("state")
        assert state["error_flags"] == FALL_FLAGS and "FALL_DETECTED" in state["alerts"]
        reply = sdk.outcome("stand")
        assert reply["error"] == "RobotFaultedError" and "FALL_DETECTED" in reply["message"]
        robot.firmware.faults.clear()
        robot.restart()
        scene.until(lambda: not sdk("state")["faulted"])
        assert any("the firmware restarted" in line for line in sdk("history")["log"])

        sdk("stand")
        sdk("balance")
        sdk("set_velocity", vx=0.2, wait=False)
        scene.until(lambda: robot.firmware.snapshot.velocity.any())
        sdk.kill()  # no farewell: the room finds out
        scene.until(lambda: not robot.firmware.snapshot.velocity.any(), timeout=40.0)
        assert robot.firmware.state is State.POLICY and robot.edge.control.holder is None


@pytest.mark.slow
@in_namespace(timeout=60)
def test_an_observer_sees_and_does_not_drive() -> None:
    with stage() as scene:
        scene.connect(scene.room.token(None, "sdk", can_publish_data=False))
        assert scene.sdk("state")["mode"] == "DAMP"
        assert "error" in scene.sdk.outcome("stand")
        assert scene.robot.edge.tally.packets == 0


@pytest.mark.slow
@in_namespace(timeout=120)
def test_hybrid_drives_over_udp_and_sees_hears_and_speaks_through_the_room(tmp_path: Path) -> None:
    from asimov_gym.edge.media import CameraConfig, Microphone, SpeakerFile, Tone, VideoSource
    from asimov_gym.rendering.offscreen import RenderError
    from asimov_gym.room import RoomThread

    with RoomThread() as room, Bench() as bench:
        robot = bench.robot
        speaker = SpeakerFile(tmp_path / "speaker.wav")
        video = VideoSource(robot, CameraConfig(("first_person",), width=320, height=180, fps=10))
        try:
            video.start()
        except RenderError as problem:
            pytest.skip(str(problem))
        microphone = Microphone(Tone(440.0, level=0.5), robot.clock)
        sdk = Sdk()
        try:
            assert video.wait_ready(30.0)
            with (
                microphone,
                LiveKitLane(
                    robot.edge, room.url, room.token(None, "robot", **ROBOT), media=Media(video, microphone, speaker)
                ),
            ):
                manager = room.token_url.removesuffix("/api/livekit/token")
                sdk("connect_hybrid", manager=manager, credential=room.server.keys.credential, **bench.ports)
                sdk("stand")
                found = sdk("look_and_listen", seconds=2.0)
                assert found["size"] == [320, 180] and found["pictures"] >= 3 and found["colours"] > 5
                assert found["channels"] == 1 and found["seconds_of_sound"] > 1.0
                assert found["loudest"] == pytest.approx(16_383, rel=0.2)
                sdk("speak", seconds=1.5, level=8000)
                sdk("damp")
                sdk("close")
        finally:
            sdk.end()
            video.stop()
            speaker.close()
    with wave.open(str(tmp_path / "speaker.wav")) as file:
        sound = np.frombuffer(file.readframes(file.getnframes()), np.int16)
    assert np.abs(sound).max() > 4000
