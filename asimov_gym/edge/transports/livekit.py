"""The robot as a participant of a LiveKit room: it joins, and comes back whenever the room is lost."""

from __future__ import annotations

import asyncio
import logging
import random
import threading
from contextlib import suppress
from types import ModuleType

from asimov_gym.edge.control import Dialect
from asimov_gym.edge.edge import Edge
from asimov_gym.edge.events import Code
from asimov_gym.edge.lifecycle import Lifecycle
from asimov_gym.edge.loop_thread import LoopThread
from asimov_gym.edge.transports import TransportError
from asimov_gym.edge.transports.livekit_join import JoinError, RoomAddress, hidden_traceback, hide_token, load_rtc
from asimov_gym.edge.transports.livekit_media import Media, RoomMedia
from asimov_gym.edge.transports.livekit_outbox import Outbox
from asimov_gym.edge.transports.livekit_visit import RoomVisit
from asimov_gym.edge.wire import cloud_pb2

__all__ = ["LiveKitLane", "Media"]

FIRST_WAIT_S = 0.5
"""Before the first attempt to come back; each further one waits twice as long."""
LONGEST_WAIT_S = 15.0
STEADY_S = 10.0
"""A stay this long counts as a success: the next loss starts at the first wait. Two robots with one identity, which
evict each other for ever, never get there."""
STOP_TIMEOUT_S = 10.0

_log = logging.getLogger(__name__)


class Backoff:
    """Waits between attempts: twice as long each time, up to a cap, each shortened by chance by up to a half."""

    def __init__(self, dice: random.Random | None = None) -> None:
        self._dice = dice or random.Random()
        self._next = FIRST_WAIT_S

    def reset(self) -> None:
        """An attempt succeeded."""
        self._next = FIRST_WAIT_S

    def wait(self) -> float:
        """Seconds until the next attempt."""
        wait, self._next = self._next, min(2 * self._next, LONGEST_WAIT_S)
        return wait * self._dice.uniform(0.5, 1.0)


class LiveKitLane(Lifecycle):
    """Serves one edge in a LiveKit room between `start` and `stop`, or as a context manager.

    | dialect | message | lane |
    |---|---|---|
    | cloud | EdgeTelemetry | data track `telemetry`, and lossy packets of topic `state` |
    | cloud | EdgeEvent | reliable packets of topic `system` |
    | cloud | CloudCommand | reliable packets of topic `commands` |
    | io | RobotState | data track `state`; the frame's `user_timestamp` is the edge's wall clock |
    | io | RobotCommand | reliable packets of topic `commands`; setpoints also a client's data track `commands` |

    Reports go out 10 times a second. The published samples of dialect cloud read every data track as EdgeTelemetry, so
    with both dialects in one room such a client sees garbage between its telemetry. A participant whose token has no
    canPublishData can read, not drive: the server sees to that.

    Args:
        edge: takes the commands and gives the reports.
        url: of the server, `ws://` or `wss://`.
        token: opens the room; needs roomJoin, canPublish, canPublishData, canSubscribe and canUpdateOwnMetadata.
        dialects: what is spoken.
        media: pictures and sound; none by default, they cost a core or two.

    Raises:
        TransportError: the URL or the token cannot be right, or there is no dialect.
    """

    def __init__(
        self,
        edge: Edge,
        url: str,
        token: str,
        dialects: tuple[Dialect, ...] = (Dialect.CLOUD,),
        media: Media | None = None,
    ) -> None:
        if not dialects or len(set(dialects)) != len(dialects):
            raise TransportError(f"dialects must be one or both of cloud and io, got {dialects}")
        try:
            self._address = RoomAddress(url, token)
        except ValueError as problem:
            raise TransportError(str(problem)) from None
        self.dialects = dialects
        self.joined = 0
        """How often the room was joined."""
        self.outbox = Outbox(dialects)
        self._edge = edge
        self._media = media
        self._rtc: ModuleType | None = None
        self._thread: LoopThread | None = None
        self._stop: asyncio.Event | None = None
        self._entering: asyncio.Task[None] | None = None
        self._visit: RoomVisit | None = None
        self._where = f"room at {url}"
        self._answered = threading.Event()
        self._refusal: str | None = None

    @property
    def connect_line(self) -> str:
        """What a client needs to know, for people."""
        spoken = " and ".join(dialect.value for dialect in self.dialects)
        return f"LiveKit {self._where}, dialect {spoken}; a client needs a token for the same room"

    @property
    def connected(self) -> bool:
        """Whether the robot is in the room now."""
        return self._edge.lanes.cloud_connected

    def start(self) -> None:
        """Join the room, then serve it in a thread. No effect while it runs. Not with the edge's lock held.

        Raises:
            TransportError: the client library is missing, the server was not reached, or refused.
        """
        if self._thread is not None:
            return
        try:
            self._rtc = load_rtc()
        except ImportError as problem:
            raise TransportError(str(problem)) from None
        self._answered.clear()
        self._refusal = None
        self._edge.attach(self.outbox)
        self._thread = LoopThread("livekit-lane", self._serve)
        self._thread.start()
        try:
            self._answered.wait()
        except BaseException:  # Ctrl-C while the server lets us wait
            self.stop()
            raise
        if self._refusal is not None:
            self.stop()
            raise TransportError(self._refusal)

    def stop(self) -> None:
        """Leave the room: its clients have left. No effect if it does not run. Not with the edge's lock held."""
        thread = self._thread
        if thread is None:
            return
        self._edge.detach(self.outbox)
        thread.call(self._stop_serving)
        if not thread.join(STOP_TIMEOUT_S):
            _log.warning("the room was not left in time")
            thread.cancel()
            thread.join(STOP_TIMEOUT_S)
        self._thread = None

    # -- in the thread -------------------------------------------------------------------------------------

    def _stop_serving(self) -> None:
        if self._stop is not None:
            self._stop.set()
        if self._entering is not None:
            self._entering.cancel()
        if self._visit is not None:
            self._visit.end("stop")

    async def _serve(self) -> None:
        """Stay after stay, until stopped."""
        self._stop = asyncio.Event()
        backoff, last_refusal = Backoff(), ""
        loop = asyncio.get_running_loop()
        try:
            while not self._stop.is_set():
                began = loop.time()
                try:
                    await self._stay()
                    last_refusal = ""
                except asyncio.CancelledError:
                    if not self._stop.is_set():
                        raise
                except Exception as problem:
                    refusal = str(problem) if isinstance(problem, JoinError) else self._unforeseen(problem)
                    if not self._answered.is_set():
                        self._refusal = refusal
                        return
                    if refusal != last_refusal:
                        _log.warning("%s; trying again until it works", refusal)
                        last_refusal = refusal
                if loop.time() - began > STEADY_S:
                    backoff.reset()
                await self._pause(backoff.wait())
        finally:
            self._edge.lanes.cloud_connected = False
            self._stop = None
            self._answered.set()

    async def _stay(self) -> None:
        """Join, serve until the connection is lost or the lane is stopped, leave."""
        assert self._rtc is not None and self._stop is not None
        media = None if self._media is None else RoomMedia(self._edge, self._media)
        visit = RoomVisit(self._rtc, self._edge, self.outbox, self._address, self.dialects, media, self._on_link)
        try:
            self._entering = asyncio.create_task(visit.enter(), name="enter the room")
            await self._entering
            self._entering = None
            self._visit, self._where = visit, visit.description
            self.joined += 1
            self._say(True, f"joined {self._where}")
            self._answered.set()
            reason = await visit.stay()
            if self._stop.is_set():
                await visit.flush()
        finally:
            self._entering = self._visit = None
            was_connected = self._edge.lanes.cloud_connected
            self._edge.lanes.cloud_connected = False
            await visit.exit()
        if not self._stop.is_set():
            _log.warning("the room is lost (%s); the robot stops walking and comes back", reason)
            if was_connected:
                self._say(False, f"lost {self._where}: {reason}")

    def _on_link(self, up: bool) -> None:
        """The client library has lost or mended the connection."""
        self._say(up, f"{'joined again' if up else 'lost'} {self._where}")

    def _say(self, connected: bool, message: str) -> None:
        self._edge.lanes.cloud_connected = connected
        _log.info("%s", message)
        self._edge.error(Code.CLOUD, message, cloud_pb2.SUBSYSTEM_CLOUD)

    def _unforeseen(self, problem: Exception) -> str:
        text = hide_token(f"{type(problem).__name__}: {problem}", self._address.token)
        _log.debug("%s", hidden_traceback(problem, self._address.token))
        return f"cannot serve the room at {self._address.url}: {text}"

    async def _pause(self, seconds: float) -> None:
        assert self._stop is not None
        with suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                await self._stop.wait()
