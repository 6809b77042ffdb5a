"""One stay of the robot in a room: from joining to leaving, or to the loss of the connection."""

from __future__ import annotations

import asyncio
import json
import logging
from collections import Counter
from collections.abc import Callable, Coroutine
from contextlib import suppress
from types import ModuleType
from typing import Any

from asimov_gym.edge.control import Dialect
from asimov_gym.edge.edge import Edge
from asimov_gym.edge.facts import SIMULATOR_KEY, facts
from asimov_gym.edge.transports.livekit_channels import (
    COMMANDS,
    COMMANDS_TRACK_ATTRIBUTE,
    REPORT_TRACK,
    SIMULATOR_ATTRIBUTE,
    STATE_TOPIC,
    SYSTEM,
    SYSTEM_INFO,
)
from asimov_gym.edge.transports.livekit_join import JoinError, RoomAddress, hidden_traceback, hide_token, join, leave
from asimov_gym.edge.transports.livekit_media import RoomMedia
from asimov_gym.edge.transports.livekit_outbox import Outbox
from asimov_gym.edge.transports.livekit_senders import RoomSenders

PUBLISH_TIMEOUT_S = 10.0
"""For publishing a data track."""
PACKET_TIMEOUT_S = 5.0
"""For handing one packet to the client library, which waits while it connects."""
RECONNECT_TIMEOUT_S = 15.0
"""The client library mends a connection by itself. After this long the robot leaves and joins anew."""
SETTLE_S = 1.0
"""The library calls a connection mended before its data channels are open: what is sent at once would be lost."""
EVENT_TRIES = 3
FLUSH_S = 0.5
LINGER_S = 0.1
"""Between the last packet and leaving: the library drops what it has taken and not yet sent."""
_RETRY_S = 0.5

_log = logging.getLogger(__name__)


class RoomVisit:
    """The robot as a participant of one room.

    All methods run in one event loop. `enter` joins and publishes, `stay` lasts until the connection is lost or
    `end` is called, `exit` leaves; it must be awaited whatever happened.

    Args:
        rtc: the client library.
        edge: takes the commands.
        outbox: what is to be sent.
        address: of the room.
        dialects: spoken here.
        media: pictures and sound, or None.
        on_link: told when the client library has lost the connection (False) and has mended it (True).
    """

    def __init__(
        self,
        rtc: ModuleType,
        edge: Edge,
        outbox: Outbox,
        address: RoomAddress,
        dialects: tuple[Dialect, ...],
        media: RoomMedia | None,
        on_link: Callable[[bool], None],
    ) -> None:
        self.room: Any = rtc.Room()
        self.counts: Counter[str] = Counter()
        """Packets and frames `sent` and `failed`."""
        self._rtc = rtc
        self._edge = edge
        self._outbox = outbox
        self._address = address
        self._dialects = dialects
        self._media = media
        self._on_link = on_link
        self._senders = RoomSenders(edge, dialects)
        self._tracks: dict[Dialect, Any] = {}
        self._tasks: set[asyncio.Task[None]] = set()
        self._filled = {"reports": asyncio.Event(), "events": asyncio.Event()}
        self._linked = asyncio.Event()
        self._ended: asyncio.Future[str] = asyncio.get_running_loop().create_future()
        self._give_up: asyncio.TimerHandle | None = None
        self._attributes: asyncio.Task[None] | None = None

    @property
    def description(self) -> str:
        """Where the robot is, for people."""
        identity = self.room.local_participant.identity
        return f"room {self.room.name!r} at {self._address.url} as {identity!r}"

    # -- life --------------------------------------------------------------------------------------------

    async def enter(self) -> None:
        """Join, answer calls, publish the data tracks, begin to send.

        Raises:
            JoinError: the room was not joined, or does not let the robot publish.
        """
        self._listen()
        await join(self._rtc, self.room, self._address)
        self.room.local_participant.register_rpc_method(SYSTEM_INFO, _system_info)
        await self._publish_tracks()
        self._linked.set()
        self._attributes = self._start(self._set_attributes(), "attributes")
        self._start(self._send_reports(), "reports")
        self._start(self._send_events(), "events")
        if self._media is not None:
            self._start(self._media.serve(self._rtc, self.room), "media")
        loop = asyncio.get_running_loop()

        def wake() -> None:
            with suppress(RuntimeError):  # closed meanwhile, which must not reach the control loop
                loop.call_soon_threadsafe(self._on_filled)

        self._outbox.on_filled(wake)
        self._on_filled()

    async def stay(self) -> str:
        """Until the connection is lost for good, or `end`. Returns why, in a few words."""
        return await self._ended

    def end(self, reason: str) -> None:
        """Have `stay` return."""
        if not self._ended.done():
            self._ended.set_result(reason)

    async def flush(self) -> None:
        """Give the last events a moment to go out."""
        end = asyncio.get_running_loop().time() + FLUSH_S
        while self._outbox.next_event() is not None and asyncio.get_running_loop().time() < end:
            await asyncio.sleep(0.02)
        await asyncio.sleep(LINGER_S)

    async def exit(self) -> None:
        """Stop sending, take all clients to have left, leave the room."""
        self._outbox.on_filled(None)
        if self._give_up is not None:
            self._give_up.cancel()
        tasks = list(self._tasks)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        self._senders.all_left()
        await leave(self.room)

    # -- what comes in -------------------------------------------------------------------------------------

    def _listen(self) -> None:
        on = self.room.on
        on("data_received", self._on_packet)
        on("data_track_published", self._on_data_track)
        on("participant_disconnected", self._on_left)
        on("reconnecting", self._on_reconnecting)
        on("reconnected", self._on_reconnected)
        on("disconnected", self._on_disconnected)
        if self._media is not None:
            self._media.listen(self._rtc, self.room)

    def _on_packet(self, packet: Any) -> None:
        if packet.topic == COMMANDS:
            self._senders.packet(None if packet.participant is None else packet.participant.identity, packet.data)

    def _on_data_track(self, track: Any) -> None:
        """A client streams setpoints on a track of its own, if the robot says that it reads it."""
        if track.info.name == COMMANDS and Dialect.IO in self._dialects:
            self._start(self._read_stream(track), "commands track")

    async def _read_stream(self, track: Any) -> None:
        """Until the track ends. It outlives a mended connection, during which its client was away."""
        try:
            stream = track.subscribe()
            async for frame in stream:
                if track.publisher_identity in self.room.remote_participants:
                    self._senders.packet(track.publisher_identity, frame.payload, streamed=True)
        except self._rtc.SubscribeDataTrackError as problem:
            _log.warning("the commands track of a client cannot be read: %s", hide_token(str(problem.message)))

    def _on_left(self, participant: Any) -> None:
        self._senders.left(participant.identity)

    # -- the connection ------------------------------------------------------------------------------------

    def _on_reconnecting(self) -> None:
        self._linked.clear()
        if self._attributes is not None:
            self._attributes.cancel()
        self._senders.all_left()  # none of them can stop the robot now
        if self._give_up is None:
            reason = f"the connection did not come back within {RECONNECT_TIMEOUT_S:.0f} s"
            self._give_up = asyncio.get_running_loop().call_later(RECONNECT_TIMEOUT_S, self.end, reason)
        self._on_link(False)

    def _on_reconnected(self) -> None:
        if self._give_up is not None:
            self._give_up.cancel()
            self._give_up = None
        self._start(self._resume(), "resume")

    async def _resume(self) -> None:
        """The server may have forgotten everything: say it again."""
        await asyncio.sleep(SETTLE_S)
        try:
            await self._publish_tracks()
        except JoinError as problem:
            self.end(str(problem))
            return
        self._linked.set()
        self._on_link(True)
        self._attributes = self._start(self._set_attributes(), "attributes")

    def _on_disconnected(self, reason: int) -> None:
        name = self._rtc.DisconnectReason.Name(reason) if reason else "the connection is lost"
        self.end(name.lower().replace("_", " "))

    # -- what goes out -------------------------------------------------------------------------------------

    async def _publish_tracks(self) -> None:
        for dialect in self._dialects:
            track = self._tracks.get(dialect)
            if track is not None and track.is_published():
                continue
            name = REPORT_TRACK[dialect]
            try:
                async with asyncio.timeout(PUBLISH_TIMEOUT_S):
                    self._tracks[dialect] = await self.room.local_participant.publish_data_track(name=name)
            except TimeoutError:
                raise JoinError(f"the room at {self._address.url} does not take the data track {name!r}") from None
            except self._rtc.participant.PublishDataTrackError as problem:
                raise JoinError(
                    f"the room at {self._address.url} refuses the data track {name!r} "
                    f"({hide_token(str(problem.message), self._address.token)}): the robot's token needs canPublish "
                    "and canPublishData"
                ) from None

    async def _set_attributes(self) -> None:
        attributes = {SIMULATOR_ATTRIBUTE: facts()[SIMULATOR_KEY]}
        if Dialect.IO in self._dialects:
            attributes[COMMANDS_TRACK_ATTRIBUTE] = "1"
        with suppress(TimeoutError):
            async with asyncio.timeout(PACKET_TIMEOUT_S):
                await self.room.local_participant.set_attributes(attributes)
        await asyncio.sleep(PACKET_TIMEOUT_S)  # the room tells what it took; the call itself does not
        if attributes.items() - self.room.local_participant.attributes.items():
            _log.warning("the room did not take the robot's attributes: its token needs canUpdateOwnMetadata")

    def _on_filled(self) -> None:
        for filled in self._filled.values():
            filled.set()

    async def _send_reports(self) -> None:
        filled = self._filled["reports"]
        while True:
            await filled.wait()
            filled.clear()
            await self._linked.wait()
            for dialect, report in self._outbox.take_reports().items():
                self._push(dialect, self._rtc.DataTrackFrame(report.packet, report.timestamp_us))
                if dialect is Dialect.CLOUD:
                    await self._publish(report.packet, STATE_TOPIC, reliable=False)

    def _push(self, dialect: Dialect, frame: Any) -> None:
        try:
            self._tracks[dialect].try_push(frame)
            self.counts["sent"] += 1
        except self._rtc.PushFrameError as problem:
            self._failed("a frame", problem)

    async def _send_events(self) -> None:
        filled, tries = self._filled["events"], 0
        while True:
            event = self._outbox.next_event()
            if event is None:
                await filled.wait()
                filled.clear()
                continue
            await self._linked.wait()
            tries += 1
            if await self._publish(event, SYSTEM, reliable=True) or tries >= EVENT_TRIES:
                self._outbox.event_sent(event)
                tries = 0
            else:
                await asyncio.sleep(_RETRY_S)

    async def _publish(self, packet: bytes, topic: str, reliable: bool) -> bool:
        try:
            async with asyncio.timeout(PACKET_TIMEOUT_S):
                await self.room.local_participant.publish_data(packet, reliable=reliable, topic=topic)
        except (TimeoutError, self._rtc.participant.PublishDataError) as problem:
            self._failed(f"a packet of {topic}", problem)
            return False
        self.counts["sent"] += 1
        return True

    def _failed(self, what: str, problem: Exception) -> None:
        self.counts["failed"] += 1
        level = logging.WARNING if self.counts["failed"] == 1 else logging.DEBUG
        text = str(getattr(problem, "message", "")) or type(problem).__name__
        _log.log(level, "%s did not go out: %s", what, hide_token(text, self._address.token))

    # -- tasks ---------------------------------------------------------------------------------------------

    def _start(self, work: Coroutine[Any, Any, None], name: str) -> asyncio.Task[None]:
        task = asyncio.create_task(work, name=name)
        self._tasks.add(task)
        task.add_done_callback(self._on_done)
        return task

    def _on_done(self, task: asyncio.Task[None]) -> None:
        self._tasks.discard(task)
        if not task.cancelled() and (problem := task.exception()) is not None:
            trace = hidden_traceback(problem, self._address.token)
            _log.error("serving the room failed in its %s\n%s", task.get_name(), trace)
            self.end(f"its {task.get_name()} failed: {type(problem).__name__}")


async def _system_info(invocation: Any) -> str:
    return json.dumps(facts())
