"""The connection on which a client sends: the client offers, the room answers."""

from __future__ import annotations

import secrets
from collections.abc import Callable
from dataclasses import replace

from aiortc import RTCCertificate, rtp
from livekit.protocol.models import TrackInfo
from livekit.protocol.rtc import AddTrackRequest

from asimov_gym.room.errors import SessionDescriptionError
from asimov_gym.room.limits import RoomLimits
from asimov_gym.room.media import FORWARDED, MediaTrack, extension, parse_control, reception_report
from asimov_gym.room.session_description import MEDIA, MID_EXTENSION, Codec, Section, parse, refused, write
from asimov_gym.room.transport import MessageHandler, PeerTransport

_FEEDBACK = ("nack", "nack pli", "goog-remb")
_START_BITRATE = "x-google-start-bitrate=3000"
"""kbit/s. Without feedback on single packets a publisher starts at 300 kbit/s and takes half a minute to 720p."""


class Publisher:
    """What a participant publishes, and the connection it comes on.

    Args:
        participant_sid: whose it is.
        certificate: of the server.
        limits: of the server.
        on_message: gets the label of a data channel and a message.
        on_lost: called when the connection is lost.
    """

    def __init__(
        self,
        participant_sid: str,
        certificate: RTCCertificate,
        limits: RoomLimits,
        on_message: MessageHandler,
        on_lost: Callable[[], None],
    ) -> None:
        self.tracks: dict[str, MediaTrack] = {}
        """By sid, in the order of publication."""
        self._participant_sid, self._limits = participant_sid, limits
        self._by_source: dict[int, MediaTrack] = {}
        self._mid_extension: int | None = None
        self._version = 0
        self.transport = PeerTransport(
            certificate,
            False,
            limits.packet_bytes,
            on_message,
            self._take_packet,
            self._take_control,
            _nothing,
            on_lost,
        )

    def add(self, request: AddTrackRequest) -> MediaTrack | None:
        """Note a track that the client's next offer will hold. None if there are too many, or its kind is unknown."""
        if len(self.tracks) >= self._limits.tracks or request.type not in (0, 1):
            return None
        video = request.type == 1
        info = TrackInfo(
            sid=f"TR_{secrets.token_hex(6)}",
            type=request.type,
            name=request.name,
            muted=request.muted,
            width=request.width,
            height=request.height,
            source=request.source,
            stereo=request.stereo,
            disable_dtx=request.disable_dtx,
            disable_red=True,
            stream=request.stream,
            encryption=request.encryption,
            mime_type="video/VP8" if video else "audio/opus",
            audio_features=request.audio_features,
            packet_trailer_features=request.packet_trailer_features,
        )
        source = secrets.randbits(31) + 1
        track = MediaTrack(info, request.cid, self._participant_sid, source, self.transport.send_media)
        self.tracks[info.sid] = track
        return track

    async def answer(self, text: str, may_publish: bool) -> tuple[str, list[MediaTrack], list[MediaTrack]]:
        """Answer an offer.

        Args:
            text: of the offer.
            may_publish: whether its media may be taken.

        Returns:
            The text of the answer, the tracks that now have a section, and those that lost theirs.

        Raises:
            SessionDescriptionError: the offer is malformed, or is for another connection than the first one was.
        """
        offer = parse(text)
        if self.transport.remote is not None and offer.ufrag != self.transport.remote.ufrag:
            raise SessionDescriptionError("the client wants another transport for a connection it has")
        added, removed, sections = [], [], []
        for section in offer.sections:
            if section.kind not in MEDIA:
                sections.append(section)
                continue
            before = next((track for track in self.tracks.values() if track.mid == section.mid), None)
            if before is not None and not (section.sends and before.cid == section.track_id):
                self.remove(before)
                removed.append(before)
                before = None
            track = before or self._unbound(section)
            codec = _codec(section)
            if section.sends and may_publish and track is not None and codec is not None:
                if track is not before:
                    track.mid, track.codec = section.mid, codec
                    track.info.mid, track.info.mime_type = section.mid, f"{section.kind}/{codec.encoding.split('/')[0]}"
                    added.append(track)
                self._mid_extension = {uri: n for n, uri in section.extensions}.get(MID_EXTENSION, self._mid_extension)
                sections.append(_taken(section, codec))
            elif section.sends or codec is None:
                sections.append(refused(section))
            else:
                sections.append(replace(_taken(section, codec), direction="inactive"))
        await self.transport.open()
        local = self.transport.local("active")
        self._version += 1
        answer = write(replace(local, sections=tuple(sections)), self._version, self._limits.packet_bytes)
        self.transport.connect(offer, client_role=True)
        return answer, added, removed

    def _unbound(self, section: Section) -> MediaTrack | None:
        """The track announced for a section: by the name of its track, or the only one that waits."""
        waiting = [track for track in self.tracks.values() if track.mid is None and track.kind == section.kind]
        named = [track for track in waiting if track.cid == section.track_id]
        return (named or (waiting if len(waiting) == 1 else [None]))[0]

    def remove(self, track: MediaTrack) -> None:
        """Forget a track."""
        self.tracks.pop(track.info.sid, None)
        self._by_source = {source: other for source, other in self._by_source.items() if other is not track}

    async def _take_packet(self, packet: bytes) -> None:
        if len(packet) < 12:
            return
        source = int.from_bytes(packet[8:12], "big")
        track = self._by_source.get(source) or self._find(packet, source)
        if track is not None and not track.info.muted:
            await track.forward(packet)

    def _find(self, packet: bytes, source: int) -> MediaTrack | None:
        """The track of a source not heard before: by the mid that its first packets carry, or by the payload type."""
        bound = [track for track in self.tracks.values() if track.mid is not None and track.codec is not None]
        mid = extension(packet, self._mid_extension) if self._mid_extension is not None else None
        if mid is not None:
            bound = [track for track in bound if track.mid == mid.decode("ascii", "replace")]
        bound = [track for track in bound if track.codec and track.codec.payload_type == packet[1] & 0x7F]
        if len(bound) != 1:
            return None
        if len(self._by_source) < 4 * self._limits.tracks:
            self._by_source[source] = bound[0]
        return bound[0]

    async def _take_control(self, data: bytes) -> None:
        for packet in parse_control(data):
            if isinstance(packet, rtp.RtcpSrPacket) and (track := self._by_source.get(packet.ssrc)) is not None:
                await track.take_sender_report(packet)

    async def report(self) -> None:
        """Tell the client what arrived of its media; due once a second."""
        for packet in reception_report(list(self.tracks.values())):
            await self.transport.send_media(packet)


def _codec(section: Section) -> Codec | None:
    """The first of the offered codecs that can be forwarded."""
    return next((codec for codec in section.codecs if codec.name in FORWARDED[section.kind]), None)


def _taken(section: Section, codec: Codec) -> Section:
    if section.kind == "video":
        codec = replace(
            codec,
            parameters=";".join(part for part in (codec.parameters, _START_BITRATE) if part),
            feedback=tuple(what for what in _FEEDBACK if what in codec.feedback),
        )
    # Of several simulcast layers the largest picture is taken, `f` by LiveKit's custom; the sender stops the others.
    rids = ("f",) if "f" in section.rids else section.rids[:1]
    return replace(section, direction="recvonly", codecs=(codec,), rids=rids, track_id="", stream_id="")


def _nothing() -> None:
    pass
