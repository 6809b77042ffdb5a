"""The three channels of a session: commands out, state in, events in."""

from __future__ import annotations

import threading
import time
from collections import Counter, deque
from typing import Protocol

from asimov_gym.edge.clients.reports import Arrival
from asimov_gym.edge.wire import cloud_pb2

EVENTS_KEPT = 10_000
"""Events that nobody takes: beyond this many the oldest is lost."""


class PacketSender(Protocol):
    """Where a command channel's packets go: the `send` of a link."""

    def __call__(self, packet: bytes, streamed: bool = False) -> None: ...


class CommandChannel:
    """Channel `commands`: to the robot."""

    def __init__(self, sender: PacketSender) -> None:
        self._sender = sender
        self._closed: str | None = None

    def send(self, packet: bytes, streamed: bool = False) -> None:
        """Send a packet as it is. What the robot makes of it shows in telemetry and events only.

        Args:
            packet: a message of the session's dialect, or anything else.
            streamed: one of a stream of setpoints, which may be lost (see `Link.send`).

        Raises:
            ConnectionError: the session is closed, or its lane is lost.
        """
        if self._closed is not None:
            raise ConnectionError(self._closed)
        self._sender(packet, streamed)

    def close(self, reason: str = "the session is closed") -> None:
        """Refuse further packets; the first reason given stays."""
        if self._closed is None:
            self._closed = reason


class StateChannel:
    """Channel `state`: the robot's latest report; older ones are lost. 10 a second, over UDP 200."""

    def __init__(self) -> None:
        self.arrivals: Counter[Arrival] = Counter()
        """Samples so far by what became of them."""
        self._sample: cloud_pb2.EdgeTelemetry | None = None
        self._received = 0
        self._received_at = 0.0
        self.lost: str | None = None
        """Why no more will come; None while more may."""
        self._condition = threading.Condition()

    def get(self) -> cloud_pb2.EdgeTelemetry:
        """The latest sample; there is one from the moment of connecting. `age` tells how old it is."""
        with self._condition:
            assert self._sample is not None, "a session without a sample is never handed out"
            copy = cloud_pb2.EdgeTelemetry()
            copy.CopyFrom(self._sample)
            return copy

    @property
    def age(self) -> float:
        """Seconds since the latest sample came in."""
        return time.monotonic() - self._received_at

    def wait(self, timeout: float = 1.0) -> cloud_pb2.EdgeTelemetry:
        """The next sample to come.

        Args:
            timeout: s.

        Raises:
            TimeoutError: none came. In lockstep none comes unless another thread advances the robot.
            ConnectionError: the lane is lost, none will come.
        """
        with self._condition:
            seen = self._received
            self._condition.wait_for(lambda: self._received != seen or self.lost is not None, timeout)
            if self._received != seen:
                return self.get()
            if self.lost is not None:
                raise ConnectionError(self.lost)
            raise TimeoutError(f"no telemetry within {timeout} s: is the robot started, or advanced?")

    def wait_first(self, timeout: float) -> bool:
        """Whether there is a sample, after waiting up to `timeout` seconds for the first one."""
        with self._condition:
            self._condition.wait_for(lambda: self._sample is not None or self.lost is not None, timeout)
            return self._sample is not None

    def put(self, sample: cloud_pb2.EdgeTelemetry) -> None:
        """Called by the session for each sample."""
        with self._condition:
            self._sample = sample
            self._received += 1
            self._received_at = time.monotonic()
            self._condition.notify_all()

    def lose(self, reason: str) -> None:
        """Called by the session when no more will come."""
        with self._condition:
            self.lost = reason
            self._condition.notify_all()


class SystemChannel:
    """Channel `system`: events, in order, from the moment of connecting."""

    def __init__(self) -> None:
        self._packets: deque[bytes] = deque(maxlen=EVENTS_KEPT)
        self._condition = threading.Condition()

    def next(self, timeout: float = 0.0) -> cloud_pb2.EdgeEvent | None:
        """The oldest event not yet taken; None if there is none within `timeout` seconds."""
        with self._condition:
            if not self._condition.wait_for(lambda: bool(self._packets), timeout):
                return None
            return cloud_pb2.EdgeEvent.FromString(self._packets.popleft())

    def put(self, packet: bytes) -> None:
        """Called by the session for each event."""
        with self._condition:
            self._packets.append(packet)
            self._condition.notify_all()
