"""Offers and answers of WebRTC (SDP), as far as a room that forwards packets needs them.

One bundle per connection: all sections share the transport of the first. Sources: RFC 8866 (SDP), RFC 9143 (bundle),
RFC 8829 (offer and answer), RFC 8853 (simulcast).
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from asimov_gym.room.errors import SessionDescriptionError

MEDIA = ("audio", "video")
DIRECTIONS = ("sendrecv", "sendonly", "recvonly", "inactive")
MID_EXTENSION = "urn:ietf:params:rtp-hdrext:sdes:mid"
RID_EXTENSION = "urn:ietf:params:rtp-hdrext:sdes:rtp-stream-id"
_SECTIONS_MAX = 64
_LINE_MAX = 2048
_ICE = re.compile(r"[A-Za-z0-9+/]{4,256}")
_TOKEN = re.compile(r"[!#$%&'*+\-.^_`{|}~0-9A-Za-z]{1,128}")


@dataclass(frozen=True)
class Codec:
    """One way of coding a section's media."""

    payload_type: int
    encoding: str
    """As in `rtpmap`: `opus/48000/2`."""
    parameters: str = ""
    """As in `fmtp`."""
    feedback: tuple[str, ...] = ()
    """Kinds of RTCP feedback."""

    @property
    def name(self) -> str:
        """Name in lower case: `opus`, `h264`."""
        return self.encoding.split("/")[0].lower()


@dataclass(frozen=True)
class Section:
    """One `m=` section."""

    kind: str
    """`audio`, `video` or `application` (data channels)."""
    mid: str
    direction: str = "sendrecv"
    codecs: tuple[Codec, ...] = ()
    stream_id: str = ""
    track_id: str = ""
    """Track that its sender puts on this section, from `msid`."""
    rids: tuple[str, ...] = ()
    """Simulcast layers."""
    extensions: tuple[tuple[int, str], ...] = ()
    """Header extensions that name a packet's section and layer: number and kind. Others are not read."""
    ssrc: int | None = None
    """Synchronisation source of the packets, where we are the sender."""
    accepted: bool = True

    @property
    def sends(self) -> bool:
        """Whether the side that wrote the description sends on this section."""
        return self.accepted and self.direction in ("sendrecv", "sendonly")


@dataclass(frozen=True)
class Description:
    """An offer or answer: the transport and its sections."""

    ufrag: str
    password: str
    fingerprints: tuple[tuple[str, str], ...]
    """Hash and value of the certificate."""
    setup: str
    """Role in DTLS: `actpass`, `active` or `passive`."""
    sections: tuple[Section, ...]
    candidates: tuple[str, ...] = ()
    """Addresses; only written, never read: the room sends to nobody who has not reached it first."""


def parse(text: str) -> Description:
    """Read an offer or answer.

    Raises:
        SessionDescriptionError: it is none, or lacks what a connection needs.
    """
    try:
        return _parse(text)
    except (ValueError, IndexError, KeyError) as error:
        if isinstance(error, SessionDescriptionError):
            raise
        raise SessionDescriptionError("not a session description") from error


def _parse(text: str) -> Description:
    blocks: list[list[str]] = [[]]
    for line in text.splitlines():
        if len(line) > _LINE_MAX:
            raise SessionDescriptionError(f"a line of a session description is longer than {_LINE_MAX} characters")
        if line.startswith("m="):
            blocks.append([])
        blocks[-1].append(line)
    if not 2 <= len(blocks) <= _SECTIONS_MAX + 1:
        raise SessionDescriptionError(f"a session description has {len(blocks) - 1} sections; allowed: 1 to 64")
    sections = tuple(_section(block) for block in blocks[1:])
    if len({section.mid for section in sections}) != len(sections):
        raise SessionDescriptionError("two sections of a session description have the same mid")
    # The bundle's transport is described once, in the session's part or in any section that is in use.
    transport: dict[str, str] = {}
    fingerprints: list[tuple[str, str]] = []
    for block in blocks:
        for key, value in _attributes(block):
            if key in ("ice-ufrag", "ice-pwd", "setup"):
                transport.setdefault(key, value)
            elif key == "fingerprint":
                algorithm, digest = value.split()
                if (algorithm.lower(), digest.upper()) not in fingerprints:
                    fingerprints.append((algorithm.lower(), digest.upper()))
    missing = [key for key in ("ice-ufrag", "ice-pwd", "setup") if not transport.get(key)]
    if missing or not fingerprints:
        raise SessionDescriptionError(f"a session description lacks {', '.join(missing) or 'a fingerprint'}")
    if not (_ICE.fullmatch(transport["ice-ufrag"]) and _ICE.fullmatch(transport["ice-pwd"])):
        raise SessionDescriptionError("the ICE credentials of a session description are malformed")
    if transport["setup"] not in ("actpass", "active", "passive"):
        raise SessionDescriptionError("the DTLS role of a session description is unknown")
    return Description(transport["ice-ufrag"], transport["ice-pwd"], tuple(fingerprints), transport["setup"], sections)


def _attributes(block: Sequence[str]) -> Iterator[tuple[str, str]]:
    for line in block:
        if line.startswith("a="):
            key, _, value = line[2:].strip().partition(":")
            yield key, value


def _section(block: Sequence[str]) -> Section:
    kind, port, _, *formats = block[0][2:].split()
    mid, direction, stream_id, track_id = "", "sendrecv", "", ""
    encodings: dict[int, str] = {}
    parameters: dict[int, str] = {}
    feedback: dict[int, list[str]] = {}
    rids: list[str] = []
    extensions: list[tuple[int, str]] = []
    for key, value in _attributes(block):
        if key == "mid":
            mid = value
        elif key in DIRECTIONS:
            direction = key
        elif key == "msid":
            stream_id, _, track_id = value.partition(" ")
        elif key == "rtpmap":
            number, _, encoding = value.partition(" ")
            encodings[int(number)] = encoding
        elif key == "fmtp":
            number, _, parameter = value.partition(" ")
            parameters[int(number)] = parameter
        elif key == "rtcp-fb" and not value.startswith("*"):
            number, _, what = value.partition(" ")
            feedback.setdefault(int(number), []).append(what)
        elif key == "rid":
            rids.append(value.split()[0])
        elif key == "extmap":
            number, uri = value.split()[:2]
            if uri in (MID_EXTENSION, RID_EXTENSION):
                extensions.append((int(number.split("/")[0]), uri))
    if not _TOKEN.fullmatch(mid):
        raise SessionDescriptionError("a section of a session description has no mid")
    order = [int(number) for number in formats] if kind in MEDIA else []
    codecs = tuple(
        Codec(number, encodings[number], parameters.get(number, ""), tuple(feedback.get(number, ())))
        for number in order
        if number in encodings
    )
    if not all(0 <= codec.payload_type <= 127 and codec.encoding.count("/") in (1, 2) for codec in codecs):
        raise SessionDescriptionError("a codec of a session description is malformed")
    return Section(
        kind,
        mid,
        direction,
        codecs,
        stream_id,
        track_id,
        tuple(rids),
        tuple(extensions),
        accepted=port != "0" or kind not in MEDIA,
    )


def write(description: Description, version: int, packet_bytes: int) -> str:
    """The text of an offer or answer.

    Args:
        description: what it says.
        version: grows with each description of a connection.
        packet_bytes: largest message of a data channel.
    """
    bundle = [section.mid for section in description.sections if section.accepted]
    lines = [
        "v=0",
        f"o=- 1 {version} IN IP4 127.0.0.1",
        "s=-",
        "t=0 0",
        f"a=group:BUNDLE {' '.join(bundle)}",
        "a=msid-semantic: WMS *",
        "a=ice-options:trickle",
    ]
    lines += [f"a=fingerprint:{algorithm} {digest}" for algorithm, digest in description.fingerprints]
    for section in description.sections:
        lines += _written(section, description, packet_bytes)
    return "\r\n".join(lines) + "\r\n"


def _written(section: Section, description: Description, packet_bytes: int) -> list[str]:
    port = 9 if section.accepted else 0
    if section.kind in MEDIA:
        # A refused section still has to name a format.
        formats = " ".join(str(codec.payload_type) for codec in section.codecs) or "0"
        lines = [f"m={section.kind} {port} UDP/TLS/RTP/SAVPF {formats}"]
    else:
        lines = [f"m={section.kind} {port} UDP/DTLS/SCTP webrtc-datachannel"]
    lines += ["c=IN IP4 127.0.0.1", f"a=mid:{section.mid}"]
    if not section.accepted:
        return [*lines, "a=inactive"]
    lines += [
        f"a=ice-ufrag:{description.ufrag}",
        f"a=ice-pwd:{description.password}",
        f"a=setup:{description.setup}",
        *(f"a=candidate:{candidate}" for candidate in description.candidates),
        "a=end-of-candidates",
    ]
    if section.kind not in MEDIA:
        return [*lines, "a=sctp-port:5000", f"a=max-message-size:{packet_bytes}"]
    lines += [f"a={section.direction}", "a=rtcp-mux", "a=rtcp-rsize"]
    if section.track_id:
        lines.append(f"a=msid:{section.stream_id or '-'} {section.track_id}")
    lines += [f"a=extmap:{number} {uri}" for number, uri in section.extensions]
    for codec in section.codecs:
        lines.append(f"a=rtpmap:{codec.payload_type} {codec.encoding}")
        if codec.parameters:
            lines.append(f"a=fmtp:{codec.payload_type} {codec.parameters}")
        lines += [f"a=rtcp-fb:{codec.payload_type} {what}" for what in codec.feedback]
    if section.rids:
        lines += [*(f"a=rid:{rid} recv" for rid in section.rids), f"a=simulcast:recv {';'.join(section.rids)}"]
    if section.ssrc is not None:
        lines += [
            f"a=ssrc:{section.ssrc} cname:room",
            f"a=ssrc:{section.ssrc} msid:{section.stream_id} {section.track_id}",
        ]
    return lines


def refused(section: Section) -> Section:
    """The same section, refused."""
    return replace(section, accepted=False, direction="inactive", codecs=section.codecs[:1], rids=(), track_id="")
