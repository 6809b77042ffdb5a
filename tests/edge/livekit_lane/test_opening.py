"""The robot's lane opens and closes, says in one line why it cannot, and shows its token to nobody."""

from __future__ import annotations

import asyncio
import logging
import threading
import time

import pytest

from asimov_gym.edge import Dialect
from asimov_gym.edge.transports import TransportError, livekit
from asimov_gym.edge.transports.livekit import LiveKitLane
from asimov_gym.edge.transports.livekit_outbox import Outbox
from asimov_gym.edge.wire import cloud_pb2
from tests.edge.livekit_lane.member import Member, codes, meet, until, wait_for

SECRET = "eyJhbGciOiJIUzI1NiJ9.eyJzdWIiOiJyb2JvdCJ9.c2VjcmV0"


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
