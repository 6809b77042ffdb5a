"""The connection on which a client receives: the room offers, the client answers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from aiortc import RTCCertificate

from asimov_gym.room.errors import SessionDescriptionError
from asimov_gym.room.limits import RoomLimits
from asimov_gym.room.media import MediaTrack, parse_control
from asimov_gym.room.session_description import Codec, Section, parse, write
from asimov_gym.room.transport import MessageHandler, PeerTransport

_FIRST_DYNAMIC, _LAST_DYNAMIC = 96, 127
_DATA_SECTION = Section("application", "data")


@dataclass
class _Lane:
    """A media section of the connection. Once there it stays, and another track of its kind can use it again."""

    kind: str
    mid: str
    codec: Codec
    track: MediaTrack | None


class Subscriber:
    """What a participant receives, and the connection it goes out on.

    Args:
        certificate: of the server.
        limits: of the server.
        on_message: gets what the client sends on a data channel of this connection.
        on_open: called when the data channels are open.
        on_lost: called when the connection is lost.
        offer: sends the text of an offer to the client.
    """

    def __init__(
        self,
        certificate: RTCCertificate,
        limits: RoomLimits,
        on_message: MessageHandler,
        on_open: Callable[[], None],
        on_lost: Callable[[], None],
        offer: Callable[[str, int], None],
    ) -> None:
        self._limits, self._offer = limits, offer
        self._lanes: list[_Lane] = []
        self._payload_types: dict[tuple[str, str], int] = {}
        self._version = 0
        self._opened = False
        self._waiting = False
        """Whether an offer is out that was not answered."""
        self._changed = False
        """Whether the lanes changed since that offer."""
        self.transport = PeerTransport(
            certificate, True, limits.packet_bytes, on_message, _ignore, self._take_control, on_open, on_lost
        )

    def add(self, track: MediaTrack) -> bool:
        """Put a track on the connection; `negotiate` then offers it. False if it is there, or there is no room."""
        if track.codec is None or any(lane.track is track for lane in self._lanes):
            return False
        codec = self._numbered(track.codec)
        if codec is None:
            return False
        free = next((lane for lane in self._lanes if lane.track is None and lane.kind == track.kind), None)
        if free is not None:
            free.codec, free.track = codec, track
        elif len(self._lanes) < 4 * self._limits.tracks:
            self._lanes.append(_Lane(track.kind, str(len(self._lanes)), codec, track))
        else:
            return False
        self._changed = True
        return True

    def remove(self, track: MediaTrack) -> None:
        """Take a track off the connection; `negotiate` then tells the client."""
        track.disconnect(self)
        for lane in self._lanes:
            if lane.track is track:
                lane.track, self._changed = None, True

    def clear(self) -> None:
        """Stop all forwarding."""
        for lane in self._lanes:
            if lane.track is not None:
                lane.track.disconnect(self)

    def _numbered(self, codec: Codec) -> Codec | None:
        """The codec under a payload type that means the same in every section, as a bundle demands."""
        key = (codec.encoding.lower(), codec.parameters)
        if key not in self._payload_types:
            if len(self._payload_types) > _LAST_DYNAMIC - _FIRST_DYNAMIC:
                return None
            self._payload_types[key] = _FIRST_DYNAMIC + len(self._payload_types)
        feedback = tuple(what for what in ("nack", "nack pli") if what in codec.feedback)
        return replace(codec, payload_type=self._payload_types[key], feedback=feedback)

    async def open(self) -> None:
        """Open the connection's socket and make the first offer."""
        await self.transport.open()
        self._opened = self._changed = True
        self.negotiate()

    def negotiate(self) -> None:
        """Offer what has changed. While an offer is out, the next one waits for its answer."""
        if self._waiting or not (self._opened and self._changed):
            return
        self._waiting, self._changed = True, False
        self._version += 1
        version = self._version
        local = self.transport.local("actpass")
        sections = (_DATA_SECTION, *(_offered(lane) for lane in self._lanes))
        self._offer(write(replace(local, sections=sections), version, self._limits.packet_bytes), version)

    async def take_answer(self, text: str) -> None:
        """The client answered the last offer.

        Raises:
            SessionDescriptionError: the answer is malformed, or there was no offer.
        """
        answer = parse(text)
        if not self._waiting:
            raise SessionDescriptionError("an answer came to no offer")
        if answer.setup == "actpass":
            raise SessionDescriptionError("an answer leaves the DTLS role open")
        self._waiting = False
        self.transport.connect(answer, client_role=answer.setup == "passive")
        accepted = {section.mid for section in answer.sections if section.accepted and section.direction != "inactive"}
        for lane in self._lanes:
            if lane.track is not None and lane.mid in accepted:
                await lane.track.connect(self, lane.codec.payload_type, self.transport.send_media)
        self.negotiate()

    async def _take_control(self, data: bytes) -> None:
        for packet in parse_control(data):
            source = getattr(packet, "media_ssrc", None)
            for lane in self._lanes:
                if source and lane.track is not None and lane.track.source == source:
                    await lane.track.take_feedback(packet)


def _offered(lane: _Lane) -> Section:
    section = Section(lane.kind, lane.mid, "inactive", (lane.codec,))
    if lane.track is None:
        return section
    sid = lane.track.info.sid
    # The client library reads publisher and track from these two names.
    return replace(
        section,
        direction="sendonly",
        stream_id=f"{lane.track.publisher_sid}|{sid}",
        track_id=sid,
        ssrc=lane.track.source,
    )


async def _ignore(packet: bytes) -> None:
    """A client sends no media on the connection it receives on."""
