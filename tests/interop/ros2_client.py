"""A client of the motion-mode services as a ROS 2 node on Cyclone DDS is one, with neither ROS 2 nor asimov_gym.

Run by the tests in a process of its own: `ros2_client.py DOMAIN`. Stands the robot up, walks for a second, lies down,
and prints the longest time that an answer took.
"""

# Cyclone DDS reads the annotations of its types, so they are not to be put off: no `from __future__` here.
import sys
import time
from dataclasses import dataclass

from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import float64, int32, int64, uint32, uint64
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

LOOPBACK = """<CycloneDDS><Domain Id="any"><General><Interfaces><NetworkInterface address="127.0.0.1"/></Interfaces>
<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>
<MaxAutoParticipantIndex>32</MaxAutoParticipantIndex><Peers><Peer Address="127.0.0.1"/></Peers></Discovery>
</Domain></CycloneDDS>"""
"""What a ROS 2 node with ROS_LOCALHOST_ONLY=1 comes to."""


@dataclass
class Time(IdlStruct, typename="builtin_interfaces.msg.dds_.Time_"):
    sec: int32
    nanosec: uint32


@dataclass
class RequestHeader(IdlStruct, typename="aimdk_msgs.msg.dds_.RequestHeader_"):
    stamp: Time


@dataclass
class CommonRequest(IdlStruct, typename="aimdk_msgs.msg.dds_.CommonRequest_"):
    header: RequestHeader


@dataclass
class ResponseHeader(IdlStruct, typename="aimdk_msgs.msg.dds_.ResponseHeader_"):
    stamp: Time
    code: int64


@dataclass
class CommonState(IdlStruct, typename="aimdk_msgs.msg.dds_.CommonState_"):
    value: int32


@dataclass
class CommonResponse(IdlStruct, typename="aimdk_msgs.msg.dds_.CommonResponse_"):
    header: ResponseHeader
    status: CommonState
    message: str


@dataclass
class McAction(IdlStruct, typename="aimdk_msgs.msg.dds_.McAction_"):
    value: int32


@dataclass
class McActionStatus(IdlStruct, typename="aimdk_msgs.msg.dds_.McActionStatus_"):
    value: int32


@dataclass
class McActionInfo(IdlStruct, typename="aimdk_msgs.msg.dds_.McActionInfo_"):
    current_action: McAction
    action_desc: str
    status: McActionStatus


@dataclass
class McActionCommand(IdlStruct, typename="aimdk_msgs.msg.dds_.McActionCommand_"):
    action: McAction
    action_desc: str


@dataclass
class MessageHeader(IdlStruct, typename="aimdk_msgs.msg.dds_.MessageHeader_"):
    stamp: Time
    frame_id: str
    sequence: uint32
    meas_stamp: Time


@dataclass
class McLocomotionVelocity(IdlStruct, typename="aimdk_msgs.msg.dds_.McLocomotionVelocity_"):
    header: MessageHeader
    source: str
    forward_velocity: float64
    lateral_velocity: float64
    angular_velocity: float64


@dataclass
class GetRequest(IdlStruct, typename="aimdk_msgs.srv.dds_.GetMcAction_Request_"):
    client_id: uint64
    sequence_number: int64
    request: CommonRequest


@dataclass
class GetResponse(IdlStruct, typename="aimdk_msgs.srv.dds_.GetMcAction_Response_"):
    client_id: uint64
    sequence_number: int64
    header: ResponseHeader
    info: McActionInfo


@dataclass
class SetRequest(IdlStruct, typename="aimdk_msgs.srv.dds_.SetMcAction_Request_"):
    client_id: uint64
    sequence_number: int64
    header: RequestHeader
    source: str
    command: McActionCommand


@dataclass
class SetResponse(IdlStruct, typename="aimdk_msgs.srv.dds_.SetMcAction_Response_"):
    client_id: uint64
    sequence_number: int64
    response: CommonResponse


class ServiceClient:
    """Calls one service."""

    slowest = 0.0

    def __init__(self, participant: DomainParticipant, name: str, request: type, response: type) -> None:
        identity = ".".join(f"{byte:x}" for byte in participant.guid.bytes) + name[-9:]
        qos = Qos(
            Policy.Reliability.Reliable(100_000_000),
            Policy.Durability.Volatile,
            Policy.History.KeepLast(10),
            Policy.Userdata(f"clientid={identity};".encode()),
        )
        self.writer = DataWriter(participant, Topic(participant, f"rq{name}Request", request), qos)
        self.reader = DataReader(participant, Topic(participant, f"rr{name}Reply", response), qos)
        self.request = request
        self.number = 0

    def wait(self) -> None:
        end = time.monotonic() + 10.0
        while not (self.writer.get_matched_subscriptions() and self.reader.get_matched_publications()):
            assert time.monotonic() < end, "the service was not found"
            time.sleep(0.01)

    def call(self, *fields: object) -> object:
        self.number += 1
        start = time.monotonic()
        client = self.writer.get_instance_handle() % (1 << 64)  # which is given with a sign
        self.writer.write(self.request(client, self.number, *fields))
        while True:
            for sample in self.reader.take(10):
                if (sample.client_id, sample.sequence_number) == (client, self.number):
                    ServiceClient.slowest = max(ServiceClient.slowest, time.monotonic() - start)
                    return sample
            assert time.monotonic() < start + 2.0, "no answer"
            time.sleep(0.001)


def main(domain_id: int) -> None:
    domain = Domain(domain_id, LOOPBACK)  # must outlive the rest
    participant = DomainParticipant(domain_id)
    get = ServiceClient(participant, "/aimdk_5Fmsgs/srv/GetMcAction", GetRequest, GetResponse)
    switch = ServiceClient(participant, "/aimdk_5Fmsgs/srv/SetMcAction", SetRequest, SetResponse)
    topic = Topic(participant, "rt/aima/mc/locomotion/velocity", McLocomotionVelocity)
    walk = DataWriter(participant, topic, Qos(Policy.Reliability.Reliable(100_000_000), Policy.History.KeepLast(10)))
    get.wait()
    switch.wait()

    def stamp() -> Time:
        now = time.time_ns()
        return Time(now // 10**9, now % 10**9)

    def mode() -> tuple[str, int]:
        info = get.call(CommonRequest(RequestHeader(stamp()))).info  # type: ignore[attr-defined]
        return info.action_desc, info.status.value

    def go(name: str) -> None:
        """Ask until the robot is there, a fresh request each time."""
        end = time.monotonic() + 10.0
        while mode() != (name, 100):
            command = McActionCommand(McAction(0), name)
            answer = switch.call(RequestHeader(stamp()), "pnc", command).response  # type: ignore[attr-defined]
            assert (answer.header.code == 0) == (answer.status.value == 1), answer
            assert time.monotonic() < end, answer.message
            time.sleep(0.1)

    assert mode() == ("PASSIVE_DEFAULT", 100)
    go("JOINT_DEFAULT")
    go("STAND_DEFAULT")
    for sequence in range(50):
        walk.write(McLocomotionVelocity(MessageHeader(stamp(), "", sequence, stamp()), "pnc", 0.3, 0.0, 0.1))
        time.sleep(0.02)
    assert mode() == ("LOCOMOTION_DEFAULT", 100), mode()
    time.sleep(1.2)  # a silent source stops it
    assert mode() == ("STAND_DEFAULT", 100), mode()
    go("DAMPING_DEFAULT")
    assert domain.get_domain_id() == domain_id
    print(f"slowest answer, s: {ServiceClient.slowest:.4f}")


if __name__ == "__main__":
    main(int(sys.argv[1]))
