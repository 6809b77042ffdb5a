"""The rosbridge lane: the motion-mode services as JSON over a WebSocket, for clients without ROS.

As with rosbridge itself, nothing is authenticated. Web pages of other machines are kept out: a browser says where a
page comes from, and only pages of this machine may connect.
"""

from __future__ import annotations

import asyncio
import json
import logging
import re
import socket
from contextlib import suppress
from http import HTTPStatus
from typing import Any

from asimov_gym.edge.control import Client
from asimov_gym.edge.edge import Edge
from asimov_gym.edge.lifecycle import Lifecycle
from asimov_gym.edge.listener import EdgeListener
from asimov_gym.edge.loop_thread import LoopThread
from asimov_gym.edge.motion_modes_messages import VELOCITY
from asimov_gym.edge.motion_modes_service import VELOCITY_KIND, MotionModes
from asimov_gym.edge.transports import TransportError
from asimov_gym.edge.transports.rosbridge_protocol import RosbridgeSession
from asimov_gym.edge.transports.udp import check_port, is_loopback
from asimov_gym.edge.verdict import Verdict

try:
    from websockets.asyncio.server import ServerConnection, serve
    from websockets.exceptions import ConnectionClosed
    from websockets.http11 import Request, Response
except ImportError as missing:
    raise ImportError("serving rosbridge needs websockets: pip install 'asimov-gym[rosbridge]'") from missing

PORT = 9090
"""TCP port that rosbridge takes by custom."""
MAX_MESSAGE_BYTES = 65_536
"""A client that sends a longer message is disconnected. The longest sensible one is under 1 KiB."""
MAX_CLIENTS = 16
"""One more is refused."""
MAX_QUEUED = 64
"""Messages kept for a client that does not read. Beyond it nothing is read from it, and what others publish is left
out."""
PING_S = 10.0
"""A client that does not answer a ping in this time is gone."""
STALL_S = 10.0
"""So is one that takes nothing of what waits for it in this time: a ping does not even reach it."""

_LOCAL_PAGE = re.compile(r"https?://(localhost|127\.0\.0\.1|\[::1\])(:\d+)?")
_STOP_S = 2.0
_log = logging.getLogger(__name__)


class RosbridgeLane(Lifecycle, EdgeListener):
    """Serves motion modes over WebSocket between `start` and `stop`, or as a context manager.

    Args:
        edge: the robot's, to hear of velocities that other lanes take.
        modes: the service.
        port: TCP; 0 for any free one, known after `start`.
        listen: address that it is opened on.

    Raises:
        TransportError: the port is out of range.
    """

    def __init__(self, edge: Edge, modes: MotionModes, port: int = PORT, listen: str = "127.0.0.1") -> None:
        check_port("--motion-modes rosbridge:PORT", port)
        self.port = port
        self.listen = listen
        self._edge = edge
        self._modes = modes
        self._connections: dict[ServerConnection, _Connection] = {}
        self._listening = False
        self._end = asyncio.Event()
        self._socket: socket.socket | None = None
        self._thread: LoopThread | None = None

    @property
    def connect_line(self) -> str:
        """Where it is, for people."""
        host = f"[{self.listen}]" if ":" in self.listen else self.listen
        return f"ws://{host}:{self.port}"

    @property
    def clients(self) -> int:
        """How many are connected."""
        return len(self._connections)

    def start(self) -> None:
        """Open the port and serve, in a thread. No effect while it runs.

        Raises:
            TransportError: the port is taken or not ours to open, or the address is unknown here.
        """
        if self._thread is not None:
            return
        try:
            family, _, _, _, address = socket.getaddrinfo(self.listen, self.port, type=socket.SOCK_STREAM)[0]
            self._socket = socket.create_server(address[:2], family=family, backlog=MAX_CLIENTS)
        except OSError as problem:
            raise TransportError(
                f"cannot serve rosbridge on TCP port {self.port} of {self.listen}: {problem.strerror}; choose another "
                "with --motion-modes rosbridge:PORT"
            ) from None
        self.port = self._socket.getsockname()[1]
        if not is_loopback(self.listen):
            _log.warning(
                "rosbridge is served on %s:%d, which is not loopback: nothing on it is authenticated, anyone who "
                "reaches this port can drive the robot",
                self.listen,
                self.port,
            )
        self._end = asyncio.Event()
        self._thread = LoopThread("rosbridge-lane", self._serve)
        self._thread.start()
        self._edge.attach(self)

    def stop(self) -> None:
        """Close the port and all connections. No effect if it is not open."""
        if self._thread is None:
            return
        self._edge.detach(self)
        self._thread.call(self._end.set)
        if not self._thread.join(_STOP_S):
            self._thread.cancel()
            self._thread.join(_STOP_S)
        self._thread = None
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    # -- what others publish -----------------------------------------------------------------------

    def on_command(self, received_us: int, client: Client, packet: bytes, verdict: Verdict) -> None:
        """Pass a velocity on to those who listen to the topic, whatever became of it: so does a ROS topic."""
        if self._listening and verdict.kind == VELOCITY_KIND and self._thread is not None:
            self._thread.call(self._relay, packet)

    def _relay(self, payload: bytes) -> None:
        # The payload is an object with the members `topic` and `msg`, which is all but one of this op's.
        text = '{"op": "publish", ' + payload.decode().removeprefix("{")
        for connection in self._connections.values():
            if VELOCITY in connection.session.subscriptions:
                with suppress(asyncio.QueueFull):
                    connection.queue.put_nowait(text)

    # -- the lane's thread -------------------------------------------------------------------------

    async def _serve(self) -> None:
        try:
            async with serve(
                self._converse,
                sock=self._socket,
                origins=[None, _LOCAL_PAGE],
                compression=None,
                process_request=self._admit,
                max_size=MAX_MESSAGE_BYTES,
                ping_interval=PING_S,
                ping_timeout=PING_S,
                close_timeout=_STOP_S / 2.0,
                logger=_Quiet(_log),
            ):
                await self._end.wait()  # then the connections are closed
        except Exception:
            _log.exception("the rosbridge lane failed")

    def _admit(self, connection: ServerConnection, request: Request) -> Response | None:
        if len(self._connections) < MAX_CLIENTS:
            return None
        _log.warning("rosbridge: %d clients are connected, no more are taken", MAX_CLIENTS)
        return connection.respond(HTTPStatus.SERVICE_UNAVAILABLE, "too many clients\n")

    async def _converse(self, socket: ServerConnection) -> None:
        """Serve one client until it is gone."""
        if len(self._connections) >= MAX_CLIENTS:  # several came at once
            await socket.close(1013, "too many clients")
            return
        connection = self._connections[socket] = _Connection(RosbridgeSession(self._modes))
        writer = asyncio.create_task(connection.write(socket))
        try:
            async for text in socket:
                answer = connection.session.take(text)
                self._listening = any(each.session.subscriptions for each in self._connections.values())
                if answer is not None:
                    await asyncio.wait_for(connection.queue.put(json.dumps(answer)), STALL_S)
        except (ConnectionClosed, TimeoutError):
            socket.transport.abort()  # without a close frame: so do clients that crash
        finally:
            del self._connections[socket]
            self._listening = any(each.session.subscriptions for each in self._connections.values())
            writer.cancel()


class _Connection:
    """One client: its session, and what is still to be sent to it."""

    def __init__(self, session: RosbridgeSession) -> None:
        self.session = session
        self.queue: asyncio.Queue[str] = asyncio.Queue(MAX_QUEUED)

    async def write(self, socket: ServerConnection) -> None:
        with suppress(ConnectionClosed, TimeoutError):
            while True:
                text = await self.queue.get()
                await asyncio.wait_for(socket.send(text), STALL_S)
        socket.transport.abort()


class _Quiet(logging.LoggerAdapter[logging.Logger]):
    """What the WebSocket library says of single connections is of no interest to the robot's operator."""

    def log(self, level: int, msg: object, *args: Any, **kwargs: Any) -> None:
        super().log(min(level, logging.DEBUG), msg, *args, **kwargs)
