"""The WebSocket of a participant: protobuf messages up and down, with a bound on what waits and on silence."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator

from aiohttp import WSMsgType, web
from google.protobuf.message import DecodeError
from livekit.protocol.rtc import SignalRequest, SignalResponse

_WAITING_MAX = 1024
_MALFORMED_MAX = 100
_FLUSH_S = 0.5


class Signalling:
    """Messages to and from one client.

    Args:
        socket: prepared WebSocket.
        timeout_s: silence after which the client counts as gone.
    """

    def __init__(self, socket: web.WebSocketResponse, timeout_s: float) -> None:
        self.malformed = 0
        self._socket, self._timeout_s = socket, timeout_s
        self._waiting: asyncio.Queue[SignalResponse | None] = asyncio.Queue()

    def send(self, message: SignalResponse) -> bool:
        """Put a message in the queue. False if the client has left too many unread."""
        if self._waiting.qsize() >= _WAITING_MAX:
            return False
        self._waiting.put_nowait(message)
        return True

    async def write(self) -> None:
        """Write what is in the queue, until `finish` or the end of the connection."""
        while (message := await self._waiting.get()) is not None:
            try:
                await self._socket.send_bytes(message.SerializeToString())
            except (ConnectionError, RuntimeError):
                return

    async def finish(self, writer: asyncio.Task[None]) -> None:
        """Let the writer empty the queue, for a moment, and close the connection."""
        self._waiting.put_nowait(None)
        await asyncio.wait((writer,), timeout=_FLUSH_S)
        writer.cancel()
        with contextlib.suppress(ConnectionError, RuntimeError, TimeoutError):
            await asyncio.wait_for(self._socket.close(), _FLUSH_S)

    async def requests(self) -> AsyncIterator[SignalRequest]:
        """What the client sends, until it closes the connection, falls silent or sends too much that is malformed."""
        while self.malformed <= _MALFORMED_MAX:
            try:
                message = await self._socket.receive(timeout=self._timeout_s)
            except TimeoutError:
                return
            if message.type is WSMsgType.BINARY:
                request = SignalRequest()
                try:
                    request.ParseFromString(message.data)
                except DecodeError:
                    self.malformed += 1
                else:
                    yield request
            elif message.type in (WSMsgType.CLOSE, WSMsgType.CLOSING, WSMsgType.CLOSED, WSMsgType.ERROR):
                return
            else:
                self.malformed += 1
