"""Offers and answers: read, written, and refused when they are malformed."""

from __future__ import annotations

import random

import pytest

pytest.importorskip("asimov_gym.room", exc_type=ImportError)

from asimov_gym.room.errors import SessionDescriptionError
from asimov_gym.room.session_description import (
    MID_EXTENSION,
    RID_EXTENSION,
    Codec,
    Description,
    Section,
    parse,
    refused,
    write,
)

H264 = Codec(102, "H264/90000", "packetization-mode=1;profile-level-id=42e01f", ("nack", "nack pli"))
OPUS = Codec(111, "opus/48000/2", "minptime=10;useinbandfec=1")
DESCRIPTION = Description(
    ufrag="abcd",
    password="p" * 22,
    fingerprints=(("sha-256", "AA:BB"),),
    setup="actpass",
    sections=(
        Section("application", "data"),
        Section("audio", "0", "sendonly", (OPUS,), "PA_1|TR_1", "TR_1", ssrc=7),
        Section("video", "1", "inactive", (H264,)),
    ),
    candidates=("1 1 udp 2130706431 127.0.0.1 40000 typ host",),
)
BROWSER = """v=0
o=- 1 2 IN IP4 127.0.0.1
s=-
t=0 0
a=group:BUNDLE 0 1
m=video 9 UDP/TLS/RTP/SAVPF 102 96 97
c=IN IP4 0.0.0.0
a=ice-ufrag:u123
a=ice-pwd:pppppppppppppppppppppp
a=fingerprint:sha-256 aa:bb
a=setup:actpass
a=mid:0
a=extmap:4 urn:ietf:params:rtp-hdrext:sdes:mid
a=extmap:10/sendonly urn:ietf:params:rtp-hdrext:sdes:rtp-stream-id
a=extmap:3 urn:ietf:params:rtp-hdrext:something
a=sendonly
a=msid:- camera
a=rtpmap:102 H264/90000
a=rtcp-fb:102 nack
a=rtcp-fb:102 nack pli
a=fmtp:102 packetization-mode=1;profile-level-id=42e01f
a=rtpmap:96 VP8/90000
a=rtpmap:97 rtx/90000
a=fmtp:97 apt=96
a=rid:f send
a=rid:q send
a=simulcast:send f;q
m=application 9 UDP/DTLS/SCTP webrtc-datachannel
a=mid:1
a=sctp-port:5000
""".replace("\n", "\r\n")


def test_what_is_written_is_read_again() -> None:
    read = parse(write(DESCRIPTION, 3, 65536))
    assert (read.ufrag, read.password, read.setup) == ("abcd", "p" * 22, "actpass")
    assert read.fingerprints == (("sha-256", "AA:BB"),)
    assert [(s.kind, s.mid, s.direction) for s in read.sections] == [
        ("application", "data", "sendrecv"),
        ("audio", "0", "sendonly"),
        ("video", "1", "inactive"),
    ]
    assert read.sections[1].codecs == (OPUS,)
    assert (read.sections[1].stream_id, read.sections[1].track_id) == ("PA_1|TR_1", "TR_1")
    assert read.sections[2].codecs == (H264,)


def test_a_browsers_offer_is_understood() -> None:
    video, data = parse(BROWSER).sections
    assert data.kind == "application"
    assert video.sends
    assert video.track_id == "camera"
    assert [codec.name for codec in video.codecs] == ["h264", "vp8", "rtx"]
    assert video.codecs[0].feedback == ("nack", "nack pli")
    assert video.rids == ("f", "q")
    assert video.extensions == ((4, MID_EXTENSION), (10, RID_EXTENSION))


def test_only_our_own_address_is_ever_written() -> None:
    lines = write(DESCRIPTION, 1, 65536).splitlines()
    addresses = [line for line in lines if line.startswith(("o=", "c=", "a=candidate"))]
    assert len(addresses) == 1 + 2 * len(DESCRIPTION.sections)
    assert all("127.0.0.1" in line for line in addresses)


def test_a_refused_section_is_left_out_of_the_bundle() -> None:
    sections = (DESCRIPTION.sections[0], refused(DESCRIPTION.sections[1]))
    text = write(Description("abcd", "p" * 22, (("sha-256", "AA"),), "active", sections), 1, 65536)
    assert "a=group:BUNDLE data\r\n" in text
    assert "m=audio 0 UDP/TLS/RTP/SAVPF 111" in text
    assert not parse(text).sections[1].accepted


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("a=ice-ufrag:u123", ""),
        ("a=ice-ufrag:u123", "a=ice-ufrag:u"),
        ("a=ice-pwd:pppppppppppppppppppppp", "a=ice-pwd:ü"),
        ("a=fingerprint:sha-256 aa:bb", ""),
        ("a=fingerprint:sha-256 aa:bb", "a=fingerprint:sha-256"),
        ("a=setup:actpass", "a=setup:holdconn"),
        ("a=mid:0", ""),
        ("a=mid:1", "a=mid:0"),
        ("a=rtpmap:102 H264/90000", "a=rtpmap:x H264/90000"),
        ("a=rtpmap:102 H264/90000", "a=rtpmap:102 H264"),
        ("UDP/TLS/RTP/SAVPF 102 96 97", "UDP/TLS/RTP/SAVPF 102 x"),
        ("a=msid:- camera", "a=msid:- " + "c" * 5000),
        (BROWSER, ""),
        (BROWSER, "v=0\r\n"),
        (BROWSER, BROWSER + "m=audio 9 X 0\r\n" * 70),
    ],
)
def test_a_malformed_offer_is_refused(old: str, new: str) -> None:
    assert old in BROWSER
    with pytest.raises(SessionDescriptionError):
        parse(BROWSER.replace(old, new))


def test_mutated_offers_are_read_or_refused() -> None:
    chance = random.Random(1)
    outcomes = {"read": 0, "refused": 0}
    for _ in range(3000):
        text = list(BROWSER)
        for _ in range(chance.randint(1, 6)):
            at = chance.randrange(len(text))
            text[at : at + chance.randint(0, 4)] = chance.choice(["", "\n", ":", " ", "9" * 30, "a=", "m=", "é\x00"])
        try:
            write(parse("".join(text)), 1, 65536)
            outcomes["read"] += 1
        except SessionDescriptionError:
            outcomes["refused"] += 1
    assert min(outcomes.values()) > 100
