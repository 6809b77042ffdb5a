"""Motion modes over ROS 2: bytes, names and settings as a ROS 2 node on Cyclone DDS has them, and how it behaves."""

from __future__ import annotations

import logging
import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("cyclonedds", reason="needs Cyclone DDS: pip install 'asimov-gym[ros2]'")

from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from asimov_gym.edge import SimulatedRobot
from asimov_gym.edge.motion_modes_messages import (
    GET_ACTION,
    SERVICES,
    SET_ACTION,
    VELOCITY,
    McLocomotionVelocity,
    from_json,
    layout,
)
from asimov_gym.edge.motion_modes_service import MotionModes
from asimov_gym.edge.transports import TransportError
from asimov_gym.edge.transports.ros2 import REPLY_PATIENCE_S, Ros2Lane
from asimov_gym.edge.transports.ros2_domain import environment_domain_id
from asimov_gym.edge.transports.ros2_types import dds_type, from_dds, paired_dds_type, to_dds
from asimov_gym.firmware import WallClock
from tests.edge.conftest import StandInPolicy
from tests.network_namespace import ADDRESS, in_namespace

DOMAIN = 10 + os.getpid() % 90
"""Of this test run alone: another one on this machine must not answer."""
RELIABLE = (
    Policy.Reliability.Reliable(100_000_000),
    Policy.Durability.Volatile,
    Policy.History.KeepLast(10),
)

DEFINITIONS = {
    "aimdk_msgs/msg/RequestHeader": "builtin_interfaces/Time stamp",
    "aimdk_msgs/msg/CommonRequest": "RequestHeader header",
    "aimdk_msgs/msg/ResponseHeader": "builtin_interfaces/Time stamp\nint64 code",
    "aimdk_msgs/msg/CommonState": "int32 value",
    "aimdk_msgs/msg/CommonResponse": "ResponseHeader header\nCommonState status\nstring message",
    "aimdk_msgs/msg/CommonTaskResponse": "ResponseHeader header\nuint64 task_id\nCommonState state",
    "aimdk_msgs/msg/McAction": "int32 value",
    "aimdk_msgs/msg/McActionStatus": "int32 value",
    "aimdk_msgs/msg/McActionInfo": "McAction current_action\nstring action_desc\nMcActionStatus status",
    "aimdk_msgs/msg/McActionCommand": "McAction action\nstring action_desc",
    "aimdk_msgs/msg/McInputAction": "int32 value",
    "aimdk_msgs/msg/McInputSource": "string name\nint32 priority\nint32 timeout",
    "aimdk_msgs/msg/MessageHeader": (
        "builtin_interfaces/Time stamp\nstring frame_id\nuint32 sequence\nbuiltin_interfaces/Time meas_stamp"
    ),
    "aimdk_msgs/msg/McLocomotionVelocity": (
        "MessageHeader header\nstring source\nfloat64 forward_velocity\nfloat64 lateral_velocity\n"
        "float64 angular_velocity"
    ),
    "aimdk_msgs/srv/GetMcAction_Request": "aimdk_msgs/CommonRequest request",
    "aimdk_msgs/srv/GetMcAction_Response": "aimdk_msgs/ResponseHeader header\naimdk_msgs/McActionInfo info",
    "aimdk_msgs/srv/SetMcAction_Request": (
        "aimdk_msgs/RequestHeader header\nstring source\naimdk_msgs/McActionCommand command"
    ),
    "aimdk_msgs/srv/SetMcAction_Response": "aimdk_msgs/CommonResponse response",
    "aimdk_msgs/srv/SetMcInputSource_Request": (
        "aimdk_msgs/CommonRequest request\naimdk_msgs/McInputAction action\naimdk_msgs/McInputSource input_source"
    ),
    "aimdk_msgs/srv/SetMcInputSource_Response": "aimdk_msgs/CommonTaskResponse response",
    "aimdk_msgs/srv/GetCurrentInputSource_Request": "aimdk_msgs/CommonRequest request",
    "aimdk_msgs/srv/GetCurrentInputSource_Response": (
        "aimdk_msgs/CommonTaskResponse response\naimdk_msgs/McInputSource input_source"
    ),
}
"""Field lists of the vendor's messages, in ROS's own notation, written out a second time."""

MESSAGES = [McLocomotionVelocity, *(part for each in SERVICES.values() for part in (each.request, each.response))]


def filled(message: type, count: Iterator[int] | None = None) -> Any:
    """A message with another value in every field."""
    numbers = iter(range(1, 1000)) if count is None else count

    def value(kind: Any) -> Any:
        if not isinstance(kind, str):
            return filled(kind, numbers)
        number = next(numbers)
        sign = 1 if kind.startswith("u") else -1
        return {"string": f"text é {number}" * (number % 3), "float64": number / 7}.get(kind, sign * number * 1000)

    return message(**{name: value(kind) for name, kind in layout(message)})


def ros_name(name: str) -> str:
    """A request or response as rosbags files it: as if it were a message."""
    return name.replace("/srv/", "/msg/")


# -- bytes and names -------------------------------------------------------------------------------


@pytest.mark.parametrize("message", MESSAGES, ids=lambda message: message.__name__)
def test_bytes_are_those_of_ros(message: Any) -> None:
    stores = pytest.importorskip("rosbags.typesys", reason="needs rosbags, of the extra `test`")
    store = stores.get_typestore(stores.Stores.ROS2_HUMBLE)
    for name, text in DEFINITIONS.items():
        store.register(stores.get_types_from_msg(text, ros_name(name)))

    def ros(value: Any) -> Any:
        fields = {
            name: getattr(value, name) if isinstance(kind, str) else ros(getattr(value, name))
            for name, kind in layout(type(value))
        }
        return store.types[ros_name(value.type_name)](**fields)

    sample = filled(message)
    expected = bytes(store.serialize_cdr(ros(sample), ros_name(message.type_name)))
    sent = to_dds(sample, dds_type(message)).serialize(use_version_2=False)
    assert sent == expected
    assert from_dds(message, dds_type(message).deserialize(sent)) == sample
    if "/srv/" in message.type_name:
        pairing = {"client_id": 0x1122334455667788, "sequence_number": -2}
        paired = to_dds(sample, paired_dds_type(message), **pairing).serialize(use_version_2=False)
        head = bytes.fromhex("8877665544332211") + bytes.fromhex("feffffffffffffff")
        assert paired == expected[:4] + head + expected[4:]


def test_defaults_are_those_of_the_definitions() -> None:
    for message in MESSAGES:
        assert from_json(message, {}) == message()


# -- the lane --------------------------------------------------------------------------------------


@pytest.fixture
def lane(robot: SimulatedRobot) -> Iterator[Ros2Lane]:
    modes = MotionModes(robot.edge)
    with modes, Ros2Lane(modes, DOMAIN) as lane:
        yield lane


class Node:
    """A client node of a service, in this process's copy of the domain."""

    def __init__(self, service: str = GET_ACTION, identity: bytes | None = b" 1.2.3", replies: bool = True) -> None:
        self.participant = DomainParticipant(DOMAIN)
        self.kinds = SERVICES[service]
        user_data = () if identity is None else (Policy.Userdata(b"clientid=" + identity + b";"),)
        self.qos = Qos(*RELIABLE, *user_data)
        self.request = paired_dds_type(self.kinds.request)
        self.response = paired_dds_type(self.kinds.response)
        self.service = service
        topic = Topic(self.participant, f"rq{service}Request", self.request)
        self.writer = DataWriter(self.participant, topic, self.qos)
        self.reader: DataReader | None = None
        if replies:
            self.listen()

    def listen(self) -> None:
        topic = Topic(self.participant, f"rr{self.service}Reply", self.response)
        self.reader = DataReader(self.participant, topic, self.qos)

    def ask(self, number: int, **fields: Any) -> None:
        message = from_json(self.kinds.request, fields)
        self.writer.write(to_dds(message, self.request, client_id=7, sequence_number=number))

    def answer(self, seconds: float = 5.0) -> Any:
        assert self.reader is not None
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            samples = self.reader.take(1)
            if samples:
                return samples[0]
            time.sleep(0.002)
        return None


def test_names_types_and_settings(lane: Ros2Lane) -> None:
    expected = {
        "GetMcAction": ("Request", "Response"),
        "SetMcAction": ("Request", "Response"),
        "SetMcInputSource": ("Request", "Response"),
        "GetCurrentInputSource": ("Request", "Response"),
    }
    identities = set()
    for name in expected:
        node = Node(f"/aimdk_5Fmsgs/srv/{name}")
        assert node.reader is not None
        (taker,) = node.writer.get_matched_subscriptions()
        (giver,) = node.reader.get_matched_publications()
        endpoints = {
            "rq{}Request": (node.writer.get_matched_subscription_data(taker), "Request"),
            "rr{}Reply": (node.reader.get_matched_publication_data(giver), "Response"),
        }
        pair = set()
        for pattern, (endpoint, part) in endpoints.items():
            assert endpoint is not None
            assert endpoint.topic_name == pattern.format(f"/aimdk_5Fmsgs/srv/{name}")
            assert endpoint.type_name == f"aimdk_msgs::srv::dds_::{name}_{part}_"
            assert isinstance(endpoint.qos[Policy.Reliability], Policy.Reliability.Reliable)
            assert endpoint.qos[Policy.History] == Policy.History.KeepLast(10)
            assert endpoint.qos[Policy.Durability] == Policy.Durability.Volatile
            pair.add(endpoint.qos[Policy.Userdata].data)
        (identity,) = pair  # reader and writer of a server carry the same
        assert identity.startswith(b"serviceid=") and identity.endswith(b";")
        identities.add(identity)
    assert len(identities) == len(expected)


def test_a_call_is_answered_with_its_own_pairing(lane: Ros2Lane) -> None:
    node = Node(SET_ACTION)
    for number in (5, -1, (1 << 63) - 1):
        node.ask(number, command={"action_desc": "STAND_DEFAULT"})
        answer = node.answer()
        assert (answer.client_id, answer.sequence_number) == (7, number)
        assert answer.response.status.value == 2 and "does not lead" in answer.response.message


def test_a_reply_waits_for_its_reader(lane: Ros2Lane) -> None:
    """Discovery may tell a server of the request's writer before it tells of the reply's reader."""
    node = Node(replies=False)
    node.ask(1)
    time.sleep(REPLY_PATIENCE_S / 3)
    node.listen()
    answer = node.answer()
    assert answer is not None and answer.info.action_desc == "PASSIVE_DEFAULT"


def test_a_client_without_a_reader_holds_up_nobody(lane: Ros2Lane, caplog: pytest.LogCaptureFixture) -> None:
    deaf, other = Node(identity=b" 9.9", replies=False), Node()
    for number in range(8):
        deaf.ask(number)
    start = time.monotonic()
    other.ask(2)
    assert other.answer().sequence_number == 2
    assert time.monotonic() - start < 5 * REPLY_PATIENCE_S
    time.sleep(2 * REPLY_PATIENCE_S)
    assert "no reader of the client" in caplog.text


def test_a_client_that_does_not_say_who_it_is(lane: Ros2Lane) -> None:
    node = Node(identity=None)
    node.ask(3)
    assert node.answer().sequence_number == 3


@pytest.mark.parametrize("reliability", [Policy.Reliability.BestEffort, RELIABLE[0]], ids=["best effort", "reliable"])
def test_velocities(lane: Ros2Lane, robot: SimulatedRobot, reliability: Any) -> None:
    participant = DomainParticipant(DOMAIN)
    topic = Topic(participant, f"rt{VELOCITY}", dds_type(McLocomotionVelocity))
    assert topic.typename == "aimdk_msgs::msg::dds_::McLocomotionVelocity_"
    writer = DataWriter(participant, topic, Qos(reliability))
    message = McLocomotionVelocity(source="pnc", forward_velocity=float("nan"))
    writer.write(to_dds(message, dds_type(McLocomotionVelocity)))
    end = time.monotonic() + 5.0
    while not robot.edge.tally.dropped and time.monotonic() < end:
        time.sleep(0.005)
    assert [reason.name for reason in robot.edge.tally.dropped] == ["VELOCITY_NOT_FINITE"]


def test_bytes_that_are_no_text(lane: Ros2Lane, monkeypatch: pytest.MonkeyPatch) -> None:
    """Strings need not be UTF-8 on the wire. The one request is lost, the lane goes on."""
    node = Node(SET_ACTION)
    sound = node.request.serialize

    def broken(self: Any, *args: Any, **options: Any) -> bytes:
        return sound(self, *args, **options).replace(b"marker", b"\xff\xfe\xfd\xfc\xfb\xfa")

    monkeypatch.setattr(node.request, "serialize", broken)
    node.ask(1, source="marker", command={"action_desc": "DAMPING_DEFAULT"})
    monkeypatch.undo()
    node.ask(2, source="pnc", command={"action_desc": "DAMPING_DEFAULT"})
    assert node.answer().sequence_number == 2


def test_a_burst(lane: Ros2Lane) -> None:
    """A server keeps ten requests at a time; what comes faster is the client's to repeat."""
    node = Node()
    for number in range(200):
        node.ask(number)
    answered = {sample.sequence_number for sample in iter(lambda: node.answer(0.3), None)}
    assert len(answered) >= 10
    node.ask(1000)
    assert node.answer().sequence_number == 1000


@pytest.mark.skipif(not hasattr(socket, "SO_BINDTODEVICE"), reason="only Linux can tie a socket to a device")
def test_nothing_from_outside_gets_in(lane: Ros2Lane) -> None:
    assert lane.confined
    found = []
    for name in os.listdir("/proc/self/fd"):
        try:
            each = socket.socket(fileno=os.dup(int(name)))
        except OSError:
            continue
        with each:
            if each.type is socket.SOCK_DGRAM and each.family is socket.AF_INET:
                host, port = each.getsockname()
                if port:
                    device = each.getsockopt(socket.SOL_SOCKET, socket.SO_BINDTODEVICE, 16).rstrip(b"\0")
                    found.append((host, port, device))
    base = 7400 + 250 * DOMAIN
    ours = [entry for entry in found if base <= entry[1] < base + 100]
    assert len(ours) >= 2
    for host, port, device in found:
        assert host == "127.0.0.1" or device == b"lo", (host, port)


def test_a_domain_is_open_once_in_a_process(lane: Ros2Lane, robot: SimulatedRobot) -> None:
    with pytest.raises(TransportError, match=f"cannot open ROS 2 domain {DOMAIN}"):
        Ros2Lane(MotionModes(robot.edge), DOMAIN).start()


def test_stopping_and_starting_again(robot: SimulatedRobot) -> None:
    lane = Ros2Lane(MotionModes(robot.edge), DOMAIN)
    for _ in range(2):
        lane.start()
        lane.start()
        node = Node()
        node.ask(1)
        assert node.answer().sequence_number == 1
        del node
        lane.stop()
        lane.stop()


@pytest.mark.parametrize(
    "text, number", [("", 0), (" 42 ", 42), ("232", 232), ("233", None), ("-1", None), ("½", None)]
)
def test_the_domain_of_the_environment(monkeypatch: pytest.MonkeyPatch, text: str, number: int | None) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", text)
    if number is None:
        with pytest.raises(TransportError, match="ROS_DOMAIN_ID must be a whole number from 0 to 232"):
            environment_domain_id()
    else:
        assert environment_domain_id() == number


@pytest.mark.parametrize("listen", ["localhost ", "example.com", "203.0.113.9"])
def test_an_address_that_is_not_ours(robot: SimulatedRobot, listen: str) -> None:
    with pytest.raises(TransportError):
        Ros2Lane(MotionModes(robot.edge), DOMAIN, listen).start()


def test_what_a_person_must_know(robot: SimulatedRobot) -> None:
    line = Ros2Lane(MotionModes(robot.edge), DOMAIN).connect_line
    assert "\n" not in line and f"domain {DOMAIN} on 127.0.0.1" in line
    for words in ("RMW_IMPLEMENTATION=rmw_cyclonedds_cpp", "ROS_LOCALHOST_ONLY=1", "get no answer"):
        assert words in line


@pytest.mark.slow
@in_namespace(timeout=20, packages=("cyclonedds", "websockets"))
def test_further_than_loopback_with_a_warning(robot: SimulatedRobot, caplog: pytest.LogCaptureFixture) -> None:
    from asimov_gym.edge.transports.rosbridge import RosbridgeLane

    modes = MotionModes(robot.edge)
    with modes, Ros2Lane(modes, DOMAIN, ADDRESS) as lane, RosbridgeLane(robot.edge, modes, 0, ADDRESS) as bridge:
        assert not lane.confined and "ROS_LOCALHOST_ONLY" not in lane.connect_line
        node = Node()
        node.ask(1)
        assert node.answer().sequence_number == 1
        assert bridge.connect_line == f"ws://{ADDRESS}:{bridge.port}"
        del node
    warnings = [record.getMessage() for record in caplog.records if "not loopback" in record.getMessage()]
    assert len(warnings) == 2 and all(ADDRESS in text and "authenticated" in text for text in warnings)


# -- from another process --------------------------------------------------------------------------


def test_another_program_on_loopback(make_robot: Callable[..., SimulatedRobot]) -> None:
    """A client of its own making, in a process of its own: what it knows of the messages it has from the documents."""
    robot = SimulatedRobot(StandInPolicy(), WallClock())
    modes = MotionModes(robot.edge)
    script = Path(__file__).parents[1] / "interop" / "ros2_client.py"
    with modes, Ros2Lane(modes, DOMAIN), robot:
        done = subprocess.run(
            [sys.executable, str(script), str(DOMAIN)], capture_output=True, text=True, timeout=60, check=False
        )
    assert done.returncode == 0, done.stdout + done.stderr
    slowest = float(done.stdout.split()[-1])
    logging.getLogger(__name__).info("slowest answer %.4f s", slowest)
    assert slowest < 0.2
    assert robot.edge.tally.accepted["motion_velocity"] >= 40
