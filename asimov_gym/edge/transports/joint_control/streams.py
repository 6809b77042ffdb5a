"""The two streams: joint commands in, states out. Both live on the lane's event loop; the robot's loop never waits for
them."""

from __future__ import annotations

import asyncio
import logging
from collections import deque
from collections.abc import AsyncIterator
from typing import Any

from google.protobuf.message import DecodeError

from asimov_gym.edge.joint_control import CommandStream, JointControlPort
from asimov_gym.edge.transports.joint_control.command_messages import STREAM_STATUS, joint_command
from asimov_gym.edge.transports.joint_control.stamps import response_header
from asimov_gym.edge.transports.joint_control.state_messages import StateMessages
from asimov_gym.edge.transports.joint_control.vendor import robot_command_pb2
from asimov_gym.edge.verdict import DropReason
from asimov_gym.firmware import JointSample, RunEnd

MAX_STATE_STREAMS = 8
MAX_WAITING = 1000
"""States that wait for a slow client, three seconds of them; then the oldest is lost."""
_log = logging.getLogger(__name__)
_Answer = robot_command_pb2.JointControlStreamResponse


class StateStream:
    """What one client has still to get."""

    def __init__(self) -> None:
        self.lost = 0
        """States that the client was too slow for."""
        self._waiting: deque[bytes] = deque(maxlen=MAX_WAITING)
        self._arrived = asyncio.Event()

    def put(self, message: bytes) -> None:
        """One more."""
        if len(self._waiting) == MAX_WAITING:
            self.lost += 1
            if self.lost == 1:
                _log.warning("a client of joint control is too slow for the states: the oldest are lost")
        self._waiting.append(message)
        self._arrived.set()

    async def next(self) -> bytes:
        """The next one."""
        while not self._waiting:
            self._arrived.clear()
            await self._arrived.wait()
        return self._waiting.popleft()


class StateFeed:
    """Takes the states from the robot's loop and hands each, serialized once, to all clients.

    Args:
        port: that gives the states.
        messages: makes messages of them.
        loop: event loop of the clients.
    """

    def __init__(self, port: JointControlPort, messages: StateMessages, loop: asyncio.AbstractEventLoop) -> None:
        self._port = port
        self._messages = messages
        self._loop = loop
        self._inbox: deque[tuple[JointSample, ...]] = deque(maxlen=MAX_WAITING)
        self._streams: list[StateStream] = []
        self._called = False

    def open(self) -> StateStream | None:
        """A stream from now on; None if there are too many."""
        if len(self._streams) >= MAX_STATE_STREAMS:
            return None
        stream = StateStream()
        if not self._streams:
            self._port.subscribe(self._receive)
        self._streams.append(stream)
        return stream

    def close(self, stream: StateStream) -> None:
        """The client has gone."""
        self._streams.remove(stream)
        if not self._streams:
            self._port.unsubscribe(self._receive)
            self._inbox.clear()

    def _receive(self, samples: tuple[JointSample, ...]) -> None:
        """On the robot's loop."""
        self._inbox.append(samples)
        if not self._called:
            self._called = True
            self._loop.call_soon_threadsafe(self._hand_out)

    def _hand_out(self) -> None:
        self._called = False  # before the inbox is emptied: what comes meanwhile calls again
        while self._inbox:
            message = self._messages.streamed(self._inbox.popleft()).SerializeToString()
            for stream in self._streams:
                stream.put(message)


class CommandIntake:
    """Reads one client's stream of joint commands until the client or the robot ends it.

    Args:
        port: that takes them.
        loop: event loop of the client.
    """

    def __init__(self, port: JointControlPort, loop: asyncio.AbstractEventLoop) -> None:
        self._port = port
        self._loop = loop
        self._answer: asyncio.Future[Any] = loop.create_future()
        self._last: Any | None = None
        self._last_us = port.edge.clock.realtime_us()

    async def serve(self, requests: AsyncIterator[bytes]) -> bytes:
        """Read to the end; the serialized answer."""
        stream = self._port.open_stream(self._on_end)
        if stream is None:
            reason = DropReason.JOINT_SECOND_STREAM
            self._port.refuse("joint_stream", reason)
            return self._finished(STREAM_STATUS[reason], reason.value).SerializeToString()
        reader = self._loop.create_task(self._read(requests, stream))
        try:
            return (await self._answer).SerializeToString()
        finally:
            reader.cancel()
            stream.close()

    async def _read(self, requests: AsyncIterator[bytes], stream: CommandStream) -> None:
        try:
            async for payload in requests:
                if not self._take(payload, stream):
                    return
            self._end(_Answer.STATUS_OK, "")
        except Exception as problem:  # a defect of ours, or of the connection: the run ends with its last command
            if not self._answer.done():
                self._answer.set_exception(problem)

    def _take(self, payload: bytes, stream: CommandStream) -> bool:
        """Take one message; False if it ends the stream."""
        if self._answer.done():
            return False
        clock = self._port.edge.clock
        self._last_us = clock.realtime_us()
        try:
            self._last = request = robot_command_pb2.JointControlStreamRequest.FromString(payload)
            command = joint_command(request, clock.now_us() - self._last_us)
        except DecodeError:
            stream.refuse(payload)
            self._end(_Answer.STATUS_INVALID_REQUEST, "the bytes are no JointControlStreamRequest")
            return False
        except ValueError as problem:
            stream.refuse(payload)
            self._end(_Answer.STATUS_INVALID_REQUEST, str(problem))
            return False
        reason = stream.update(command, payload).reason
        if reason is not None:
            self._end(STREAM_STATUS[reason], reason.value)
        return reason is None

    def _on_end(self, why: RunEnd) -> None:
        """On the robot's loop, or wherever the run was ended."""
        self._loop.call_soon_threadsafe(self._end, _Answer.STATUS_INACTIVE, f"the run has ended: {why.value}")

    def _end(self, status: int, message: str) -> None:
        if not self._answer.done():
            self._answer.set_result(self._finished(status, message))

    def _finished(self, status: int, message: str) -> Any:
        header = response_header(self._last, self._last_us, self._port.edge.clock.realtime_us())
        return _Answer(header=header, status=status, message=message)
