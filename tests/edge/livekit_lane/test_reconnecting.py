"""The robot's lane loses its room and finds it again."""

from __future__ import annotations

import asyncio
import logging
from types import SimpleNamespace

from asimov_gym.edge import Dialect
from asimov_gym.edge.transports import livekit, livekit_visit
from asimov_gym.edge.transports.livekit import Backoff
from asimov_gym.edge.wire import cloud_pb2, io_pb2
from tests.edge.livekit_lane.member import Member, codes, io_command, meet, said, until, walk
from tests.livekit_standin import DataTrackFrame


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
        about_rooms = lambda: [message.split(" room")[0] for message in said(member) if " room" in message]  # noqa: E731
        # Each event travels by itself; the first "joined" may have been before the member was there.
        await until(lambda: about_rooms()[-2:] == ["lost", "joined again"])
        track.try_push(DataTrackFrame(io_command(9, policy=io_pb2.VelocityCommand(vx=0.2))))
        await until(lambda: robot.edge.tally.packets == 3)
        assert lane.joined == 1

    meet(scene)


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
