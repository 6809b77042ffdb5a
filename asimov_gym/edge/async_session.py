"""The session for asyncio programs: the same verbs and channels, awaited."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import asynccontextmanager
from typing import Any

import numpy as np

from asimov_gym.edge.clients.channels import StateChannel
from asimov_gym.edge.control import Dialect, Source
from asimov_gym.edge.robot import SimulatedRobot
from asimov_gym.edge.session import Session, connect
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

    @property
    def facts(self) -> Mapping[str, Any] | None:
        """What the robot says of itself; see `Session.facts`."""
        return self.sync.facts

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
        """Events in order, until none comes within `timeout` seconds; None waits for ever.

        UDP has no lane for events: there it ends at once.
        """
        last = time.monotonic()
        while self.sync.has_events and (timeout is None or time.monotonic() - last <= timeout):
            event = self.sync.system.next()
            if event is None:
                await asyncio.sleep(_POLL_S)
                continue
            yield event
            last = time.monotonic()


@asynccontextmanager
async def aconnect(
    target: SimulatedRobot | str,
    name: str | None = None,
    source: Source | None = None,
    *,
    dialect: Dialect | None = None,
    token: str | None = None,
    robot_identity: str | None = None,
    state_port: int | None = None,
    facts_port: int | None = None,
    timeout: float = 5.0,
) -> AsyncIterator[AsyncSession]:
    """Connect to a robot: `async with aconnect(robot) as session`; arguments as for `connect`."""
    connecting = asyncio.ensure_future(
        asyncio.to_thread(
            connect,
            target,
            name,
            source,
            dialect=dialect,
            token=token,
            robot_identity=robot_identity,
            state_port=state_port,
            facts_port=facts_port,
            timeout=timeout,
        )
    )
    try:
        session = await asyncio.shield(connecting)
    except asyncio.CancelledError:
        connecting.add_done_callback(_close_unwanted)  # the thread goes on and may still succeed
        raise
    try:
        yield AsyncSession(session)
    finally:
        await asyncio.to_thread(session.close)


def _close_unwanted(connecting: asyncio.Future[Session]) -> None:
    if not connecting.cancelled() and connecting.exception() is None:
        connecting.result().close()
