"""The room server: one loopback port for signalling and tokens, one loopback socket for each connection."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import ipaddress
import logging

from aiohttp import web
from aiortc import RTCCertificate
from livekit.protocol import models, rtc

from asimov_gym.room.errors import RoomError, TokenError
from asimov_gym.room.limits import RoomLimits
from asimov_gym.room.participant import RECONNECT, Participant
from asimov_gym.room.room import Room
from asimov_gym.room.signalling import Signalling
from asimov_gym.room.token_desk import PATH, TokenDesk, bearer
from asimov_gym.room.tokens import Admission, Grants, RoomKeys

_log = logging.getLogger(__name__)
_REPORT_S = 1.0


class _WithoutRequest(logging.Filter):
    """Keeps the kind of an HTTP error and leaves out its text, which may quote a request with its token."""

    def filter(self, record: logging.LogRecord) -> bool:
        if record.exc_info and record.exc_info[0] is not None:
            record.msg = f"{record.getMessage()}: {record.exc_info[0].__name__}"
            record.args, record.exc_info, record.exc_text = (), None, None
        return True


_http_log = logging.getLogger(f"{__name__}.http")
_http_log.addFilter(_WithoutRequest())


class RoomServer:
    """A small development server that the public LiveKit client library joins. It can be started again after a stop.

    Args:
        host: address to listen on; only a loopback address is allowed.
        port: TCP port; 0 takes a free one at the first start and keeps it.
        room: the room that tokens are for unless they ask for another.
        keys: secrets; new ones if None. With the same keys a restarted server accepts the tokens of before.
        limits: how many, how large, how long.

    Raises:
        RoomError: the address is not a loopback address, or the port is none.
    """

    def __init__(
        self,
        host: str = "127.0.0.1",
        port: int = 0,
        room: str = "robot-sim",
        keys: RoomKeys | None = None,
        limits: RoomLimits | None = None,
    ) -> None:
        check_loopback(host)
        if not 0 <= port <= 65_535:
            raise RoomError(f"port is {port}; allowed: 0 to 65535")
        # One address, not the two that the name may stand for.
        self.host = "127.0.0.1" if host == "localhost" else host
        self.port, self.room = port, room
        self.keys = RoomKeys.generate() if keys is None else keys
        self.limits = RoomLimits() if limits is None else limits
        self.rooms: dict[str, Room] = {}
        """Rooms that somebody is in, by name."""
        self._runner: web.AppRunner | None = None
        self._serving: set[asyncio.Task[object]] = set()
        self._reporter: asyncio.Task[None] | None = None
        self._stopping = False
        self._certificate = RTCCertificate.generateCertificate()

    @property
    def url(self) -> str:
        """Where clients join: `ws://127.0.0.1:7880`."""
        return f"ws://{_in_url(self.host)}:{self.port}"

    @property
    def token_url(self) -> str:
        """Where clients ask for tokens."""
        return f"http://{_in_url(self.host)}:{self.port}{PATH}"

    @property
    def participants(self) -> int:
        """Participants of all rooms."""
        return sum(len(room.participants) for room in self.rooms.values())

    @property
    def statement(self) -> str:
        """What this server is and is not, for people, in four lines."""
        limits = self.limits
        return (
            "A room for development on this machine alone: no TLS, no TURN, no access from the network.\n"
            f"At most {limits.rooms} rooms of {limits.participants} participants; nothing is stored.\n"
            "Data packets, data tracks and RPC are passed on; audio (Opus) and video (H.264, VP8) are forwarded as\n"
            "they are, of simulcast video the largest layer. Clients need a network interface besides loopback."
        )

    def token(self, room: str | None, identity: str, **grants: bool) -> str:
        """A token for a room, the default one if None. `grants` are fields of `Grants`."""
        lifetime = self.limits.token_lifetime_s
        return self.keys.issue(room or self.room, identity, Grants(**grants), lifetime_s=lifetime)

    async def start(self) -> None:
        """Listen.

        Raises:
            RoomError: the port is in use, or the address is not this machine's.
        """
        if self._runner is not None:
            return
        desk = TokenDesk(self.keys, self.limits, self.room)
        application = web.Application(client_max_size=self.limits.body_bytes)
        application.router.add_get("/", _greet)
        application.router.add_get("/rtc", self._join)
        application.router.add_get("/rtc/validate", self._validate)
        application.router.add_post(PATH, desk.answer)
        # No access log: a client may put its token in the address.
        runner = web.AppRunner(
            application, access_log=None, logger=_http_log, handle_signals=False, shutdown_timeout=1.0
        )
        await runner.setup()
        try:
            await web.TCPSite(runner, self.host, self.port).start()
        except OSError as error:
            await runner.cleanup()
            busy = error.errno == errno.EADDRINUSE
            reason = "the port is in use" if busy else error.strerror or str(error)
            raise RoomError(f"cannot listen on {self.host} port {self.port}: {reason}") from error
        self.port = runner.addresses[0][1]
        self._runner, self._stopping = runner, False
        self._reporter = asyncio.create_task(self._report())

    async def stop(self) -> None:
        """Send everyone away, to come back if the room does, and close. Stopping twice does nothing."""
        runner, self._runner = self._runner, None
        if runner is None:
            return
        self._stopping = True
        if self._reporter is not None:
            self._reporter.cancel()
        for room in list(self.rooms.values()):
            for participant in list(room.participants.values()):
                reason = models.DisconnectReason.SERVER_SHUTDOWN
                participant.send_away("the room closes", reason, come_back=True)
        if self._serving:
            await asyncio.wait(self._serving, timeout=3.0)
        await runner.cleanup()
        self.rooms.clear()

    async def __aenter__(self) -> RoomServer:
        await self.start()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.stop()

    # HTTP

    def _admission(self, request: web.Request) -> Admission:
        token = bearer(request) or request.query.get("access_token", "")
        return self.keys.verify(token)

    async def _validate(self, request: web.Request) -> web.Response:
        try:
            self._admission(request)
        except TokenError as error:
            return web.Response(status=401, text=str(error))
        return web.Response(text="success")

    async def _join(self, request: web.Request) -> web.StreamResponse:
        try:
            admission = self._admission(request)
        except TokenError as error:
            _log.warning("a client was refused: %s", error)
            return web.Response(status=401, text=str(error))
        if (refusal := self._refusal(admission)) is not None:
            _log.warning("%s was refused: %s", admission.identity, refusal)
            return web.Response(status=503, text=refusal)
        socket = web.WebSocketResponse(max_msg_size=self.limits.signal_bytes, compress=False)
        if not socket.can_prepare(request).ok:
            return web.Response(status=426, text="a WebSocket is served here")
        await socket.prepare(request)
        if request.query.get("reconnect") == "1":
            # Nothing of a lost connection is kept: the client is told to join anew.
            reason = models.DisconnectReason.STATE_MISMATCH
            leave = rtc.LeaveRequest(reason=reason, action=RECONNECT, can_reconnect=True)
            await socket.send_bytes(rtc.SignalResponse(leave=leave).SerializeToString())
            await socket.close()
            return socket
        task = asyncio.current_task()
        assert task is not None
        self._serving.add(task)
        try:
            await self._serve(admission, socket, request)
        finally:
            self._serving.discard(task)
        return socket

    def _refusal(self, admission: Admission) -> str | None:
        room = self.rooms.get(admission.room)
        if self._stopping:
            return "the server is closing"
        if room is None and len(self.rooms) >= self.limits.rooms:
            return f"there are {len(self.rooms)} rooms, no more are allowed"
        if room is not None and room.full and admission.identity not in room.participants:
            return f"{room.name} is full"
        return None

    async def _serve(self, admission: Admission, socket: web.WebSocketResponse, request: web.Request) -> None:
        room = self.rooms.setdefault(admission.room, Room(admission.room, self.limits))
        protocol = request.query.get("client_protocol", "0")
        participant = Participant(
            room,
            admission,
            Signalling(socket, self.limits.ping_timeout_s),
            self._certificate,
            self.limits,
            auto_subscribe=request.query.get("auto_subscribe", "1") in ("1", "true"),
            client_protocol=int(protocol) if protocol.isdecimal() and len(protocol) < 4 else 0,
        )
        try:
            await room.admit(participant)
            await participant.run()
        finally:
            room.remove(participant, "it failed")
            await participant.close()
            if not room.participants and self.rooms.get(room.name) is room:
                del self.rooms[room.name]

    async def _report(self) -> None:
        while True:
            await asyncio.sleep(_REPORT_S)
            for room in list(self.rooms.values()):
                with contextlib.suppress(ConnectionError):
                    await room.report()


def check_loopback(host: str) -> None:
    """Raise a RoomError if the host is anything but a loopback address."""
    with contextlib.suppress(ValueError):
        if host == "localhost" or ipaddress.ip_address(host).is_loopback:
            return
    raise RoomError(f"the room is never offered to a network: {host!r} is not a loopback address such as 127.0.0.1")


def _in_url(host: str) -> str:
    return f"[{host}]" if ":" in host else host


async def _greet(request: web.Request) -> web.Response:
    return web.Response(text="OK")
