"""The robot in a room, with a stand-in for the client library; the real one is in test_livekit_room.py."""

from __future__ import annotations

import asyncio
import itertools
import json
import logging
import threading
import time
from collections.abc import Callable, Coroutine, Iterator
from types import SimpleNamespace
from typing import Any

import pytest

from asimov_gym.edge import Dialect, DropReason, SimulatedRobot
from asimov_gym.edge.facts import facts
from asimov_gym.edge.transports import TransportError, livekit, livekit_visit
from asimov_gym.edge.transports.livekit import Backoff, LiveKitLane
from asimov_gym.edge.transports.livekit_outbox import EVENTS_KEPT, Outbox
from asimov_gym.edge.transports.livekit_senders import client_name
from asimov_gym.edge.wire import cloud_pb2, io_pb2
from asimov_gym.firmware import State
from tests.livekit_standin import DataTrackFrame, Room, StandInServer

TOKEN = "robot"
"""The stand-in's tokens are identities."""
SECRET = "eyJhbGciOiJIUzI1NiJ9.eyJzdWIiOiJyb2JvdCJ9.c2VjcmV0"


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> StandInServer:
    server = StandInServer()
    server.install(monkeypatch)
    monkeypatch.setattr(livekit, "FIRST_WAIT_S", 0.01)
    monkeypatch.setattr(livekit, "LONGEST_WAIT_S", 0.05)
    monkeypatch.setattr(livekit_visit, "SETTLE_S", 0.01)
    monkeypatch.setattr(livekit_visit, "LINGER_S", 0.0)
    return server


@pytest.fixture
def make_lane(robot: SimulatedRobot, server: StandInServer) -> Iterator[Callable[..., LiveKitLane]]:
    lanes: list[LiveKitLane] = []

    def make(*dialects: Dialect, token: str = TOKEN) -> LiveKitLane:
        lanes.append(LiveKitLane(robot.edge, "ws://room:7880", token, dialects or (Dialect.CLOUD,)))
        lanes[-1].start()
        return lanes[-1]

    yield make
    for lane in lanes:
        lane.stop()


class Member:
    """A client below any session, in the event loop of the test."""

    def __init__(self, server: StandInServer, identity: str = "client") -> None:
        self.room = Room(server)
        self.identity = identity
        self.packets: list[tuple[str, bytes]] = []
        self.frames: dict[str, list[DataTrackFrame]] = {}
        self.room.on("data_received", lambda packet: self.packets.append((packet.topic, packet.data)))
        self.room.on("data_track_published", self._on_track)
        self._tasks: list[asyncio.Task[None]] = []

    async def join(self) -> Member:
        await self.room.connect("", self.identity, None)
        await until(lambda: all(track.readers for other in self.room.others() for track in other.tracks))
        return self

    async def send(self, packet: bytes, topic: str = "commands") -> None:
        await self.room.local_participant.publish_data(packet, topic=topic)

    def taken(self, topic: str) -> list[bytes]:
        return [data for name, data in self.packets if name == topic]

    def _on_track(self, track: Any) -> None:
        self._tasks.append(asyncio.create_task(self._read(track)))

    async def _read(self, track: Any) -> None:
        async for frame in track.subscribe():
            self.frames.setdefault(track.info.name, []).append(frame)


async def until(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + 5.0
    while not condition():
        assert time.monotonic() < end, "it did not happen within 5 s"
        await asyncio.sleep(0.002)


def wait_for(condition: Callable[[], bool]) -> None:
    asyncio.run(until(condition))


def meet(scene: Callable[[], Coroutine[Any, Any, None]]) -> None:
    asyncio.run(scene())


def mode(number: cloud_pb2.Mode.ValueType, sequence: int = 1) -> bytes:
    command = cloud_pb2.CloudCommand(sequence=sequence, mode=cloud_pb2.ModeCommand(mode=number))
    return command.SerializeToString()


def velocity(vx: float, sequence: int = 2) -> bytes:
    command = cloud_pb2.CloudCommand(sequence=sequence, velocity=cloud_pb2.VelocityCommand(vx=vx))
    return command.SerializeToString()


def io_command(sequence: int, **fields: object) -> bytes:
    command = io_pb2.RobotCommand(protocol_version=1, sequence=sequence, **fields)  # type: ignore[arg-type]
    return command.SerializeToString()


STAND, DAMP = mode(cloud_pb2.MODE_STAND), mode(cloud_pb2.MODE_DAMP)


# -- what goes out -------------------------------------------------------------------------------------------------


def test_cloud_telemetry_goes_out_on_track_and_packets_and_events_as_packets(robot, server, make_lane) -> None:
    make_lane()

    async def scene() -> None:
        member = await Member(server).join()
        robot.advance(0.1)
        await until(lambda: bool(member.taken("state")) and "telemetry" in member.frames)
        frame = member.frames["telemetry"][-1]
        sample = cloud_pb2.EdgeTelemetry.FromString(frame.payload)
        assert member.taken("state")[-1] == frame.payload
        assert frame.user_timestamp == sample.timestamp_us
        await member.send(STAND)
        await until(lambda: robot.edge.tally.packets == 1)
        robot.advance(0.1)
        await until(lambda: "mode_change" in codes(member))
        sequences = [cloud_pb2.EdgeEvent.FromString(packet).sequence for packet in member.taken("system")]
        assert sequences == sorted(sequences)
        assert "state" not in member.frames

    meet(scene)


def codes(member: Member) -> list[str]:
    return [cloud_pb2.EdgeEvent.FromString(packet).error.code for packet in member.taken("system")]


def test_io_state_goes_out_ten_times_a_second_with_the_wall_clock(robot, server, make_lane) -> None:
    make_lane(Dialect.IO)

    async def scene() -> None:
        member = await Member(server).join()
        for count in range(1, 6):
            robot.advance(0.1)
            await until(lambda: len(member.frames.get("state", ())) == count)  # noqa: B023
        states = [io_pb2.RobotState.FromString(frame.payload) for frame in member.frames["state"]]
        assert [b.sequence - a.sequence for a, b in itertools.pairwise(states)] == [20] * 4
        assert all(state.protocol_version == 1 and len(state.joint_pos) == 25 for state in states)
        now = robot.clock.realtime_us()
        assert member.frames["state"][-1].user_timestamp == pytest.approx(now, abs=10_000)
        assert member.packets == []

    meet(scene)


def test_both_dialects_have_their_own_track(robot, server, make_lane) -> None:
    make_lane(Dialect.CLOUD, Dialect.IO)

    async def scene() -> None:
        member = await Member(server).join()
        robot.advance(0.1)
        await until(lambda: set(member.frames) == {"telemetry", "state"})

    meet(scene)


def test_reports_that_the_room_did_not_take_are_replaced_by_newer_ones(robot) -> None:
    outbox = Outbox((Dialect.CLOUD,))
    robot.edge.attach(outbox)
    robot.advance(1.0)
    assert outbox.replaced == 9
    assert [report.packet for report in outbox.take_reports().values()] == [robot.edge.latest]
    assert outbox.take_reports() == {}


def test_events_wait_in_order_and_the_oldest_go_first_when_there_are_too_many() -> None:
    outbox = Outbox((Dialect.CLOUD,))
    for number in range(EVENTS_KEPT + 3):
        outbox.on_event(0, b"%d" % number)
    assert outbox.lost_events == 3
    assert outbox.next_event() == b"3"
    outbox.event_sent(b"another")
    first = outbox.next_event()
    outbox.event_sent(first)
    assert outbox.next_event() == b"4"


# -- what comes in -------------------------------------------------------------------------------------------------


def test_only_the_commands_topic_commands(robot, server, make_lane) -> None:
    make_lane()

    async def scene() -> None:
        member = await Member(server).join()
        for topic in ("state", "system", "", "command"):
            await member.send(STAND, topic)
        await member.send(b"\xff" * 40_000)
        await member.send(b"")
        await member.send(STAND)
        await until(lambda: robot.edge.tally.packets == 3)
        assert robot.edge.tally.dropped == {DropReason.TOO_LARGE: 1, DropReason.NO_COMMAND: 1}
        assert robot.edge.tally.accepted == {"mode": 1}
        assert robot.edge.control.holder.name == "room client"

    meet(scene)


def test_a_client_that_leaves_stops_the_robot(robot, server, make_lane) -> None:
    make_lane()

    async def scene() -> None:
        member = await walk(server, robot)
        assert robot.firmware.snapshot.velocity[0] == pytest.approx(0.3)
        await member.room.disconnect()
        await until(lambda: robot.edge.control.holder is None)
        robot.advance(0.1)
        assert robot.firmware.state is State.POLICY
        assert not robot.firmware.snapshot.velocity.any()

    meet(scene)


async def walk(server: StandInServer, robot: SimulatedRobot) -> Member:
    member = await Member(server).join()
    await member.send(STAND)
    await until(lambda: robot.edge.tally.packets == 1)
    robot.advance(0.1)
    await member.send(velocity(0.3))
    await until(lambda: robot.edge.tally.packets == 2)
    robot.advance(0.1)
    assert robot.firmware.state is State.POLICY
    return member


def test_a_damp_that_arrives_after_its_sender_has_left_acts_and_a_velocity_does_not_last(
    robot, server, make_lane
) -> None:
    make_lane()

    async def scene() -> None:
        member = await walk(server, robot)
        await member.room.disconnect()
        ghost = await Member(server, "ghost").join()
        del server.members["robot"].remote_participants["ghost"]
        await until(lambda: robot.edge.control.holder is None)
        await ghost.send(velocity(0.5))
        await until(lambda: robot.edge.tally.packets == 3)
        robot.advance(0.1)
        assert not robot.firmware.snapshot.velocity.any()
        await ghost.send(DAMP)
        await until(lambda: robot.edge.tally.packets == 4)
        robot.advance(0.1)
        assert robot.firmware.state is State.DAMP

    meet(scene)


def test_the_commands_track_streams_in_dialect_io_and_older_frames_are_dropped(robot, server, make_lane) -> None:
    make_lane(Dialect.IO)

    async def scene() -> None:
        member = await Member(server).join()
        await until(lambda: member.room.remote_participants["robot"].attributes.get("asimov.commands_track") == "1")
        track = await member.room.local_participant.publish_data_track(name="commands")
        await until(lambda: bool(track.readers))
        await member.send(io_command(5, mode=io_pb2.CONTROL_MODE_STAND))
        await until(lambda: robot.edge.tally.packets == 1)
        for _ in range(8):
            robot.advance(0.1)
        for sequence in (7, 6, 7, 8):
            track.try_push(DataTrackFrame(io_command(sequence, policy=io_pb2.VelocityCommand(vx=0.01 * sequence))))
        await until(lambda: robot.edge.tally.packets == 5)
        assert robot.edge.tally.dropped == {DropReason.STALE: 2}
        assert robot.edge.tally.accepted == {"mode": 1, "velocity": 2}

    meet(scene)


def test_dialect_cloud_reads_no_commands_track(robot, server, make_lane) -> None:
    make_lane()

    async def scene() -> None:
        member = await Member(server).join()
        assert "asimov.commands_track" not in member.room.remote_participants["robot"].attributes
        track = await member.room.local_participant.publish_data_track(name="commands")
        await member.send(STAND)
        await until(lambda: robot.edge.tally.packets == 1)
        assert track.readers == []

    meet(scene)


def test_the_robot_tells_its_facts_and_that_it_is_simulated(robot, server, make_lane) -> None:
    make_lane()

    async def scene() -> None:
        member = await Member(server).join()
        reply = await member.room.local_participant.perform_rpc(
            destination_identity="robot", method="edge.getSystemInfo", payload="{}", response_timeout=1.0
        )
        assert json.loads(reply) == facts()
        await until(lambda: "asimov.simulator" in member.room.remote_participants["robot"].attributes)

    meet(scene)


def test_names_of_clients_are_clean_and_never_shared() -> None:
    assert client_name("alice") == "room alice"
    identities = ["alice", "alice\n", "alice\r", "alice?", "", " ", "a" * 64, "a" * 65, "a" * 66, "(unknown)", "ünï"]
    identities += [client_name("alice\n").removeprefix("room ")]
    names = [client_name(identity) for identity in identities]
    assert len(set(names)) == len(identities)
    assert all(name.isprintable() and len(name) < 90 for name in names)
    assert "room (unknown)" not in names


# -- losing the room -----------------------------------------------------------------------------------------------


def test_while_the_connection_is_mended_the_robot_does_not_walk(robot, server, make_lane) -> None:
    lane = make_lane(Dialect.CLOUD, Dialect.IO)

    async def scene() -> None:
        member = await walk(server, robot)
        track = await member.room.local_participant.publish_data_track(name="commands")
        await until(lambda: bool(track.readers))
        assert robot.edge.lanes.cloud_connected
        server.interrupt()
        await until(lambda: not robot.edge.lanes.cloud_connected)
        assert robot.edge.control.holder is None
        robot.advance(0.1)
        assert not robot.firmware.snapshot.velocity.any()
        server.mend()
        await until(lambda: robot.edge.lanes.cloud_connected)
        await until(lambda: any("lost room" in message for message in said(member)))
        assert [message.split(" room")[0] for message in said(member)][-2:] == ["lost", "joined again"]
        track.try_push(DataTrackFrame(io_command(9, policy=io_pb2.VelocityCommand(vx=0.2))))
        await until(lambda: robot.edge.tally.packets == 3)
        assert lane.joined == 1

    meet(scene)


def said(member: Member) -> list[str]:
    events = [cloud_pb2.EdgeEvent.FromString(packet) for packet in member.taken("system")]
    return [event.error.message for event in events if event.error.code == "cloud"]


def test_a_connection_that_is_not_mended_in_time_is_made_anew(robot, server, make_lane, monkeypatch) -> None:
    monkeypatch.setattr(livekit_visit, "RECONNECT_TIMEOUT_S", 0.05)
    lane = make_lane()

    async def scene() -> None:
        server.interrupt()
        await until(lambda: lane.joined == 2)
        assert robot.edge.lanes.cloud_connected

    meet(scene)


def test_an_evicted_robot_comes_back_and_says_once_why_it_cannot(robot, server, make_lane, caplog) -> None:
    lane = make_lane()

    async def scene() -> None:
        server.down = "engine: signal failure: Connection refused (os error 111)"
        server.drop(server.members["robot"], 2)
        await until(lambda: server.attempts >= 5)
        assert not lane.connected
        robot.edge.error(livekit.Code.CONSOLE, "meanwhile")
        server.down = ""
        await until(lambda: lane.connected)
        member = await Member(server).join()
        robot.edge.error(livekit.Code.CONSOLE, "afterwards")
        await until(lambda: "console" in codes(member))

    with caplog.at_level(logging.WARNING):
        meet(scene)
    refusals = [record for record in caplog.records if "cannot join" in record.getMessage()]
    assert len(refusals) == 1
    assert "duplicate identity" in caplog.text


def test_events_wait_for_the_room_and_then_go_out_in_order(robot, server, make_lane) -> None:
    make_lane()

    async def scene() -> None:
        member = await Member(server).join()
        server.refuses_packets = True
        robot.edge.error(livekit.Code.CONSOLE, "first")
        robot.edge.error(livekit.Code.CONSOLE, "second")
        await asyncio.sleep(0.05)
        server.refuses_packets = False
        await until(lambda: codes(member).count("console") == 2)
        events = [cloud_pb2.EdgeEvent.FromString(packet) for packet in member.taken("system")]
        assert [event.error.message for event in events if event.error.code == "console"] == ["first", "second"]

    meet(scene)


def test_waits_between_attempts_grow_to_a_cap() -> None:
    backoff = Backoff(SimpleNamespace(uniform=lambda low, high: high))
    assert [backoff.wait() for _ in range(8)] == [0.5, 1.0, 2.0, 4.0, 8.0, 15.0, 15.0, 15.0]
    backoff.reset()
    assert backoff.wait() == 0.5


# -- opening, closing, secrets -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("problem", "reason"),
    [
        ("engine: signal failure: IO error: Connection refused (os error 111)", "nothing listens there"),
        ("engine: signal failure: client error: 401 Unauthorized - invalid token", "refuses the token"),
        ("engine: signal failure: client error: 404 Not Found", "no LiveKit server"),
        ("engine: signal failure: transport timed out", "no answer"),
        ("engine: wait_pc_connection timed out", "network interface besides loopback"),
        (f"something new about {SECRET}", "something new about (token)"),
    ],
)
def test_a_room_that_cannot_be_joined_at_start_is_one_line(robot, server, problem, reason) -> None:
    server.down = problem
    lane = LiveKitLane(robot.edge, "ws://room:7880", SECRET)
    with pytest.raises(TransportError, match=r"^cannot join the room at ws://room:7880: ") as raised:
        lane.start()
    assert reason in str(raised.value)
    assert SECRET not in str(raised.value) and "\n" not in str(raised.value)
    assert not any(thread.name == "livekit-lane" for thread in threading.enumerate())
    server.down = ""
    with lane:
        assert lane.connected


def test_a_token_without_the_right_to_publish_is_named(robot, server) -> None:
    server.watchers.add("robot")
    with pytest.raises(TransportError, match="needs canPublish and canPublishData"):
        LiveKitLane(robot.edge, "ws://room:7880", "robot").start()


def test_the_token_is_nowhere_to_be_seen(robot, server, make_lane, caplog) -> None:
    server.identities[SECRET] = "robot"
    outbox = Outbox((Dialect.CLOUD,))
    robot.edge.attach(outbox)
    with caplog.at_level(logging.DEBUG):
        lane = make_lane(token=SECRET)
        server.down = f"refused {SECRET}"
        server.drop(server.members["robot"], 2)
        wait_for(lambda: server.attempts >= 3)
        server.down = ""
        wait_for(lambda: lane.connected)
    shown = [lane.connect_line, repr(lane), repr(vars(lane)), caplog.text]
    while (event := outbox.next_event()) is not None:
        shown.append(str(cloud_pb2.EdgeEvent.FromString(event)))
        outbox.event_sent(event)
    assert "refused (token)" in caplog.text and "joined" in "".join(shown)
    assert not any(SECRET in text for text in shown)


@pytest.mark.parametrize(
    ("url", "token", "message"),
    [
        ("http://room", "x", "must begin with ws:// or wss://"),
        ("ws://", "x", "name a host"),
        ("ws://room:99999", "x", "malformed"),
        ("ws://me:secret@room", "x", "token is given by itself"),
        ("ws://room?access_token=secret", "x", "token is given by itself"),
        ("ws://room", "", "token is empty"),
        ("ws://room", "x\n", "blanks"),
    ],
)
def test_a_wrong_address_is_refused_and_not_repeated_where_it_holds_a_secret(robot, url, token, message) -> None:
    with pytest.raises(TransportError, match=message) as raised:
        LiveKitLane(robot.edge, url, token)
    assert "secret" not in str(raised.value)


def test_no_dialect_is_refused(robot) -> None:
    with pytest.raises(TransportError, match="dialects must be"):
        LiveKitLane(robot.edge, "ws://room", "x", ())


def test_a_missing_library_is_one_line(robot, monkeypatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "livekit", None)
    with pytest.raises(TransportError, match=r"pip install 'asimov-gym\[livekit\]'"):
        LiveKitLane(robot.edge, "ws://room", "x").start()


def test_stop_leaves_the_room_and_may_be_called_twice(robot, server, make_lane) -> None:
    lane = make_lane()
    lane.start()
    assert lane.joined == 1 and list(server.members) == ["robot"]
    lane.stop()
    lane.stop()
    assert server.members == {} and not robot.edge.lanes.cloud_connected
    robot.advance(0.2)
    assert lane.outbox.take_reports() == {}
    lane.start()
    assert lane.connected


def test_stop_does_not_wait_for_a_server_that_does_not_answer(robot, server, make_lane) -> None:
    lane = make_lane()
    server.silent = True
    before = server.attempts
    server.drop(server.members["robot"], 2)
    wait_for(lambda: server.attempts > before)
    began = time.monotonic()
    lane.stop()
    assert time.monotonic() - began < 2.0
    assert not any(thread.name == "livekit-lane" for thread in threading.enumerate())


def test_the_last_event_still_goes_out(robot, server, make_lane) -> None:
    lane = make_lane()

    async def scene() -> None:
        member = await Member(server).join()
        robot.edge.error(livekit.Code.SHUTDOWN, "bye")
        await asyncio.to_thread(lane.stop)
        await until(lambda: "shutdown" in codes(member))

    meet(scene)
