"""A stand-in for the LiveKit client library and its server, in memory: rooms, packets, data tracks, remote calls.

It has the names of `livekit.rtc` that the robot's lane and the client's link use, and behaves as the library was seen
to: callbacks run in the event loop that made the room, members hear of each other, a track outlives a mended
connection. What it cannot show (delays, losses, native threads) is tested with the real library in a network namespace.

    server = StandInServer()
    server.install(monkeypatch)
    lane = LiveKitLane(edge, "ws://room", "robot")      # the token is the identity
"""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import pytest


class LibraryError(Exception):
    """The library's errors carry their text in `message`."""

    def __init__(self, message: str) -> None:
        super().__init__(message)
        self.message = message


class ConnectError(LibraryError): ...


class PublishDataError(LibraryError): ...


class PublishDataTrackError(LibraryError): ...


class PublishTrackError(LibraryError): ...


class PushFrameError(LibraryError): ...


class SubscribeDataTrackError(LibraryError): ...


class RpcError(LibraryError): ...


@dataclass
class DataTrackFrame:
    payload: bytes
    user_timestamp: int | None = None


@dataclass
class DataPacket:
    data: bytes
    topic: str
    participant: Any


class LocalDataTrack:
    def __init__(self, owner: Room, name: str) -> None:
        self.owner, self.name, self.readers = owner, name, []
        self.published = True

    def is_published(self) -> bool:
        return self.published

    def try_push(self, frame: DataTrackFrame) -> None:
        if not self.owner.linked:
            raise PushFrameError("queue full")
        for reader in self.readers:
            reader.put(frame)


class RemoteDataTrack:
    """One member's view of another one's track."""

    def __init__(self, track: LocalDataTrack, viewer: Room, sid: str) -> None:
        self._track, self._viewer = track, viewer
        self.info = SimpleNamespace(name=track.name, sid=sid)
        self.publisher_identity = track.owner.identity

    def subscribe(self) -> TrackStream:
        stream = TrackStream(self._viewer)
        self._track.readers.append(stream)
        return stream


class TrackStream:
    def __init__(self, viewer: Room) -> None:
        self._viewer, self._frames = viewer, asyncio.Queue()

    def put(self, frame: DataTrackFrame) -> None:
        self._viewer.soon(self._frames.put_nowait, frame)

    def __aiter__(self) -> TrackStream:
        return self

    async def __anext__(self) -> DataTrackFrame:
        return await self._frames.get()


@dataclass
class Participant:
    """How others see a member."""

    identity: str
    attributes: dict[str, str] = field(default_factory=dict)
    track_publications: dict[str, Any] = field(default_factory=dict)


class LocalParticipant:
    def __init__(self, room: Room, server: StandInServer) -> None:
        self._room, self._server = room, server
        self.identity = room.identity
        self.attributes: dict[str, str] = {}
        self.calls: dict[str, Callable[[Any], Any]] = {}
        self.permissions = SimpleNamespace(can_publish_data=room.identity not in server.watchers)

    async def publish_data(
        self, payload: bytes, *, reliable: bool = True, destination_identities: Any = (), topic: str = ""
    ) -> None:
        if not self._room.linked or self._server.refuses_packets:
            raise PublishDataError("data channel closed")
        for other in self._room.others():
            sender = other.remote_participants.get(self.identity)
            other.emit("data_received", DataPacket(bytes(payload), topic, sender))

    async def publish_data_track(self, *, name: str) -> LocalDataTrack:
        if not self.permissions.can_publish_data:
            raise PublishDataTrackError("not permitted")
        track = LocalDataTrack(self._room, name)
        self._room.tracks.append(track)
        for other in self._room.others():
            other.emit("data_track_published", self._server.remote(track, other))
        return track

    def register_rpc_method(self, method: str, handler: Callable[[Any], Any]) -> None:
        self.calls[method] = handler

    async def perform_rpc(
        self, *, destination_identity: str, method: str, payload: str, response_timeout: float
    ) -> str:
        other = self._server.members.get(destination_identity)
        if other is None or method not in other.local_participant.calls:
            raise RpcError("method not supported")
        return await other.local_participant.calls[method](SimpleNamespace(payload=payload))

    async def set_attributes(self, attributes: dict[str, str]) -> None:
        self.attributes.update(attributes)
        for other in self._room.others():
            other.remote_participants[self.identity].attributes.update(attributes)


class Room:
    """One member of the stand-in's only room."""

    def __init__(self, server: StandInServer) -> None:
        self._server = server
        self._loop = asyncio.get_running_loop()
        self._handlers: dict[str, list[Callable[..., object]]] = {}
        self.identity = ""
        self.name = "robot-sim"
        self.tracks: list[LocalDataTrack] = []
        self.remote_participants: dict[str, Participant] = {}
        self.linked = False
        self.local_participant: Any = None

    def on(self, event: str, handler: Callable[..., object] | None = None) -> Any:
        if handler is None:
            return lambda decorated: self.on(event, decorated)
        self._handlers.setdefault(event, []).append(handler)
        return handler

    def emit(self, event: str, *arguments: object) -> None:
        for handler in self._handlers.get(event, []):
            self.soon(handler, *arguments)

    def soon(self, function: Callable[..., object], *arguments: object) -> None:
        try:
            self._loop.call_soon_threadsafe(function, *arguments)
        except RuntimeError:  # the member's loop has ended
            return

    def others(self) -> list[Room]:
        return [member for member in self._server.members.values() if member is not self and member.linked]

    async def connect(self, url: str, token: str, options: Any) -> None:
        self._server.attempts += 1
        if self._server.silent:
            await asyncio.Event().wait()
        if self._server.down:
            raise ConnectError(self._server.down)
        self.identity = self._server.identities.get(token, token)
        evicted = self._server.members.get(self.identity)
        if evicted is not None:
            self._server.drop(evicted, 2)
        self.local_participant = LocalParticipant(self, self._server)
        self.linked = True
        self._server.members[self.identity] = self
        self._server.introduce(self)

    async def disconnect(self) -> None:
        self._server.drop(self, None)


class StandInServer:
    """The one room, and a stand-in of the module `livekit.rtc`."""

    def __init__(self) -> None:
        self.members: dict[str, Room] = {}
        self.identities: dict[str, str] = {}
        """Identity by token, where it is not the token itself."""
        self.watchers: set[str] = set()
        """Identities whose tokens lack canPublishData."""
        self.down = ""
        """While set, joining fails with this text."""
        self.silent = False
        """While set, joining gets no answer."""
        self.refuses_packets = False
        self.attempts = 0
        self._sids = itertools.count(1)

    def install(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Have lanes and links use this in place of the library."""
        rtc = SimpleNamespace(
            Room=lambda: Room(self),
            RoomOptions=SimpleNamespace,
            DataTrackFrame=DataTrackFrame,
            DisconnectReason=SimpleNamespace(Name={1: "CLIENT_INITIATED", 2: "DUPLICATE_IDENTITY"}.__getitem__),
            ConnectError=ConnectError,
            participant=SimpleNamespace(  # the package's top level does not have these
                PublishDataError=PublishDataError,
                PublishDataTrackError=PublishDataTrackError,
                PublishTrackError=PublishTrackError,
            ),
            PushFrameError=PushFrameError,
            SubscribeDataTrackError=SubscribeDataTrackError,
            RpcError=RpcError,
        )
        monkeypatch.setattr("asimov_gym.edge.transports.livekit.load_rtc", lambda: rtc)
        monkeypatch.setattr("asimov_gym.edge.clients.livekit.load_rtc", lambda: rtc)

    def remote(self, track: LocalDataTrack, viewer: Room) -> RemoteDataTrack:
        return RemoteDataTrack(track, viewer, f"DTR_{next(self._sids)}")

    def introduce(self, member: Room) -> None:
        """Tell a member of the others, and them of it."""
        for other in member.others():
            other.remote_participants[member.identity] = Participant(member.identity)
            other.emit("participant_connected", other.remote_participants[member.identity])
            known = Participant(other.identity, dict(other.local_participant.attributes))
            member.remote_participants[other.identity] = known
            for track in other.tracks:
                member.emit("data_track_published", self.remote(track, member))

    def drop(self, member: Room, reason: int | None) -> None:
        """A member goes; with a reason it is told so."""
        if self.members.get(member.identity) is member:
            del self.members[member.identity]
            self._tell_gone(member)
        if member.linked and reason is not None:
            member.emit("disconnected", reason)
        member.linked = False

    def interrupt(self) -> None:
        """Every connection is lost; the library begins to mend it. It says that the others have gone."""
        for member in self.members.values():
            member.linked = False
            for identity in list(member.remote_participants):
                member.emit("participant_disconnected", member.remote_participants.pop(identity))
            member.emit("reconnecting")

    def mend(self) -> None:
        """The library has mended the connections. Tracks, and subscriptions to them, are as before."""
        for member in self.members.values():
            member.linked = True
        for member in self.members.values():
            for other in member.others():
                member.remote_participants[other.identity] = Participant(
                    other.identity, dict(other.local_participant.attributes)
                )
            member.emit("reconnected")

    def _tell_gone(self, member: Room) -> None:
        for other in self.members.values():
            gone = other.remote_participants.pop(member.identity, None)
            if gone is not None:
                other.emit("participant_disconnected", gone)
