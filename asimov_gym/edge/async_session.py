"""The in-process session for asyncio programs: the same verbs and channels, awaited."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager

import numpy as np

from asimov_gym.edge.control import Source
from asimov_gym.edge.robot import SimulatedRobot
from asimov_gym.edge.session import Session, StateChannel, connect
from asimov_gym.edge.wire import cloud_pb2

_POLL_S = 0.005


class AsyncStateChannel:
    """Channel `state`."""

    def __init__(self, channel: StateChannel) -> None:
        self._channel = channel

    async def get(self) -> cloud_pb2.EdgeTelemetry:
        """The latest sample."""
        return self._channel.get()

    async def wait(self, timeout: float = 1.0) -> cloud_pb2.EdgeTelemetry:
        """The next sample to come; see `StateChannel.wait`."""
        return await asyncio.to_thread(self._channel.wait, timeout)


class AsyncSession:
    """A connected client. Made by `aconnect`; the methods are those of `Session`."""

    def __init__(self, session: Session) -> None:
        self.sync = session
        """The session underneath."""
        self.state = AsyncStateChannel(session.state)

    async def stand(self) -> int:
        """Take the standing pose, over about 2 s."""
        return self.sync.stand()

    async def damp(self) -> int:
        """Go limp: the software stop."""
        return self.sync.damp()

    async def velocity(self, vx: float = 0.0, vy: float = 0.0, vyaw: float = 0.0) -> int:
        """Walk until told otherwise; see `Session.velocity`."""
        return self.sync.velocity(vx, vy, vyaw)

    async def trajectory(
        self,
        positions: Sequence[float] | np.ndarray,
        kp: Sequence[float] | np.ndarray | None = None,
        kd: Sequence[float] | np.ndarray | None = None,
    ) -> int:
        """Drive every motor to a position at once; see `Session.trajectory`."""
        return self.sync.trajectory(positions, kp, kd)

    async def send(self, packet: bytes) -> None:
        """Send a packet of the commands channel as it is."""
        self.sync.commands.send(packet)

    async def events(self, timeout: float | None = None) -> AsyncIterator[cloud_pb2.EdgeEvent]:
        """Events in order, until none comes within `timeout` seconds; None waits for ever."""
        last = time.monotonic()
        while timeout is None or time.monotonic() - last <= timeout:
            event = self.sync.system.next()
            if event is None:
                await asyncio.sleep(_POLL_S)
                continue
            yield event
            last = time.monotonic()


@asynccontextmanager
async def aconnect(
    robot: SimulatedRobot, name: str | None = None, source: Source = Source.IN_PROCESS
) -> AsyncIterator[AsyncSession]:
    """Connect to a robot in this process: `async with aconnect(robot) as session`; arguments as for `connect`."""
    with connect(robot, name, source) as session:
        yield AsyncSession(session)
