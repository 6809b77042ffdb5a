"""Media packets: what is rewritten, what passes, and what a publisher is told."""

from __future__ import annotations

import asyncio
import struct

import pytest

pytest.importorskip("asimov_gym.room", exc_type=ImportError)

from aiortc import rtp
from livekit.protocol.models import TrackInfo, TrackType

from asimov_gym.room.data_tracks import DataTracks
from asimov_gym.room.media import MediaTrack, Reception, extension, parse_control, reception_report, rewritten


def packet(sequence: int = 1, source: int = 9, payload: bytes = b"media", payload_type: int = 102) -> bytes:
    """An RTP packet with the header extension 4 = `0`, as a client sends it."""
    head = struct.pack("!BBHLL", 0x90, 0x80 | payload_type, sequence & 0xFFFF, 5000, source)
    return head + bytes.fromhex("bede0001 40300000") + payload


def test_payload_type_and_source_are_rewritten_and_the_extension_goes() -> None:
    forwarded = rewritten(packet(sequence=77), 96, 0xABCDEF)
    assert forwarded is not None
    read = rtp.RtpPacket.parse(forwarded)
    assert (read.payload_type, read.ssrc, read.sequence_number, read.timestamp) == (96, 0xABCDEF, 77, 5000)
    assert (read.marker, read.payload) == (1, b"media")
    assert len(forwarded) == 12 + len(b"media")


def test_contributing_sources_and_padding_stay() -> None:
    head = struct.pack("!BBHLLL", 0xB1, 102, 1, 2, 3, 4)
    forwarded = rewritten(head + bytes.fromhex("bede0000") + b"xyz\x01", 96, 5)
    assert forwarded == struct.pack("!BBHLLL", 0xA1, 96, 1, 2, 5, 4) + b"xyz\x01"


def test_a_packet_whose_extension_is_cut_off_is_dropped() -> None:
    assert rewritten(packet()[:14], 96, 5) is None
    assert rewritten(packet()[:18], 96, 5) is None
    assert extension(packet()[:14], 4) is None


def test_the_section_is_read_from_the_extension() -> None:
    assert extension(packet(), 4) == b"0"
    assert extension(packet(), 5) is None


def test_malformed_control_packets_are_nothing() -> None:
    assert list(parse_control(b"")) == []
    assert list(parse_control(b"\x80\xc8\x00\x06abc")) == []
    assert list(parse_control(b"\x00" * 40)) == []


def test_losses_are_reported_once() -> None:
    reception = Reception()
    for sequence in (65533, 65534, 0, 1, 4):
        reception.add(packet(sequence))
    report = reception.report(9)
    assert report.packets_lost == 3
    assert report.highest_sequence == 65536 + 4
    assert report.fraction_lost == 3 * 255 // 8
    assert reception.report(9).fraction_lost == 0


def test_a_track_forwards_and_asks_for_a_picture_but_not_too_often() -> None:
    asked: list[bytes] = []
    got: list[bytes] = []

    async def ask(data: bytes) -> None:
        asked.append(data)

    async def get(data: bytes) -> None:
        got.append(data)

    async def scenario() -> None:
        track = MediaTrack(TrackInfo(sid="TR_1", type=TrackType.VIDEO), "cid", "PA_1", 1234, ask)
        await track.forward(packet(1))
        assert asked == got == []
        subscriber = object()
        await track.connect(subscriber, 96, get)
        await track.forward(packet(2))
        await track.take_feedback(rtp.RtcpPsfbPacket(fmt=rtp.RTCP_PSFB_PLI, ssrc=1, media_ssrc=1234))
        await track.take_feedback(rtp.RtcpRtpfbPacket(fmt=rtp.RTCP_RTPFB_NACK, ssrc=1, media_ssrc=1234, lost=[1, 2]))
        track.disconnect(subscriber)
        await track.forward(packet(3))
        (report, allowed) = (next(iter(parse_control(data))) for data in reception_report([track]))
        assert isinstance(report, rtp.RtcpRrPacket)
        assert report.reports[0].ssrc == 9
        assert isinstance(allowed, rtp.RtcpPsfbPacket)
        assert rtp.unpack_remb_fci(allowed.fci)[1] == [9]

    asyncio.run(scenario())
    assert [rtp.RtpPacket.parse(data).sequence_number for data in got] == [2]
    picture, missing = (next(iter(parse_control(data))) for data in asked)
    assert isinstance(picture, rtp.RtcpPsfbPacket)
    assert (picture.fmt, picture.media_ssrc) == (rtp.RTCP_PSFB_PLI, 9)
    assert isinstance(missing, rtp.RtcpRtpfbPacket)
    assert (missing.media_ssrc, missing.lost) == (9, [1, 2])


def test_data_track_packets_get_each_subscribers_handle() -> None:
    from livekit.protocol.rtc import PublishDataTrackRequest

    publisher, one, two = DataTracks(2), DataTracks(2), DataTracks(2)
    track = publisher.publish(PublishDataTrackRequest(pub_handle=5, name="state"), "robot", "PA_1")
    other = publisher.publish(PublishDataTrackRequest(pub_handle=6, name="telemetry"), "robot", "PA_1")
    assert not isinstance(track, int) and not isinstance(other, int)
    one.receive(other, "one")
    one.receive(track, "one")
    two.receive(track, "two")
    sent = bytes.fromhex("0800 0005 0001 0001 00000000") + b"frame"
    assert dict(publisher.addressed(sent)) == {
        "one": sent[:2] + b"\x00\x02" + sent[4:],
        "two": sent[:2] + b"\x00\x01" + sent[4:],
    }
    one.stop_receiving(track, "one")
    assert [who for who, _ in publisher.addressed(sent)] == ["two"]
    assert publisher.addressed(sent[:11]) == []
    assert publisher.addressed(b"\x00\x00\x00\x09" + sent[4:]) == []


def test_data_tracks_are_refused_with_a_reason() -> None:
    from livekit.protocol.rtc import PublishDataTrackRequest, RequestResponse

    tracks = DataTracks(most=1)

    def publish(handle: int, name: str) -> object:
        return tracks.publish(PublishDataTrackRequest(pub_handle=handle, name=name), "robot", "PA_1")

    assert publish(0, "a") == RequestResponse.INVALID_HANDLE
    assert publish(65_536, "a") == RequestResponse.INVALID_HANDLE
    assert publish(1, "") == RequestResponse.INVALID_NAME
    assert not isinstance(publish(1, "a"), int)
    assert publish(1, "b") == RequestResponse.DUPLICATE_HANDLE
    assert publish(2, "a") == RequestResponse.DUPLICATE_NAME
    assert publish(2, "b") == RequestResponse.LIMIT_EXCEEDED
