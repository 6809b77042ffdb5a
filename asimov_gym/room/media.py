"""Media forwarded packet by packet: nothing is decoded, so a video costs as little as its bytes.

Of an RTP packet the room rewrites the payload type and the source (SSRC), which it chose itself when it offered the
track to a subscriber, and drops header extensions, whose numbers differ from client to client. Sequence numbers and
timestamps pass unchanged: so a subscriber's requests for lost packets (NACK) and for a whole picture (PLI) go to
the publisher as they are, and its sender reports go to the subscribers. Sources: RFC 3550, RFC 4585, RFC 8285.
"""

from __future__ import annotations

import struct
import time
from collections.abc import Awaitable, Callable, Sequence

from aiortc import rtp
from livekit.protocol.models import TrackInfo

from asimov_gym.room.session_description import Codec

FORWARDED = {"audio": ("opus",), "video": ("h264", "vp8")}
"""Codecs that need nothing but their packets to be forwarded."""
_REPORTER = 1
"""Our own source in control packets."""
_KEYFRAME_INTERVAL_S = 0.3
"""Least time between requests for a whole picture: a room of subscribers asks at once."""
_BITRATE = 12_000_000
"""What publishers are told they may send, bit/s: the loopback is not the bottleneck."""

SendMedia = Callable[[bytes], Awaitable[None]]


def rewritten(packet: bytes, payload_type: int, source: int) -> bytes | None:
    """An RTP packet for a subscriber: other payload type and source, no header extension. None if it is malformed."""
    start = 12 + 4 * (packet[0] & 0x0F)
    end = start
    if packet[0] & 0x10:
        if len(packet) < start + 4:
            return None
        end = start + 4 + 4 * int.from_bytes(packet[start + 2 : start + 4], "big")
    if len(packet) < end:
        return None
    first = bytes((packet[0] & ~0x10, packet[1] & 0x80 | payload_type))
    return b"".join((first, packet[2:8], source.to_bytes(4, "big"), packet[12:start], packet[end:]))


def extension(packet: bytes, number: int) -> bytes | None:
    """A header extension of an RTP packet, if it is there."""
    start = 12 + 4 * (packet[0] & 0x0F)
    if not packet[0] & 0x10 or len(packet) < start + 4:
        return None
    profile, words = struct.unpack_from("!HH", packet, start)
    try:
        found = rtp.unpack_header_extensions(profile, packet[start + 4 : start + 4 + 4 * words])
    except ValueError:
        return None
    return next((value for key, value in found if key == number), None)


def parse_control(data: bytes) -> Sequence[rtp.AnyRtcpPacket]:
    """The control packets in a datagram; none if it is malformed."""
    try:
        return rtp.RtcpPacket.parse(data)
    except (ValueError, IndexError, struct.error):
        return ()


class Reception:
    """What has arrived of one source, as its sender is told once a second."""

    def __init__(self) -> None:
        self._first: int | None = None
        self._highest = 0
        self._received = 0
        self._expected_before = 0
        self._received_before = 0
        self._report_stamp, self._report_time = 0, 0.0

    def add(self, packet: bytes) -> None:
        """Count an RTP packet."""
        sequence = int.from_bytes(packet[2:4], "big")
        self._received += 1
        if self._first is None:
            self._first = self._highest = sequence
            return
        ahead = (sequence - self._highest) & 0xFFFF
        if 0 < ahead < 0x8000:
            self._highest += ahead

    def note_report(self, ntp: int) -> None:
        """Remember when the sender's last report came, so that it can tell the round trip."""
        self._report_stamp, self._report_time = (ntp >> 16) & 0xFFFFFFFF, time.monotonic()

    def report(self, source: int) -> rtp.RtcpReceiverInfo:
        """The block of a receiver report. Jitter is not measured and given as zero."""
        expected = self._highest - (self._first or 0) + 1
        lately, got = expected - self._expected_before, self._received - self._received_before
        self._expected_before, self._received_before = expected, self._received
        delay = int((time.monotonic() - self._report_time) * 65536) if self._report_stamp else 0
        return rtp.RtcpReceiverInfo(
            ssrc=source,
            fraction_lost=max(0, lately - got) * 255 // max(1, lately),
            packets_lost=rtp.clamp_packets_lost(expected - self._received),
            highest_sequence=self._highest & 0xFFFFFFFF,
            jitter=0,
            lsr=self._report_stamp,
            dlsr=min(delay, 0xFFFFFFFF),
        )


class MediaTrack:
    """An audio or video track that a participant publishes.

    Args:
        info: what other participants are told of it.
        cid: the publisher's own name for it.
        publisher_sid: whose it is.
        source: our SSRC for it.
        send: sends a control packet to the publisher.
    """

    def __init__(self, info: TrackInfo, cid: str, publisher_sid: str, source: int, send: SendMedia) -> None:
        self.info, self.cid, self.publisher_sid, self.source = info, cid, publisher_sid, source
        self.mid: str | None = None
        """Section that carries it; None until the publisher's offer names it."""
        self.codec: Codec | None = None
        self.reception = Reception()
        self.publisher_source: int | None = None
        """The publisher's SSRC; None until a packet came."""
        self._outlets: dict[object, tuple[int, SendMedia]] = {}
        self._send = send
        self._last_keyframe_request = 0.0

    @property
    def kind(self) -> str:
        """`audio` or `video`."""
        return "video" if self.info.type else "audio"

    async def connect(self, subscriber: object, payload_type: int, send: SendMedia) -> None:
        """Forward to a subscriber from now on, beginning with a whole picture."""
        self._outlets[subscriber] = (payload_type, send)
        await self.request_keyframe()

    def disconnect(self, subscriber: object) -> None:
        """Forward to that subscriber no more."""
        self._outlets.pop(subscriber, None)

    async def forward(self, packet: bytes) -> None:
        """An RTP packet came from the publisher."""
        source = int.from_bytes(packet[8:12], "big")
        if source != self.publisher_source:
            self.publisher_source, self.reception = source, Reception()
            if self._outlets:
                await self.request_keyframe()
        self.reception.add(packet)
        for payload_type, send in list(self._outlets.values()):
            if (forwarded := rewritten(packet, payload_type, self.source)) is not None:
                await send(forwarded)

    async def take_sender_report(self, report: rtp.RtcpSrPacket) -> None:
        """The publisher told its clock: subscribers need it to keep sound and picture together."""
        self.reception.note_report(report.sender_info.ntp_timestamp)
        forwarded = bytes(rtp.RtcpSrPacket(ssrc=self.source, sender_info=report.sender_info))
        for _, send in list(self._outlets.values()):
            await send(forwarded)

    async def take_feedback(self, packet: rtp.AnyRtcpPacket) -> None:
        """A subscriber asks for something."""
        if isinstance(packet, rtp.RtcpPsfbPacket) and packet.fmt == rtp.RTCP_PSFB_PLI:
            await self.request_keyframe()
        elif isinstance(packet, rtp.RtcpRtpfbPacket) and packet.fmt == rtp.RTCP_RTPFB_NACK and self.publisher_source:
            missing = rtp.RtcpRtpfbPacket(
                fmt=rtp.RTCP_RTPFB_NACK, ssrc=_REPORTER, media_ssrc=self.publisher_source, lost=packet.lost
            )
            await self._send(bytes(missing))

    async def request_keyframe(self) -> None:
        """Ask the publisher for a whole picture."""
        now = time.monotonic()
        if (
            self.kind == "audio"
            or not self.publisher_source
            or now - self._last_keyframe_request < _KEYFRAME_INTERVAL_S
        ):
            return
        self._last_keyframe_request = now
        await self._send(
            bytes(rtp.RtcpPsfbPacket(fmt=rtp.RTCP_PSFB_PLI, ssrc=_REPORTER, media_ssrc=self.publisher_source))
        )


def reception_report(tracks: Sequence[MediaTrack]) -> list[bytes]:
    """Control packets that tell a publisher what arrived and how much it may send."""
    heard = [(track, track.publisher_source) for track in tracks if track.publisher_source]
    if not heard:
        return []
    reports = [track.reception.report(source) for track, source in heard]
    allowed = rtp.pack_remb_fci(_BITRATE, [source for _, source in heard])
    return [
        bytes(rtp.RtcpRrPacket(ssrc=_REPORTER, reports=reports)),
        bytes(rtp.RtcpPsfbPacket(fmt=rtp.RTCP_PSFB_APP, ssrc=_REPORTER, media_ssrc=0, fci=allowed)),
    ]
