"""What goes out of the robot's lane into a room, and what comes in."""

from __future__ import annotations

import itertools
import json

import pytest

from asimov_gym.edge import Dialect, DropReason
from asimov_gym.edge.facts import facts
from asimov_gym.edge.transports.livekit_outbox import EVENTS_KEPT, Outbox
from asimov_gym.edge.transports.livekit_senders import client_name
from asimov_gym.edge.wire import cloud_pb2, io_pb2
from asimov_gym.firmware import State
from tests.edge.livekit_lane.member import DAMP, STAND, Member, codes, io_command, meet, until, velocity, walk
from tests.livekit_standin import DataTrackFrame

# -- what goes out --------------------------------------------------------------------------------------------------


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


# -- what comes in --------------------------------------------------------------------------------------------------


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
