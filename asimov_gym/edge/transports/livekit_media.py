"""Pictures and sound in a room: the robot's cameras and microphone out, a client's voice to its speaker."""

from __future__ import annotations

import asyncio
import logging
from contextlib import suppress
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np

from asimov_gym.edge.edge import Edge
from asimov_gym.edge.events import Code
from asimov_gym.edge.media import SAMPLE_RATE, AudioFrame, Frame, Microphone, SpeakerFile, VideoSource
from asimov_gym.edge.transports.livekit_channels import MICROPHONE
from asimov_gym.edge.transports.livekit_join import hide_token
from asimov_gym.edge.wire import cloud_pb2

PUBLISH_TIMEOUT_S = 10.0
"""A room that relays no media may leave a publication without an answer."""
VIDEO_BITRATE = 1_700_000
"""Bit/s of a camera, at most: what the client library uses for 720p at 30 pictures per second."""
AUDIO_BACKLOG = 20
"""Frames of sound that may wait for the client library; what comes on top is dropped."""
AUDIO_QUEUE_MS = 200

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Media:
    """What the robot shows, hears and says in a room. Whoever makes the parts starts and stops them."""

    video: VideoSource | None = None
    """One track per camera, in the order of its configuration: clients take the first one."""
    microphone: Microphone | None = None
    speaker: SpeakerFile | None = None
    """Plays the first client that speaks, until its track ends."""


class RoomMedia:
    """The media of one stay in a room.

    Args:
        edge: is told the times of what was sent.
        media: sources and sink.
    """

    def __init__(self, edge: Edge, media: Media) -> None:
        self.dropped_audio = 0
        """Frames of sound that the client library did not take in time."""
        self._edge = edge
        self._media = media
        self._rtc: ModuleType | None = None
        self._cameras: dict[str, Any] = {}
        self._heard: asyncio.Queue[AudioFrame] = asyncio.Queue(AUDIO_BACKLOG)
        self._voice: tuple[str, asyncio.Task[None]] | None = None

    def listen(self, rtc: ModuleType, room: Any) -> None:
        """Set the room's handlers; before it is joined."""
        self._rtc = rtc
        if self._media.speaker is not None:
            room.on("track_published", self._on_published)
            room.on("track_subscribed", self._on_subscribed)
            room.on("track_unsubscribed", self._on_unsubscribed)

    async def serve(self, rtc: ModuleType, room: Any) -> None:
        """Publish, and send until cancelled. What the room does not take is left out, with one warning each."""
        loop = asyncio.get_running_loop()
        video, microphone = self._media.video, self._media.microphone

        def hear(frame: AudioFrame) -> None:
            with suppress(RuntimeError):  # the loop may end between two frames
                loop.call_soon_threadsafe(self._hear, frame)

        try:
            for participant in room.remote_participants.values():
                for publication in participant.track_publications.values():
                    self._on_published(publication)
            if video is not None and await self._publish_cameras(rtc, room, video):
                video.subscribe(self._on_frame)
            source = None
            if microphone is not None and (source := await self._publish_microphone(rtc, room)) is not None:
                microphone.subscribe(hear)
                self._edge.lanes.mic_active = True
            await self._send_audio(rtc, source)
        finally:
            if video is not None:
                video.unsubscribe(self._on_frame)
            if microphone is not None:
                microphone.unsubscribe(hear)
            self._edge.lanes.camera_active = self._edge.lanes.mic_active = False
            if self._voice is not None:
                self._voice[1].cancel()

    # -- cameras -------------------------------------------------------------------------------------------

    async def _publish_cameras(self, rtc: ModuleType, room: Any, video: VideoSource) -> bool:
        config = video.config
        for camera in config.cameras:
            source = rtc.VideoSource(config.width, config.height)
            track = rtc.LocalVideoTrack.create_video_track(camera, source)
            options = rtc.TrackPublishOptions(
                source=rtc.TrackSource.SOURCE_CAMERA,
                video_codec=rtc.VideoCodec.H264,  # the robot's
                video_encoding=rtc.VideoEncoding(max_framerate=config.fps, max_bitrate=VIDEO_BITRATE),
                simulcast=False,  # more layers would be encoded on the cores that simulate
            )
            if not await self._publish(room, track, options, Code.CAMERA, cloud_pb2.SUBSYSTEM_CAMERA):
                break
            self._cameras[camera] = source
        return bool(self._cameras)

    def _on_frame(self, frame: Frame) -> None:
        """A picture, in the cameras' thread. The client library copies it before this returns."""
        source, rtc = self._cameras.get(frame.camera), self._rtc
        if source is None or rtc is None:
            return
        picture = rtc.VideoFrame(frame.width, frame.height, rtc.VideoBufferType.RGB24, frame.rgb.tobytes())
        source.capture_frame(picture, timestamp_us=frame.timestamp_us)
        self._edge.lanes.camera_active = True
        self._edge.note_video(frame.timestamp_us)

    # -- microphone ----------------------------------------------------------------------------------------

    async def _publish_microphone(self, rtc: ModuleType, room: Any) -> Any:
        source = rtc.AudioSource(SAMPLE_RATE, 1, AUDIO_QUEUE_MS)
        track = rtc.LocalAudioTrack.create_audio_track(MICROPHONE, source)
        options = rtc.TrackPublishOptions(source=rtc.TrackSource.SOURCE_MICROPHONE)
        published = await self._publish(room, track, options, Code.MICROPHONE, cloud_pb2.SUBSYSTEM_MIC)
        return source if published else None

    def _hear(self, frame: AudioFrame) -> None:
        if self._heard.full():
            self.dropped_audio += 1
        else:
            self._heard.put_nowait(frame)

    async def _send_audio(self, rtc: ModuleType, source: Any) -> None:
        while True:
            frame = await self._heard.get()
            count = len(frame.samples)
            await source.capture_frame(rtc.AudioFrame(frame.samples.tobytes(), SAMPLE_RATE, 1, count))
            self._edge.note_audio(frame.timestamp_us)

    # -- speaker -------------------------------------------------------------------------------------------

    def _on_published(self, publication: Any) -> None:
        if self._rtc is not None and publication.kind == self._rtc.TrackKind.KIND_AUDIO:
            publication.set_subscribed(True)

    def _on_subscribed(self, track: Any, publication: Any) -> None:
        if self._voice is None and self._rtc is not None and track.kind == self._rtc.TrackKind.KIND_AUDIO:
            self._voice = (publication.sid, asyncio.create_task(self._play(track), name="speaker"))

    def _on_unsubscribed(self, track: Any, publication: Any) -> None:
        if self._voice is not None and self._voice[0] == publication.sid:
            self._voice[1].cancel()
            self._voice = None

    async def _play(self, track: Any) -> None:
        assert self._rtc is not None and self._media.speaker is not None
        stream = self._rtc.AudioStream(track, sample_rate=SAMPLE_RATE, num_channels=1, capacity=AUDIO_BACKLOG)
        try:
            async for event in stream:
                self._media.speaker.write(np.frombuffer(event.frame.data, dtype=np.int16))
        finally:
            await stream.aclose()

    # -- both ----------------------------------------------------------------------------------------------

    async def _publish(
        self, room: Any, track: Any, options: Any, code: Code, subsystem: cloud_pb2.Subsystem.ValueType
    ) -> bool:
        assert self._rtc is not None
        try:
            async with asyncio.timeout(PUBLISH_TIMEOUT_S):
                await room.local_participant.publish_track(track, options)
            return True
        except TimeoutError:
            reason = "no answer; it may relay no media"
        except self._rtc.participant.PublishTrackError as problem:
            reason = hide_token(str(problem.message))
        message = f"the room does not take the track {track.name}: {reason}"
        _log.warning("%s", message)
        self._edge.error(code, message, subsystem)
        return False
