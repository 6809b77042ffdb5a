"""Video and sound of the public LiveKit client library in the room, in a network namespace of its own."""

from __future__ import annotations

import asyncio
import time
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

pytest.importorskip("asimov_gym.room", exc_type=ImportError)

from asimov_gym.room import RoomThread
from tests.network_namespace import in_namespace
from tests.room.meeting import RATE, clients, collect, until

if TYPE_CHECKING:
    from livekit import rtc


def tone(hertz: float, start: int, samples: int) -> np.ndarray:
    """A tone of 16-bit samples."""
    return (8000 * np.sin(2 * np.pi * hertz * (np.arange(samples) + start) / RATE)).astype(np.int16)


def pitch(frames: list[np.ndarray]) -> float:
    """The loudest frequency, Hz."""
    heard = np.concatenate(frames).astype(float)
    return float(np.argmax(np.abs(np.fft.rfft(heard * np.hanning(len(heard))))) * RATE / len(heard))


async def exchange_media(server: RoomThread, codec: str, simulcast: bool, seconds: float) -> dict[str, Any]:
    """A robot sends video and a tone of 440 Hz, an application a tone of 880 Hz; a third one comes later."""
    from livekit import rtc

    width, height = 1280, 720
    pictures: dict[str, list[tuple[int, int, float]]] = {"app": [], "late": []}
    sounds: dict[str, list[np.ndarray]] = {"app": [], "late": [], "robot": []}
    pumps: list[asyncio.Task[None]] = []

    def listen(name: str, client: rtc.Room) -> None:
        async def watch(track: rtc.Track) -> None:
            if track.kind == rtc.TrackKind.KIND_VIDEO:
                async for event in rtc.VideoStream(track):
                    luma = np.frombuffer(event.frame.data, np.uint8)[: event.frame.width * event.frame.height]
                    pictures[name].append((event.frame.width, event.frame.height, float(luma.mean())))
            else:
                async for event in rtc.AudioStream(track, sample_rate=RATE, num_channels=1):
                    sounds[name].append(np.frombuffer(event.frame.data, np.int16).copy())

        client.on("track_subscribed", lambda track, *_: pumps.append(asyncio.create_task(watch(track))))

    async def speak(client: rtc.Room, hertz: float) -> None:
        source = rtc.AudioSource(RATE, 1)
        track = rtc.LocalAudioTrack.create_audio_track("microphone", source)
        options = rtc.TrackPublishOptions(source=rtc.TrackSource.SOURCE_MICROPHONE)
        await client.local_participant.publish_track(track, options)

        async def pump() -> None:
            start = 0
            while True:
                data = tone(hertz, start, 480)
                await source.capture_frame(rtc.AudioFrame(data.tobytes(), RATE, 1, 480))
                start += 480

        pumps.append(asyncio.create_task(pump()))

    late = rtc.Room()
    async with clients(server, "robot", "app") as (robot, app):
        listen("app", app)
        listen("robot", robot)
        listen("late", late)
        camera = rtc.VideoSource(width, height)
        track = rtc.LocalVideoTrack.create_video_track("camera", camera)
        options = rtc.TrackPublishOptions(
            video_codec=getattr(rtc.VideoCodec, codec), simulcast=simulcast, source=rtc.TrackSource.SOURCE_CAMERA
        )
        await robot.local_participant.publish_track(track, options)
        await speak(robot, 440.0)
        await speak(app, 880.0)
        picture = np.full((height, width, 4), 255, np.uint8)
        start, sent = time.monotonic(), 0
        while (elapsed := time.monotonic() - start) < seconds:
            if elapsed > seconds / 2 and not late.isconnected():
                await late.connect(server.url, server.token(None, "late"))
            picture[..., :3] = 200
            picture[:, (sent * 8) % width :][:, :64, :3] = 20
            camera.capture_frame(rtc.VideoFrame(width, height, rtc.VideoBufferType.RGBA, picture.tobytes()))
            sent += 1
            await asyncio.sleep(max(0.0, start + sent / 30 - time.monotonic()))
        publication = next(
            p for p in app.remote_participants["robot"].track_publications.values() if p.name == "camera"
        )
        gone = collect(app, "track_unpublished")
        await robot.local_participant.unpublish_track(track.sid)
        await until(lambda: gone)
        assert gone[0][0].sid == publication.sid
        await late.disconnect()
        for task in pumps:
            task.cancel()
    return {"sent": sent, "pictures": pictures, "sounds": sounds, "mime": publication.mime_type}


def check_media(outcome: dict[str, Any], seconds: float) -> None:
    pictures, sounds, sent = outcome["pictures"], outcome["sounds"], outcome["sent"]
    assert len(pictures["app"]) > 0.75 * sent - 15
    assert len(pictures["late"]) > 0.25 * sent - 15
    for name in ("app", "late"):
        assert all(abs(w / h - 16 / 9) < 0.02 for w, h, _ in pictures[name])
        assert 170 < np.mean([luma for *_, luma in pictures[name]]) < 200
    assert pitch(sounds["app"][-50:]) == pytest.approx(440, abs=4)
    assert pitch(sounds["robot"][-50:]) == pytest.approx(880, abs=4)
    assert sum(map(len, sounds["app"])) > 0.6 * seconds * RATE


@in_namespace(timeout=40)
async def test_video_and_sound_are_forwarded() -> None:
    with RoomThread() as server:
        outcome = await exchange_media(server, "H264", simulcast=False, seconds=2.5)
    assert outcome["mime"].lower() == "video/h264"
    check_media(outcome, 2.5)


@pytest.mark.slow
@in_namespace(timeout=60)
async def test_of_simulcast_video_the_largest_layer_is_forwarded() -> None:
    with RoomThread() as server:
        outcome = await exchange_media(server, "VP8", simulcast=True, seconds=8.0)
    check_media(outcome, 8.0)
    assert max(width for width, *_ in outcome["pictures"]["app"]) >= 960
