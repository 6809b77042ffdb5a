"""One WebRTC connection to a client: ICE, DTLS, data channels and raw media packets, on 127.0.0.1 alone.

Built of aiortc's transports without its peer connection, which would listen on every address of the machine and decode
and encode all media. The one UDP socket is bound to 127.0.0.1, so that nothing outside this machine reaches it. The
client library, which never offers a loopback address itself, sends from the address of another interface to ours; the
kernel delivers that locally. Addresses that a client names are never used: whoever knows the ICE password and reaches
the socket is answered, so the room sends to nobody of its own accord.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Awaitable, Callable

import pylibsrtp
from aioice import Candidate, Connection
from aiortc import (
    RTCCertificate,
    RTCDtlsFingerprint,
    RTCDtlsParameters,
    RTCDtlsTransport,
    RTCIceGatherer,
    RTCIceParameters,
    RTCIceTransport,
    RTCSctpTransport,
)
from aiortc.rtcdatachannel import RTCDataChannel, RTCDataChannelParameters
from aiortc.rtcsctptransport import RTCSctpCapabilities
from aiortc.sdp import candidate_to_sdp

from asimov_gym.room.session_description import Description

LOOPBACK = "127.0.0.1"
RELIABLE, LOSSY, DATA_TRACK = "_reliable", "_lossy", "_data_track"
"""Data channels of the client library."""
_UNORDERED_BACKLOG = 262_144
"""Bytes waiting in an unordered channel beyond which new messages are dropped, as on a slow line."""

_log = logging.getLogger(__name__)

MessageHandler = Callable[[str, bytes], None]
PacketHandler = Callable[[bytes], Awaitable[None]]


class _LoopbackConnection(Connection):
    async def get_component_candidates(self, component: int, addresses: list[str], timeout: int = 5) -> list[Candidate]:
        return await super().get_component_candidates(component, [LOOPBACK], timeout)


class _LoopbackGatherer(RTCIceGatherer):
    def __init__(self) -> None:
        super().__init__(iceServers=[])
        self._connection = _LoopbackConnection(ice_controlling=False)


class _PacketDtlsTransport(RTCDtlsTransport):
    """Hands decrypted RTP and RTCP over as they are."""

    on_rtp: PacketHandler | None = None
    on_rtcp: PacketHandler | None = None

    async def _handle_rtp_data(self, data: bytes, arrival_time_ms: int) -> None:
        if self.on_rtp is not None:
            await self.on_rtp(data)

    async def _handle_rtcp_data(self, data: bytes) -> None:
        if self.on_rtcp is not None:
            await self.on_rtcp(data)


class PeerTransport:
    """A connection to a client over which either side has offered.

    Args:
        certificate: of the server.
        offering: whether the room offers (it then opens the data channels) or answers.
        packet_bytes: largest message of a data channel.
        on_message: gets the label of a data channel and a message.
        on_rtp: gets each media packet.
        on_rtcp: gets each control packet of media.
        on_open: called when the data channels of an offering connection are open.
        on_lost: called once when the connection is lost or cannot be made.
    """

    def __init__(
        self,
        certificate: RTCCertificate,
        offering: bool,
        packet_bytes: int,
        on_message: MessageHandler,
        on_rtp: PacketHandler,
        on_rtcp: PacketHandler,
        on_open: Callable[[], None],
        on_lost: Callable[[], None],
    ) -> None:
        self.offering = offering
        self.remote: Description | None = None
        """What the client said first."""
        self.dropped = 0
        """Messages dropped because an unordered channel was full."""
        self._packet_bytes = packet_bytes
        self._on_message, self._on_open, self._on_lost = on_message, on_open, on_lost
        self._gatherer = _LoopbackGatherer()
        self._ice = RTCIceTransport(self._gatherer)
        self._ice._connection.ice_controlling = offering
        self._dtls = _PacketDtlsTransport(self._ice, [certificate])
        self._dtls.on_rtp, self._dtls.on_rtcp = on_rtp, on_rtcp
        self._dtls.on("statechange", self._check_state)
        self._sctp = RTCSctpTransport(self._dtls)
        self._sctp.on("datachannel", self._add_channel)
        self._certificate = certificate
        self._channels: dict[str, RTCDataChannel] = {}
        self._connecting: asyncio.Task[None] | None = None
        self._closed = False
        self._is_open = False

    async def open(self) -> None:
        """Open the socket. Doing it twice does nothing."""
        if not self._closed:
            await self._gatherer.gather()

    def local(self, setup: str) -> Description:
        """Our transport's part of an offer or answer, with no sections."""
        ice = self._gatherer.getLocalParameters()
        fingerprints = tuple(
            (f.algorithm, f.value) for f in self._certificate.getFingerprints() if f.algorithm == "sha-256"
        )
        candidates = tuple(candidate_to_sdp(c) for c in self._gatherer.getLocalCandidates())
        assert ice.usernameFragment is not None and ice.password is not None
        return Description(ice.usernameFragment, ice.password, fingerprints, setup, (), candidates)

    def connect(self, remote: Description, client_role: bool) -> None:
        """Start to connect, in the background.

        Args:
            remote: what the client said.
            client_role: whether we are the client of DTLS.
        """
        if self._connecting is None and not self._closed:
            self.remote = remote
            self._connecting = asyncio.create_task(self._connect(remote, client_role))

    async def _connect(self, remote: Description, client_role: bool) -> None:
        try:
            await self._ice.start(RTCIceParameters(usernameFragment=remote.ufrag, password=remote.password))
            if self._ice.state != "completed":
                return self._lost()
            self._dtls._set_role("client" if client_role else "server")
            fingerprints = [RTCDtlsFingerprint(algorithm, value) for algorithm, value in remote.fingerprints]
            await self._dtls.start(RTCDtlsParameters(fingerprints))
            if self._dtls.state != "connected":
                return self._lost()
            if self.offering:
                self._open_channels()
            await self._sctp.start(RTCSctpCapabilities(maxMessageSize=self._packet_bytes), 5000)
        except Exception:  # a peer that breaks the protocol must not reach further than its own connection
            _log.debug("connecting", exc_info=True)
            self._lost()

    def _open_channels(self) -> None:
        for label in (RELIABLE, LOSSY, DATA_TRACK):
            ordered = label == RELIABLE
            parameters = RTCDataChannelParameters(label=label, ordered=ordered, maxRetransmits=None if ordered else 0)
            self._add_channel(RTCDataChannel(self._sctp, parameters))

    def _add_channel(self, channel: RTCDataChannel) -> None:
        label = channel.label
        if label not in (RELIABLE, LOSSY, DATA_TRACK) or label in self._channels:
            channel.close()
            return
        self._channels[label] = channel
        channel.on("open", self._check_open)

        def on_message(message: bytes | str) -> None:
            if isinstance(message, bytes) and len(message) <= self._packet_bytes:
                self._on_message(label, message)

        channel.on("message", on_message)

    def _check_open(self) -> None:
        ready = len(self._channels) == 3 and all(c.readyState == "open" for c in self._channels.values())
        if ready and not self._is_open:
            self._is_open = True
            self._on_open()

    def _check_state(self) -> None:
        if self._dtls.state in ("closed", "failed"):
            self._lost()

    def _lost(self) -> None:
        if not self._closed:
            self._closed = True
            self._on_lost()

    def send(self, label: str, message: bytes) -> int:
        """Send a message on a data channel, or drop it if the channel is not open or, unordered, full.

        Returns:
            Bytes that wait in the channel now.
        """
        channel = self._channels.get(label)
        if channel is None or channel.readyState != "open":
            self.dropped += 1
            return 0
        if not channel.ordered and channel.bufferedAmount > _UNORDERED_BACKLOG:
            self.dropped += 1
            return channel.bufferedAmount
        channel.send(message)
        return channel.bufferedAmount

    async def send_media(self, packet: bytes) -> None:
        """Send an RTP or RTCP packet, or drop it if there is no connection."""
        with contextlib.suppress(ConnectionError, pylibsrtp.Error):
            await self._dtls._send_rtp(packet)

    async def close(self) -> None:
        """End the connection and close its socket."""
        self._closed = True
        if self._connecting is not None:
            self._connecting.cancel()
            await asyncio.gather(self._connecting, return_exceptions=True)
        for part in (self._sctp, self._dtls, self._ice):
            try:
                await part.stop()
            except Exception:  # a library's state must not keep the rest from closing
                _log.debug("closing %s", type(part).__name__, exc_info=True)
        for emitter in (self._sctp, self._dtls, self._ice, *self._channels.values()):
            emitter.remove_all_listeners()
