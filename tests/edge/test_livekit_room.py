"""Robot and client in a room of the development server, through the real client library."""

from __future__ import annotations

import asyncio
import logging
import time
import wave
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from asimov_gym.edge import Dialect, Session, SimulatedRobot, connect
from asimov_gym.edge.facts import facts
from asimov_gym.edge.transports import TransportError
from asimov_gym.edge.transports.livekit import LiveKitLane, Media
from asimov_gym.edge.wire import cloud_pb2
from asimov_gym.firmware import State, WallClock
from tests.edge.conftest import StandInPolicy
from tests.network_namespace import in_namespace

ROBOT = {"can_update_own_metadata": True}


def until(condition: Callable[[], Any], timeout: float = 15.0) -> float:
    began = time.monotonic()
    while not condition():
        assert time.monotonic() - began < timeout, f"it did not happen within {timeout} s"
        time.sleep(0.01)
    return time.monotonic() - began


def work(robot: SimulatedRobot, session: Session) -> None:
    """Every verb, and its effect."""
    session.stand()
    until(lambda: session.state.get().fw_mode == cloud_pb2.FW_MODE_STAND)
    time.sleep(0.7)
    session.velocity(0.1)
    until(lambda: robot.firmware.state is State.POLICY)
    before = robot.edge.tally.accepted["trajectory"]
    until(lambda: session.state.get().fw_mode == cloud_pb2.FW_MODE_MOVE)
    for _ in range(10):
        session.trajectory(list(session.state.get().joint_pos))
        time.sleep(0.02)
    until(lambda: robot.edge.tally.accepted["trajectory"] >= before + 9)  # on a data track one may be lost
    session.damp()
    until(lambda: session.state.get().fw_mode == cloud_pb2.FW_MODE_DAMP)


@in_namespace(timeout=120)
def test_clients_of_both_dialects_drive_the_robot() -> None:
    from asimov_gym.room import RoomThread

    with RoomThread() as room, SimulatedRobot(StandInPolicy(), clock=WallClock(), gantry="hold") as robot:
        both = (Dialect.CLOUD, Dialect.IO)
        with LiveKitLane(robot.edge, room.url, room.token(None, "robot", **ROBOT), both) as lane:
            assert "room 'robot-sim'" in lane.connect_line and robot.edge.lanes.cloud_connected
            for dialect in both:
                with connect(room.url, token=room.token(None, f"client-{dialect.value}"), dialect=dialect) as session:
                    assert session.facts == facts()
                    work(robot, session)
                    assert abs(session.state.get().timestamp_us - robot.clock.realtime_us()) < 1_000_000
                    if dialect is Dialect.CLOUD:
                        codes = [event.error.code for event in session.events(timeout=0.3)]
                        assert codes.count("mode_change") >= 3
                until(lambda: robot.edge.control.holder is None)
            assert set(robot.edge.tally.dropped) == set()
            with connect(room.url, token=room.token(None, "watcher", can_publish_data=False)) as watcher:
                assert watcher.facts is None
                watcher.state.wait(2.0)
                with pytest.raises(ConnectionError, match="canPublishData"):
                    watcher.damp()


@in_namespace(timeout=120)
def test_refusals_are_one_line() -> None:
    from asimov_gym.room import RoomThread

    logging.getLogger().setLevel(logging.DEBUG)
    robot = SimulatedRobot()
    with RoomThread() as room, RoomThread() as other:
        foreign = other.token(None, "robot")
        with pytest.raises(TransportError, match="refuses the token"):
            LiveKitLane(robot.edge, room.url, foreign).start()
        with pytest.raises(ConnectionError, match="refuses the token"):
            connect(room.url, token=foreign)
        silent = room.token(None, "robot", can_publish_data=False)
        with pytest.raises(TransportError, match="needs canPublish and canPublishData"):
            LiveKitLane(robot.edge, room.url, silent).start()
        with pytest.raises(ConnectionError, match="no robot in the room 'robot-sim'"):
            connect(room.url, token=room.token(None, "client"), timeout=0.3)
        url, token = room.url, room.token(None, "robot")
    with pytest.raises(TransportError, match="nothing listens there") as raised:
        LiveKitLane(robot.edge, url, token).start()
    assert token not in str(raised.value)
    assert not robot.edge.lanes.cloud_connected


@pytest.mark.slow
@in_namespace(timeout=180)
def test_a_room_that_restarts_gets_its_robot_and_client_back() -> None:
    """A short absence is mended by the client library, after a long one the robot joins anew."""
    from asimov_gym.room import RoomThread

    with RoomThread() as room, SimulatedRobot(StandInPolicy(), clock=WallClock(), gantry="hold") as robot:
        both = (Dialect.CLOUD, Dialect.IO)
        with LiveKitLane(robot.edge, room.url, room.token(None, "robot", **ROBOT), both) as lane:
            for dialect in both:
                with connect(room.url, token=room.token(None, "client"), dialect=dialect) as session:
                    work(robot, session)
                    session.stand()
                    until(lambda: robot.firmware.state is State.STAND)
                    time.sleep(0.7)
                    session.velocity(0.1)
                    until(lambda: robot.firmware.snapshot.velocity.any())
                    room.stop()
                    until(lambda: not robot.firmware.snapshot.velocity.any())
                    until(lambda: not lane.connected and robot.edge.control.holder is None)
                    time.sleep(1.0)
                    room.start()
                    until(lambda: lane.connected, timeout=30.0)
                    until(lambda: session.state.age < 0.3, timeout=30.0)
                    until(lambda: not refused(session.damp), timeout=30.0)
                    work(robot, session)
            joined = lane.joined
            room.stop()
            time.sleep(25.0)
            room.start()
            until(lambda: lane.connected, timeout=40.0)
            assert lane.joined > joined
            with connect(room.url, token=room.token(None, "client")) as session:
                work(robot, session)


def refused(verb: Callable[[], object]) -> bool:
    try:
        verb()
    except ConnectionError:
        return True
    return False


@pytest.mark.slow
@in_namespace(timeout=120)
def test_pictures_and_sound_both_ways(tmp_path: Path) -> None:
    """Small pictures: what is tested is the way they take, not the machine."""
    from livekit import rtc

    from asimov_gym.edge.media import CameraConfig, Microphone, SpeakerFile, Tone, VideoSource
    from asimov_gym.rendering.offscreen import RenderError
    from asimov_gym.room import RoomThread

    seen: dict[str, list[np.ndarray]] = {}
    heard: list[np.ndarray] = []

    async def client(room: RoomThread) -> None:
        member, tasks = rtc.Room(), []

        async def watch(track: Any, name: str) -> None:
            async for event in rtc.VideoStream(track, format=rtc.VideoBufferType.RGB24):
                pixels = np.frombuffer(event.frame.data, np.uint8).reshape(event.frame.height, event.frame.width, 3)
                seen.setdefault(name, []).append(pixels)

        async def listen(track: Any) -> None:
            async for event in rtc.AudioStream(track, sample_rate=48_000, num_channels=1):
                heard.append(np.frombuffer(event.frame.data, np.int16).copy())

        def on_subscribed(track: Any, publication: Any) -> None:
            video = track.kind == rtc.TrackKind.KIND_VIDEO
            tasks.append(asyncio.create_task(watch(track, publication.name) if video else listen(track)))

        member.on("track_subscribed", on_subscribed)
        await member.connect(room.url, room.token(None, "client"))
        source, tone = rtc.AudioSource(48_000, 1, 200), Tone(880.0)
        voice = rtc.LocalAudioTrack.create_audio_track("menlo-sdk-speaker", source)
        await member.local_participant.publish_track(voice)
        end, start = time.monotonic() + 30.0, 0
        while time.monotonic() < end and (len(heard) < 200 or min(map(len, seen.values()), default=0) < 10):
            await source.capture_frame(rtc.AudioFrame(tone.samples(start, 480).tobytes(), 48_000, 1, 480))
            start += 480
        await member.disconnect()

    robot = SimulatedRobot(clock=WallClock())
    speaker = SpeakerFile(tmp_path / "speaker.wav")
    video = VideoSource(robot, CameraConfig(width=320, height=180, fps=10))
    microphone = Microphone(Tone(440.0), robot.clock)
    try:
        video.start()
    except RenderError as problem:
        pytest.skip(str(problem))
    with RoomThread() as room, robot, microphone:
        assert video.wait_ready(30.0)
        media = Media(video, microphone, speaker)
        with LiveKitLane(robot.edge, room.url, room.token(None, "robot", **ROBOT), media=media):
            asyncio.run(client(room))
            sample = cloud_pb2.EdgeTelemetry.FromString(robot.edge.latest)
            for sent_us in (sample.last_video_timestamp_us, sample.last_audio_timestamp_us):
                assert 0 <= robot.clock.realtime_us() - sent_us < 2_000_000
            assert robot.edge.lanes.camera_active and robot.edge.lanes.mic_active
        assert not robot.edge.lanes.camera_active and not robot.edge.lanes.mic_active
    video.stop()
    speaker.close()
    assert set(seen) == {"first_person", "third_person"}
    for pictures in seen.values():
        assert pictures[-1].shape == (180, 320, 3) and pictures[-1].std() > 5.0
    assert np.abs(seen["first_person"][-1].astype(int) - seen["third_person"][-1].astype(int)).mean() > 5.0
    assert pitch(np.concatenate(heard)[48_000:]) == pytest.approx(440.0, abs=2.0)
    with wave.open(str(tmp_path / "speaker.wav")) as file:
        assert pitch(np.frombuffer(file.readframes(file.getnframes()), np.int16)[48_000:]) == pytest.approx(880, abs=2)


def pitch(samples: np.ndarray) -> float:
    """Frequency of the strongest tone, Hz."""
    spectrum = np.abs(np.fft.rfft(samples * np.hanning(len(samples))))
    return float(np.argmax(spectrum)) * 48_000 / len(samples)
