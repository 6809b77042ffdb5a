"""Data tracks: streams of frames that a participant publishes and others choose to receive.

Their packets travel on the data channel `_data_track`. Of the 12 bytes of a packet's header the room reads and rewrites
one field: bytes 2 and 3, big-endian, the handle by which publisher and each subscriber know the track.
"""

from __future__ import annotations

import secrets
from dataclasses import dataclass, field
from typing import Any

from livekit.protocol.models import DataTrackInfo
from livekit.protocol.rtc import PublishDataTrackRequest, RequestResponse

_HEADER_BYTES = 12
_HANDLES = range(1, 65_536)
_NAME_MAX = 256


@dataclass
class DataTrack:
    """A data track in a room."""

    info: DataTrackInfo
    publisher_identity: str
    publisher_sid: str
    handles: dict[Any, int] = field(default_factory=dict)
    """Handle by subscriber."""


class DataTracks:
    """The data tracks of one participant: those it publishes, and the handles of those it receives.

    Args:
        most: data tracks it may publish.
    """

    def __init__(self, most: int) -> None:
        self.published: dict[int, DataTrack] = {}
        """By the publisher's handle."""
        self.received: dict[int, DataTrack] = {}
        """By the handle that this participant was given."""
        self._most = most
        self._last_handle = 0

    def publish(
        self, request: PublishDataTrackRequest, identity: str, participant_sid: str
    ) -> DataTrack | RequestResponse.Reason:
        """Publish a track, or say why not."""
        if request.pub_handle not in _HANDLES:
            return RequestResponse.INVALID_HANDLE
        if request.pub_handle in self.published:
            return RequestResponse.DUPLICATE_HANDLE
        if not 0 < len(request.name) <= _NAME_MAX:
            return RequestResponse.INVALID_NAME
        if any(track.info.name == request.name for track in self.published.values()):
            return RequestResponse.DUPLICATE_NAME
        if len(self.published) >= self._most:
            return RequestResponse.LIMIT_EXCEEDED
        info = DataTrackInfo(
            pub_handle=request.pub_handle,
            sid=f"DTR_{secrets.token_hex(6)}",
            name=request.name,
            encryption=request.encryption,
        )
        if request.HasField("frame_encoding"):
            info.frame_encoding.CopyFrom(request.frame_encoding)
        if request.HasField("schema"):
            info.schema.CopyFrom(request.schema)
        track = self.published[request.pub_handle] = DataTrack(info, identity, participant_sid)
        return track

    def receive(self, track: DataTrack, subscriber: Any) -> bool:
        """Give the track a handle at this participant. False if there is none left."""
        if subscriber in track.handles:
            return True
        if len(self.received) >= len(_HANDLES):
            return False
        handle = self._last_handle
        while handle in self.received or handle not in _HANDLES:
            handle = handle % len(_HANDLES) + 1
        self._last_handle = handle
        self.received[handle], track.handles[subscriber] = track, handle
        return True

    def stop_receiving(self, track: DataTrack, subscriber: Any) -> None:
        """Take the handle back."""
        handle = track.handles.pop(subscriber, None)
        if handle is not None:
            self.received.pop(handle, None)

    def addressed(self, packet: bytes) -> list[tuple[Any, bytes]]:
        """A packet that this participant published, for each subscriber of its track; nothing if it is malformed."""
        if len(packet) < _HEADER_BYTES:
            return []
        track = self.published.get(int.from_bytes(packet[2:4], "big"))
        if track is None:
            return []
        head, rest = packet[:2], packet[4:]
        return [(who, b"".join((head, handle.to_bytes(2, "big"), rest))) for who, handle in track.handles.items()]
