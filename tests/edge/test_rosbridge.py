"""Motion modes over rosbridge: the protocol by itself, then the lane against good and bad clients."""

from __future__ import annotations

import json
import socket
import struct
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import pytest

pytest.importorskip("websockets", reason="needs websockets: pip install 'asimov-gym[rosbridge]'")

from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from asimov_gym.edge import SimulatedRobot
from asimov_gym.edge.motion_modes_messages import GET_ACTION, SERVICES, SET_ACTION, VELOCITY
from asimov_gym.edge.motion_modes_service import MotionModes
from asimov_gym.edge.transports import TransportError, rosbridge
from asimov_gym.edge.transports.rosbridge import MAX_CLIENTS, MAX_MESSAGE_BYTES, RosbridgeLane
from asimov_gym.edge.transports.rosbridge_protocol import RosbridgeSession
from asimov_gym.firmware import WallClock
from tests.edge.conftest import StandInPolicy

SET_TYPE = "aimdk_msgs/srv/SetMcAction"
VELOCITY_TYPE = "aimdk_msgs/msg/McLocomotionVelocity"


@pytest.fixture
def modes(robot: SimulatedRobot) -> MotionModes:
    return MotionModes(robot.edge)


@pytest.fixture
def session(modes: MotionModes) -> RosbridgeSession:
    return RosbridgeSession(modes)


def say(session: RosbridgeSession, **message: Any) -> Any:
    return session.take(json.dumps(message))


# -- the protocol ----------------------------------------------------------------------------------


def test_a_call(session: RosbridgeSession) -> None:
    answer = say(session, op="call_service", id="call:7", service=GET_ACTION, args={})
    assert (answer["op"], answer["id"], answer["service"], answer["result"]) == (
        "service_response",
        "call:7",
        GET_ACTION,
        True,
    )
    assert answer["values"]["info"] == {
        "current_action": {"value": 1},
        "action_desc": "PASSIVE_DEFAULT",
        "status": {"value": 100},
    }
    stamp = answer["values"]["header"]["stamp"]
    assert stamp.keys() == {"sec", "nanosec"} and answer["values"]["header"]["code"] == 0


@pytest.mark.parametrize(
    "args",
    [
        {"source": "pnc", "command": {"action_desc": "DAMPING_DEFAULT"}},
        [{}, "pnc", {"action_desc": "DAMPING_DEFAULT"}],
    ],
)
def test_arguments_by_name_and_by_place(session: RosbridgeSession, modes: MotionModes, args: Any) -> None:
    answer = say(session, op="call_service", service=SET_ACTION[1:], type=SET_TYPE, args=args)
    assert answer["result"] and answer["values"]["response"]["status"] == {"value": 1}
    assert "id" not in answer
    assert modes.mode.value == "DAMPING_DEFAULT"


def test_what_the_robot_refuses_is_no_error_of_the_call(session: RosbridgeSession) -> None:
    answer = say(session, op="call_service", service=SET_ACTION, args={"command": {"action_desc": "STAND_DEFAULT"}})
    response = answer["values"]["response"]
    assert answer["result"] and response["status"]["value"] == 2 and response["header"]["code"] != 0
    assert "PASSIVE_DEFAULT does not lead to STAND_DEFAULT" in response["message"]


@pytest.mark.parametrize(
    "call, words",
    [
        ({"service": "/none", "args": {}}, "there is no service '/none'"),
        ({"service": SET_ACTION, "type": "std_srvs/srv/Trigger"}, f"the type is {SET_TYPE}"),
        ({"service": SET_ACTION, "args": {"mode": "x"}}, "has no field 'mode'"),
        ({"service": SET_ACTION, "args": {"source": 5}}, "source must be a string"),
        ({"service": SET_ACTION, "args": "x"}, "must be an object"),
        ({"service": "/rosapi/service_type", "args": {}}, "service must be a string"),
    ],
)
def test_a_wrong_call_is_answered_with_its_error(session: RosbridgeSession, call: dict, words: str) -> None:
    answer = say(session, op="call_service", id=1, **call)
    assert answer["result"] is False and answer["id"] == 1 and words in answer["values"]


@pytest.mark.parametrize(
    "text, words",
    [
        ("", "no JSON"),
        ("{", "no JSON"),
        ("[" * 100_000, "no JSON"),
        ('{"op": ' + "9" * 5000 + "}", "no JSON"),
        ("[]", "JSON object"),
        ("null", "JSON object"),
        ("{}", "op must be one of"),
        ('{"op": ["publish"]}', "op must be one of"),
        ('{"op": "advertise_service", "id": "a"}', "op must be one of"),
        ('{"op": "call_service"}', "service must be a name"),
        ('{"op": "publish", "msg": {}}', "topic must be a name"),
        ('{"op": "publish", "topic": "/cmd_vel", "msg": {}}', "there is no topic '/cmd_vel'"),
        (f'{{"op": "advertise", "topic": "{VELOCITY}", "type": "geometry_msgs/Twist"}}', VELOCITY_TYPE),
        (f'{{"op": "publish", "topic": "{VELOCITY}", "msg": {{"forward_velocity": "fast"}}}}', "must be a number"),
        ('{"op": "set_level", "level": 3}', "level must be one of"),
        (b"\x00\x01", "binary"),
    ],
)
def test_nonsense_gets_a_status_message(session: RosbridgeSession, text: str | bytes, words: str) -> None:
    answer = session.take(text)
    assert answer["op"] == "status" and answer["level"] == "error" and words in answer["msg"]
    assert len(answer["msg"]) < 400


def test_status_messages_can_be_turned_off(session: RosbridgeSession) -> None:
    assert session.take('{"op": "set_level", "level": "none"}') is None
    assert session.take("nonsense") is None


def test_publishing_needs_no_advertising(session: RosbridgeSession, robot: SimulatedRobot) -> None:
    assert say(session, op="advertise", topic=VELOCITY, type="aimdk_msgs/McLocomotionVelocity") is None
    assert say(session, op="publish", topic=VELOCITY, msg={"source": "pnc", "forward_velocity": None}) is None
    assert [reason.name for reason in robot.edge.tally.dropped] == ["VELOCITY_NOT_FINITE"]


def test_looking_around(session: RosbridgeSession) -> None:
    def ask(name: str, **args: str) -> Any:
        return say(session, op="call_service", service=f"/rosapi/{name}", args=args)["values"]

    services = ask("services")["services"]
    assert set(SERVICES) < set(services)
    types = {name: ask("service_type", service=name)["type"] for name in services}
    assert types[SET_ACTION] == SET_TYPE and types["/rosapi/service_type"] == "rosapi_msgs/srv/ServiceType"
    assert ask("service_type", service="/none")["type"] == ""
    assert ask("services_for_type", type=SET_TYPE) == {"services": [SET_ACTION]}
    assert ask("topics") == {"topics": [VELOCITY], "types": [VELOCITY_TYPE]}
    assert ask("topic_type", topic=VELOCITY) == {"type": VELOCITY_TYPE}
    assert ask("topics_for_type", type=VELOCITY_TYPE) == {"topics": [VELOCITY]}


# -- the lane --------------------------------------------------------------------------------------


@pytest.fixture
def lane(robot: SimulatedRobot, modes: MotionModes) -> Iterator[RosbridgeLane]:
    with modes, RosbridgeLane(robot.edge, modes, port=0) as lane:
        yield lane


def client(lane: RosbridgeLane, **options: Any) -> ClientConnection:
    return connect(lane.connect_line, close_timeout=0.2, **options)


def ask(connection: ClientConnection, **message: Any) -> Any:
    connection.send(json.dumps(message))
    return json.loads(connection.recv(timeout=5))


def until(condition: Any, seconds: float = 3.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not come about"
        time.sleep(0.005)


def test_nonsense_costs_nobody_the_connection(lane: RosbridgeLane) -> None:
    with client(lane) as connection:
        connection.send("{")
        assert json.loads(connection.recv(timeout=5))["op"] == "status"
        connection.send(b"\xff")
        assert json.loads(connection.recv(timeout=5))["op"] == "status"
        assert ask(connection, op="call_service", service=GET_ACTION)["result"]


def test_a_message_too_long_ends_the_connection_only(lane: RosbridgeLane) -> None:
    with client(lane) as other:
        with client(lane) as connection, pytest.raises(ConnectionClosed):
            connection.send(json.dumps({"op": "x" * MAX_MESSAGE_BYTES}))
            connection.recv(timeout=5)
        assert ask(other, op="call_service", service=GET_ACTION)["result"]


def test_an_abrupt_end(lane: RosbridgeLane) -> None:
    """The connection is reset without a close frame, a request on its way."""
    with client(lane) as connection:
        connection.send(json.dumps({"op": "subscribe", "topic": VELOCITY}))
        ask(connection, op="call_service", service=GET_ACTION)
        connection.send(json.dumps({"op": "call_service", "service": GET_ACTION}))
        connection.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        connection.socket.close()
        until(lambda: lane.clients == 0)
    with client(lane) as again:
        assert ask(again, op="call_service", service=GET_ACTION)["result"]


def test_clients_hear_what_others_publish(lane: RosbridgeLane) -> None:
    with client(lane) as listener, client(lane) as speaker:
        listener.send(json.dumps({"op": "subscribe", "topic": VELOCITY, "type": VELOCITY_TYPE}))
        ask(listener, op="call_service", service=GET_ACTION)  # an answer: the subscription was taken before it
        speaker.send(
            json.dumps({"op": "publish", "topic": VELOCITY, "msg": {"source": "pnc", "angular_velocity": 0.25}})
        )
        heard = json.loads(listener.recv(timeout=5))
        assert (heard["op"], heard["topic"]) == ("publish", VELOCITY)
        assert heard["msg"]["angular_velocity"] == 0.25 and heard["msg"]["header"]["stamp"] == {"sec": 0, "nanosec": 0}
        listener.send(json.dumps({"op": "unsubscribe", "topic": VELOCITY}))
        ask(listener, op="call_service", service=GET_ACTION)
        speaker.send(json.dumps({"op": "publish", "topic": VELOCITY, "msg": {"source": "pnc"}}))
        ask(speaker, op="call_service", service=GET_ACTION)
        with pytest.raises(TimeoutError):
            listener.recv(timeout=0.1)


def test_who_does_not_read_holds_up_nobody(lane: RosbridgeLane) -> None:
    call = json.dumps({"op": "call_service", "service": "/rosapi/services", "id": "x" * 30_000})
    with client(lane, max_queue=1) as deaf:
        deaf.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        sending = threading.Thread(target=lambda: _send_on(deaf, call), daemon=True)
        sending.start()
        with client(lane) as other:
            start = time.monotonic()
            for _ in range(20):
                assert ask(other, op="call_service", service=GET_ACTION)["result"]
            assert time.monotonic() - start < 2.0
        assert sending.is_alive()  # the lane reads no more from it, either
        deaf.socket.shutdown(socket.SHUT_RDWR)  # to close it would not wake the thread that sends
        sending.join(5.0)
        assert not sending.is_alive()


def test_who_never_reads_loses_the_connection(lane: RosbridgeLane, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rosbridge, "STALL_S", 0.2)
    call = json.dumps({"op": "call_service", "service": "/rosapi/services", "id": "x" * 30_000})
    with client(lane, max_queue=1) as deaf:
        sending = threading.Thread(target=lambda: _send_on(deaf, call), daemon=True)
        sending.start()
        until(lambda: lane.clients == 0, seconds=10.0)
        sending.join(5.0)
        assert not sending.is_alive()


def _send_on(connection: ClientConnection, text: str) -> None:
    try:
        for _ in range(3000):
            connection.send(text)
    except (ConnectionClosed, OSError):
        pass


def test_there_is_an_end_to_clients(lane: RosbridgeLane) -> None:
    with ExitStack() as stack:
        connections = [stack.enter_context(client(lane)) for _ in range(MAX_CLIENTS)]
        until(lambda: lane.clients == MAX_CLIENTS)
        with pytest.raises(InvalidStatus, match="503"), client(lane):
            pass
        connections.pop().close()
        until(lambda: lane.clients < MAX_CLIENTS)
        stack.enter_context(client(lane))


@pytest.mark.parametrize("origin, taken", [("http://localhost:8000", True), ("https://example.com", False)])
def test_pages_of_other_machines_are_kept_out(lane: RosbridgeLane, origin: str, taken: bool) -> None:
    if taken:
        with client(lane, origin=origin) as connection:
            assert ask(connection, op="call_service", service=GET_ACTION)["result"]
        return
    with pytest.raises(InvalidStatus, match="403"), client(lane, origin=origin):
        pass


def test_what_speaks_no_websocket(lane: RosbridgeLane) -> None:
    for words in (b"GET / HTTP/1.1\r\n\r\n", b"\x16\x03\x01\x00\xff" * 100, b""):
        with socket.create_connection(("127.0.0.1", lane.port)) as plain:
            plain.sendall(words)
    with client(lane) as connection:
        assert ask(connection, op="call_service", service=GET_ACTION)["result"]


def test_stopping_ends_connections_and_frees_the_port(robot: SimulatedRobot, modes: MotionModes) -> None:
    threads = threading.active_count()
    lane = RosbridgeLane(robot.edge, modes, port=0)
    lane.start()
    lane.start()
    port = lane.port
    with client(lane) as connection:
        start = time.monotonic()
        lane.stop()
        lane.stop()
        assert time.monotonic() - start < 2.0
        with pytest.raises(ConnectionClosed):
            connection.recv(timeout=5)
    until(lambda: threading.active_count() == threads)
    with RosbridgeLane(robot.edge, modes, port=port) as again, client(again) as connection:
        assert ask(connection, op="call_service", service=GET_ACTION)["result"]


def test_a_busy_port_is_one_line(lane: RosbridgeLane, robot: SimulatedRobot, modes: MotionModes) -> None:
    with pytest.raises(TransportError, match=f"TCP port {lane.port} of 127.0.0.1.*--motion-modes rosbridge:PORT"):
        RosbridgeLane(robot.edge, modes, port=lane.port).start()
    with pytest.raises(TransportError, match="from 0 to 65535, got 70000"):
        RosbridgeLane(robot.edge, modes, port=70_000)


def test_answers_are_quick_while_the_robot_runs() -> None:
    """Clients give up after a quarter of a second; a mode that takes two to reach must not hold up its answer."""
    robot = SimulatedRobot(StandInPolicy(), WallClock())
    modes = MotionModes(robot.edge)
    times = []
    with modes, RosbridgeLane(robot.edge, modes, port=0) as lane, robot, client(lane) as connection:
        for name in ("JOINT_DEFAULT", "STAND_DEFAULT", "JOINT_DEFAULT", "PASSIVE_DEFAULT", "JOINT_DEFAULT") * 4:
            start = time.monotonic()
            args = {"source": "pnc", "command": {"action_desc": name}}
            assert ask(connection, op="call_service", service=SET_ACTION, args=args)["result"]
            times.append(time.monotonic() - start)
            time.sleep(0.01)
    assert max(times) < 0.2
