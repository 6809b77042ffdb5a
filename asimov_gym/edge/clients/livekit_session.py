"""A client's stay in a LiveKit room: which participant is the robot, its reports, and the commands to it."""

from __future__ import annotations

import asyncio
import logging
import threading
from collections.abc import Coroutine, Mapping
from contextlib import suppress
from types import ModuleType
from typing import Any

from asimov_gym.edge.clients.link import LinkReceiver
from asimov_gym.edge.clients.robot_facts import parse_facts
from asimov_gym.edge.control import Dialect
from asimov_gym.edge.transports.livekit_channels import (
    COMMANDS,
    COMMANDS_TRACK_ATTRIBUTE,
    REPORT_TRACK,
    STATE_TOPIC,
    SYSTEM,
    SYSTEM_INFO,
)
from asimov_gym.edge.transports.livekit_join import RoomAddress, hide_token, join, leave

ROBOT_TIMEOUT_S = 5.0
"""After joining, for a robot to be seen, and again for its facts."""
SETTLE_S = 0.3
"""How long after a robot's data track of dialect `io` one of dialect `cloud` may still appear and be preferred."""
RECONNECT_SETTLE_S = 0.5
"""The library calls a connection mended before its data channels are open: what is sent at once would be lost."""
COMMANDS_WAITING = 256
"""Commands that may wait for the room; beyond it it is taken to be stuck."""
PACKET_TIMEOUT_S = 5.0
LINGER_S = 0.2
"""Between the last command and leaving: the client library drops what it has taken and not yet sent."""

_log = logging.getLogger(__name__)


class RoomSession:
    """Robot and client in one room, as the client sees it. Everything but `queue` and `finish` runs in its loop.

    Args:
        rtc: the client library.
        address: of the room.
        dialect: to be spoken; None for what the robot publishes.
        robot: its identity; None for the first one seen.
        receiver: gets what the robot reports.
    """

    def __init__(
        self, rtc: ModuleType, address: RoomAddress, dialect: Dialect | None, robot: str | None, receiver: LinkReceiver
    ) -> None:
        self.dialect = dialect
        """None until it is settled."""
        self.linked = True
        """False while the client library mends a lost connection."""
        self.permitted = True
        """Whether the token lets this client command."""
        self._rtc = rtc
        self._address = address
        self._offered: list[Any] = []
        self._wanted = robot
        self._receiver = receiver
        self._room: Any = rtc.Room()
        self._loop = asyncio.get_running_loop()
        self._robot: str | None = None
        self._seen = asyncio.Event()
        self._ended: asyncio.Future[str | None] = self._loop.create_future()
        self._commands: asyncio.Queue[tuple[bytes, bool] | None] = asyncio.Queue()
        self._waiting = 0
        self._count_lock = threading.Lock()
        self._track: Any = None
        self._track_wanted = False
        self._tasks: set[asyncio.Task[None]] = set()
        self._sender: asyncio.Task[None] | None = None

    # -- from any thread -----------------------------------------------------------------------------------

    def queue(self, packet: bytes, streamed: bool) -> bool:
        """Take a command; False when too many wait."""
        with self._count_lock:
            if self._waiting >= COMMANDS_WAITING:
                return False
            self._waiting += 1
        with suppress(RuntimeError):  # the loop has ended: `send` says so from then on
            self._loop.call_soon_threadsafe(self._commands.put_nowait, (packet, streamed))
        return True

    def finish(self) -> None:
        """Send what is queued, then have `stay` return."""
        with suppress(RuntimeError):
            self._loop.call_soon_threadsafe(self._commands.put_nowait, None)

    # -- life ----------------------------------------------------------------------------------------------

    async def enter(self, timeout: float) -> Mapping[str, Any] | None:
        """Join, see a robot, ask it for its facts; they are returned.

        Raises:
            JoinError: the room was not joined.
            ConnectionError: there is no robot, or not one that is supported.
        """
        on = self._room.on
        on("data_received", self._on_packet)
        on("data_track_published", self._on_data_track)
        on("participant_disconnected", self._on_left)
        on("reconnecting", self._on_reconnecting)
        on("reconnected", self._on_reconnected)
        on("disconnected", self._on_disconnected)
        await join(self._rtc, self._room, self._address)
        self.permitted = bool(self._room.local_participant.permissions.can_publish_data)
        try:
            async with asyncio.timeout(timeout):
                await self._seen.wait()
        except TimeoutError:
            who = "robot" if self._wanted is None else f"robot {self._wanted!r}"
            spoken = REPORT_TRACK if self.dialect is None else (self.dialect,)
            tracks = " or ".join(f"{REPORT_TRACK[dialect]!r} (dialect {dialect.value})" for dialect in spoken)
            raise ConnectionError(
                f"no {who} in the room {self._room.name!r} at {self._address.url}: the data track {tracks} was not "
                f"published within {timeout:g} s"
            ) from None
        facts = await self._ask_facts() if self.permitted else None
        self._sender = asyncio.create_task(self._send(), name="commands")
        return facts

    async def stay(self) -> str | None:
        """Until `finish` (None) or the loss of the room (why)."""
        return await self._ended

    async def exit(self) -> None:
        """Leave the room. `queue` still takes commands, which go nowhere."""
        tasks = [*self._tasks, *([] if self._sender is None else [self._sender])]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        await leave(self._room)

    # -- what comes in -------------------------------------------------------------------------------------

    def _is_robot(self, identity: str) -> bool:
        """Whether reports of this participant are the robot's; the first who sends any is the robot."""
        if self._robot is None and identity and self._wanted in (None, identity):
            self._robot = identity
            self._seen.set()
        return identity == self._robot

    def _on_packet(self, packet: Any) -> None:
        if packet.participant is None or self.dialect is Dialect.IO:
            return
        identity = packet.participant.identity
        if packet.topic == STATE_TOPIC and self._is_robot(identity):
            self._settle(Dialect.CLOUD)
            self._receiver.on_state(packet.data)  # also on the data track: the session takes each sample once
        elif packet.topic == SYSTEM and self._wanted in (None, identity) and self._robot in (None, identity):
            self._receiver.on_event(packet.data)

    def _on_data_track(self, track: Any) -> None:
        if track.info.name == REPORT_TRACK[Dialect.CLOUD]:
            self._offered.append(track)
            self._settle(Dialect.CLOUD)
        elif track.info.name == REPORT_TRACK[Dialect.IO]:
            self._offered.append(track)
            # The robot may be about to publish the other one too.
            self._loop.call_later(SETTLE_S, self._settle, Dialect.IO)
        if self.dialect is not None:
            self._read_offered()

    def _settle(self, dialect: Dialect) -> None:
        if self.dialect is None:
            self.dialect = dialect
            self._read_offered()

    def _read_offered(self) -> None:
        """Read the robot's tracks of the dialect spoken, leave the others alone."""
        assert self.dialect is not None
        offered, self._offered = self._offered, []
        for track in offered:
            if track.info.name == REPORT_TRACK[self.dialect] and self._is_robot(track.publisher_identity):
                self._start(self._read(track), "reports")

    async def _read(self, track: Any) -> None:
        try:
            stream = track.subscribe()
            async for frame in stream:
                if self._is_robot(track.publisher_identity):  # the track outlives a mended connection
                    self._receiver.on_state(frame.payload, frame.user_timestamp or 0)
        except self._rtc.SubscribeDataTrackError as problem:
            _log.warning("the robot's data track cannot be read: %s", hide_token(str(problem.message)))

    def _on_left(self, participant: Any) -> None:
        if participant.identity == self._robot:
            self._robot = None  # it may come back, or another one in its place
            self._track_wanted = False

    def _on_reconnecting(self) -> None:
        self.linked = False

    def _on_reconnected(self) -> None:
        self._loop.call_later(RECONNECT_SETTLE_S, self._link_up)

    def _link_up(self) -> None:
        self.linked = True

    def _on_disconnected(self, reason: int) -> None:
        name = self._rtc.DisconnectReason.Name(reason) if reason else "connection lost"
        if not self._ended.done():
            self._ended.set_result(name.lower().replace("_", " "))

    async def _ask_facts(self) -> Mapping[str, Any] | None:
        """The robot's facts; None if it does not answer."""
        call = {"destination_identity": self._robot, "method": SYSTEM_INFO, "payload": "{}"}
        try:
            async with asyncio.timeout(ROBOT_TIMEOUT_S + 1.0):
                reply = await self._room.local_participant.perform_rpc(**call, response_timeout=ROBOT_TIMEOUT_S)
        except (TimeoutError, self._rtc.RpcError) as problem:
            text = str(getattr(problem, "message", "")) or "no answer in time"
            _log.warning("the robot does not tell its facts: %s", hide_token(text))
            return None
        return parse_facts(reply)

    # -- what goes out -------------------------------------------------------------------------------------

    async def _send(self) -> None:
        sent = False
        while (command := await self._commands.get()) is not None:
            packet, streamed = command
            if not (streamed and self._push(packet)):
                await self._publish(packet)
            sent = True
            with self._count_lock:
                self._waiting -= 1
        if sent:
            await asyncio.sleep(LINGER_S)
        if not self._ended.done():
            self._ended.set_result(None)

    async def _publish(self, packet: bytes) -> None:
        try:
            async with asyncio.timeout(PACKET_TIMEOUT_S):
                await self._room.local_participant.publish_data(packet, reliable=True, topic=COMMANDS)
        except (TimeoutError, self._rtc.participant.PublishDataError) as problem:
            text = str(getattr(problem, "message", "")) or "no answer in time"
            _log.warning("a command did not go out: %s", hide_token(text, self._address.token))

    def _push(self, packet: bytes) -> bool:
        """Send a setpoint on this client's data track; False where there is none (yet)."""
        if not self._robot_reads_track():
            return False
        if self._track is None:
            if not self._track_wanted:
                self._track_wanted = True
                self._start(self._publish_track(), "commands track")
            return False
        try:
            self._track.try_push(self._rtc.DataTrackFrame(packet))
        except self._rtc.PushFrameError:
            return False
        return True

    def _robot_reads_track(self) -> bool:
        robot = self._room.remote_participants.get(self._robot or "")
        return (
            self.dialect is Dialect.IO and robot is not None and robot.attributes.get(COMMANDS_TRACK_ATTRIBUTE) == "1"
        )

    async def _publish_track(self) -> None:
        try:
            async with asyncio.timeout(PACKET_TIMEOUT_S):
                self._track = await self._room.local_participant.publish_data_track(name=COMMANDS)
        except (TimeoutError, self._rtc.participant.PublishDataTrackError) as problem:
            _log.info("setpoints go as packets: no data track (%s)", type(problem).__name__)

    def _start(self, work: Coroutine[Any, Any, None], name: str) -> None:
        task = asyncio.create_task(work, name=name)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
