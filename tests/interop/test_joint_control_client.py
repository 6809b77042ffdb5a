"""The genuine client classes of the vendor's package against the joint-control lane.

The quick tests run in lockstep: time stands still but for `advance`, so their counts are exact. Where a test waits, it
waits for a message to cross the loopback.
"""

from __future__ import annotations

import importlib.util
import random
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

if importlib.util.find_spec("bosdyn") is None:
    pytest.skip("bosdyn-client is not installed: pip install 'asimov-gym[joint-control,test]'", allow_module_level=True)

import grpc
from bosdyn.client.exceptions import InvalidRequestError, LeaseUseError
from bosdyn.client.robot_command import (
    BehaviorFaultError,
    NotClearedError,
    NoTimeSyncError,
    NotPoweredOnError,
    RobotCommandBuilder,
    UnsupportedError,
)

from asimov_gym.edge import EdgeListener, SimulatedRobot, connect
from asimov_gym.edge.transports import TransportError
from asimov_gym.edge.transports.joint_control import JointControlLane
from asimov_gym.edge.transports.joint_control.vendor import (
    lease_pb2,
    robot_command_pb2,
    robot_state_pb2,
    time_sync_pb2,
)
from asimov_gym.edge.verdict import DropReason
from asimov_gym.edge.wire import cloud_pb2
from asimov_gym.firmware import AlertId, State, WallClock
from asimov_gym.robot.joints import JOINT_NAMES, RANGE, STAND_POSITION, joint_index
from asimov_gym.robot.model import robot_model
from asimov_gym.robot.urdf import urdf
from tests.interop.joint_client import (
    ACTIVATE,
    FREEZE,
    POWER_OFF,
    STOP,
    Clients,
    OpenStream,
    StateReader,
    StreamStatus,
    UpdateRequest,
    eventually,
    full_body,
    update,
)

ELBOW = joint_index("left_elbow_joint")


@pytest.fixture
def robot() -> SimulatedRobot:
    return SimulatedRobot()


@pytest.fixture
def lane(robot: SimulatedRobot) -> Iterator[JointControlLane]:
    with JointControlLane(robot.edge, 0) as lane:
        yield lane


@pytest.fixture
def clients(lane: JointControlLane) -> Iterator[Clients]:
    clients = Clients(lane.port)
    clients.synchronize()
    yield clients
    clients.close()


class Pilot:
    """A run in lockstep."""

    def __init__(self, robot: SimulatedRobot, clients: Clients) -> None:
        self.robot, self.clients = robot, clients

    def now(self, ahead_s: float = 0.0) -> int:
        return self.robot.clock.realtime_us() + round(ahead_s * 1e6)

    def update(self, ahead_s: float = 1.0, **fields: Any) -> Any:
        return update(self.now(ahead_s), **fields)

    def open(self, **fields: Any) -> OpenStream:
        """A stream with one update that has arrived."""
        stream = OpenStream(self.clients)
        self.send(stream, **fields)
        return stream

    def send(self, stream: OpenStream, **fields: Any) -> None:
        taken = self.robot.edge.tally.accepted
        before = taken["joint_command"]
        stream.send(self.update(**fields))
        eventually(lambda: taken["joint_command"] > before, "the update arrives")

    def begin(self, **fields: Any) -> OpenStream:
        """A run under way, in the order of the vendor's examples: the stream first."""
        stream = self.open(**fields)
        self.clients.command.robot_command(ACTIVATE)
        self.robot.advance(0.01)
        return stream

    def feedback(self, number: int = 0) -> Any:
        return self.clients.command.robot_command_feedback(number).feedback.full_body_feedback


@pytest.fixture
def pilot(robot: SimulatedRobot, clients: Clients) -> Pilot:
    return Pilot(robot, clients)


# -- clocks ----------------------------------------------------------------------------------------


def test_time_sync_finds_the_robots_clock(robot: SimulatedRobot, lane: JointControlLane) -> None:
    clients = Clients(lane.port)
    ready = []
    for _ in range(4):
        clients.endpoint.get_new_estimate()
        ready.append(clients.endpoint.has_established_time_sync)
    assert ready == [False, False, False, True]
    local_ns = 1_700_000_000 * 10**9
    found = clients.endpoint.get_robot_time_converter().robot_timestamp_from_local_secs(local_ns / 1e9)
    skew_s = clients.endpoint.clock_skew.ToNanoseconds() / 1e9
    assert found.ToNanoseconds() / 1e9 == pytest.approx(local_ns / 1e9 + skew_s, abs=1e-6)
    assert abs(skew_s) > 1e6, "the robot lives in its own year here"
    clients.close()


def test_time_sync_of_a_client_that_does_not_stamp_its_requests_never_settles(lane: JointControlLane) -> None:
    clients = Clients(lane.port)
    clients.time_sync.request_processors.clear()
    for _ in range(5):
        clients.endpoint.get_new_estimate()
    assert not clients.endpoint.has_established_time_sync
    clients.close()


def test_a_round_trip_without_an_identifier_is_invalid(clients: Clients) -> None:
    trip = time_sync_pb2.TimeSyncRoundTrip()
    with pytest.raises(InvalidRequestError):
        clients.time_sync.get_time_sync_update(previous_round_trip=trip, clock_identifier="nobody")


# -- states ----------------------------------------------------------------------------------------


def test_a_third_of_a_thousand_states_a_second(robot: SimulatedRobot, clients: Clients) -> None:
    reader = StateReader(clients)
    eventually(lambda: robot.edge.wants_samples, "the stream is open")
    robot.advance(0.3)
    eventually(lambda: len(reader.messages) >= 100, "the states arrive")
    reader.stop()
    assert len(reader.messages) == 100
    stamps = [message.joint_states.acquisition_timestamp.ToMicroseconds() for message in reader.messages]
    assert set(np.diff(stamps)) == {3000}
    assert len({tuple(message.joint_states.position) for message in reader.messages}) == 100
    packets = [packet.timestamp.ToMicroseconds() for m in reader.messages for packet in m.inertial_state.packets]
    assert set(np.diff(packets)) == {1000}
    eventually(lambda: not robot.edge.wants_samples, "the stream is closed")


def test_a_state_holds_what_the_interface_lists(robot: SimulatedRobot, clients: Clients) -> None:
    clients.command.robot_command(RobotCommandBuilder.synchro_stand_command())
    robot.advance(3.0)
    reader = StateReader(clients)
    eventually(lambda: robot.edge.wants_samples, "the stream is open")
    robot.advance(0.03)
    eventually(lambda: len(reader.messages) >= 10, "the states arrive")
    reader.stop()
    state = reader.messages[-1]
    sensed = robot.firmware.snapshot
    assert len(state.joint_states.velocity) == len(state.joint_states.load) == len(JOINT_NAMES)
    assert list(state.joint_states.position) == pytest.approx(sensed.joint_position.tolist(), abs=1e-6)
    assert list(state.joint_states.load) == pytest.approx(sensed.joint_torque.tolist(), abs=0.5)
    imu = state.inertial_state
    assert (imu.packet_rate, len(imu.packets), imu.mounting_link_name) == (1000.0, 3, "pelvis_link")
    at_rest = imu.packets[-1].acceleration_rt_odom_in_link_frame
    assert [at_rest.x, at_rest.y, at_rest.z] == pytest.approx([0.0, 0.0, 0.0], abs=0.2)
    pose = state.kinematic_state.odom_tform_body
    assert pose.position.z == pytest.approx(0.61, abs=0.02)
    assert state.kinematic_state.vision_tform_body == pose
    assert list(state.contact_states) == [robot_state_pb2.FootState.CONTACT_MADE] * 2
    assert not state.HasField("last_command")


def test_angular_velocity_is_told_in_the_world_frame(robot: SimulatedRobot, clients: Clients) -> None:
    """A robot lying on its side and turning about its long axis turns about the world's horizontal."""
    turned = np.array([np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0])  # its z axis along the world's x
    qpos, qvel = robot.physics.standing()
    qpos[2], qpos[3:7] = 3.0, turned
    qvel[3:6] = (0.0, 0.0, 2.0)  # body frame
    robot.firmware.gantry.by_hand("off")
    robot.physics.reset(qpos, qvel)
    reader = StateReader(clients)
    eventually(lambda: robot.edge.wants_samples, "the stream is open")
    robot.advance(0.005)
    eventually(lambda: reader.messages, "a state arrives")
    reader.stop()
    state = reader.messages[0]
    angular = state.kinematic_state.velocity_of_body_in_odom.angular
    assert [angular.x, angular.y, angular.z] == pytest.approx([2.0, 0.0, 0.0], abs=0.1)
    gyro = state.inertial_state.packets[-1].angular_velocity_rt_odom_in_link_frame
    assert gyro.z == pytest.approx(2.0, abs=0.1)
    falling = state.inertial_state.packets[-1].acceleration_rt_odom_in_link_frame
    assert falling.x == pytest.approx(9.81, abs=0.7), "down is the body's x axis; in free fall it is accelerated there"


def test_the_whole_state_and_the_hardware(robot: SimulatedRobot, clients: Clients) -> None:
    state = clients.state.get_robot_state()
    assert [joint.name for joint in state.kinematic_state.joint_states] == list(JOINT_NAMES)
    assert state.power_state.motor_power_state == robot_state_pb2.PowerState.STATE_OFF
    assert state.battery_states[0].charge_percentage.value > 50.0
    assert not state.behavior_fault_state.faults
    odom = state.kinematic_state.transforms_snapshot.child_to_parent_edge_map["odom"]
    assert odom.parent_frame_name == "body"
    assert odom.parent_tform_child.position.z == pytest.approx(-state_height(robot), abs=0.02)
    assert clients.state.get_robot_hardware_configuration().skeleton.urdf == urdf()


def state_height(robot: SimulatedRobot) -> float:
    return float(robot.physics.read().base_position[0, 2])


# -- a run -----------------------------------------------------------------------------------------


def test_the_order_of_the_vendors_examples(robot: SimulatedRobot, clients: Clients, pilot: Pilot) -> None:
    """States first, then the stream, gains in the first update only, then the activation; keys count from 1."""
    clients.command.robot_command(RobotCommandBuilder.synchro_stand_command())
    robot.advance(2.5)
    reader = StateReader(clients)
    eventually(lambda: robot.edge.wants_samples, "the states are open")
    stream = pilot.open(key=1, ahead_s=0.05)
    assert robot.firmware.state is State.STAND, "updates alone move nothing"
    number = clients.command.robot_command(ACTIVATE)
    for key in range(2, 30):
        pilot.send(stream, key=key, gains=False, ahead_s=0.05)
        robot.advance(0.005)
    fared = pilot.feedback(number)
    assert fared.status == 1, "PROCESSING"
    assert (fared.joint_feedback.status, fared.joint_feedback.num_messages_received) == (1, 29)
    answer = stream.finish()
    assert answer.status == StreamStatus.STATUS_OK
    assert robot.firmware.joints.running, "the last update still runs out"
    eventually(lambda: reader.messages, "states arrive")
    robot.advance(0.06)
    assert (robot.firmware.state, robot.firmware.joints.running) == (State.DAMP, False)
    fared = pilot.feedback(number)
    assert (fared.status, fared.joint_feedback.status) == (3, 2), "COMMAND_TIMED_OUT, ERROR"
    sent_us = robot.clock.realtime_us()
    eventually(lambda: reader.messages[-1].last_command.user_command_key == 29, "the echo")
    reader.stop()
    keys = [message.last_command.user_command_key for message in reader.messages if message.HasField("last_command")]
    assert keys == sorted(keys)
    assert set(keys) >= set(range(2, 30))
    assert reader.messages[-1].last_command.received_timestamp.ToMicroseconds() < sent_us


def test_activation_may_come_first(robot: SimulatedRobot, clients: Clients, pilot: Pilot) -> None:
    """The order of the interface's own text: enable, then stream."""
    clients.command.robot_command(ACTIVATE)
    robot.advance(0.5)
    assert robot.firmware.state is State.TRAJECTORY
    bent = STAND_POSITION.copy()
    bent[ELBOW] = 1.0
    stream = pilot.open(position=bent)
    robot.advance(0.8)
    assert robot.firmware.snapshot.joint_position[ELBOW] == pytest.approx(1.0, abs=0.05)
    assert stream.finish().status == StreamStatus.STATUS_OK


def spoil(change: Callable[[Any], object]) -> Callable[[Any], Any]:
    def spoiled(request: Any) -> Any:
        change(request.joint_command)
        return request

    return spoiled


def with_advice(request: Any) -> Any:
    request.contact_advice.contact_advice.extend([1, 1, 1, 1])
    return request


BAD_UPDATES: dict[str, tuple[Callable[[Any], Any], str, str]] = {
    "nothing in it": (lambda request: UpdateRequest(), "INVALID_REQUEST", "joint_command is missing"),
    "no end_time": (spoil(lambda c: c.ClearField("end_time")), "INVALID_REQUEST", "end_time is missing"),
    "24 positions": (spoil(lambda c: c.position.pop()), "INVALID_REQUEST", "position must hold 25 values"),
    "26 loads": (spoil(lambda c: c.load.append(0.0)), "INVALID_REQUEST", "load must hold 25 values"),
    "no velocities": (spoil(lambda c: c.ClearField("velocity")), "INVALID_REQUEST", "velocity must hold 25"),
    "no gains at first": (spoil(lambda c: c.ClearField("gains")), "INVALID_REQUEST", "no gains"),
    "half of the gains": (spoil(lambda c: c.gains.ClearField("k_qd_p")), "INVALID_REQUEST", "kd must hold 25"),
    "24 gains": (spoil(lambda c: c.gains.k_q_p.pop()), "INVALID_REQUEST", "kp must hold 25 values"),
    "a negative gain": (spoil(lambda c: c.gains.k_q_p.__setitem__(3, -1.0)), "INVALID_REQUEST", "left_knee_joint"),
    "NaN": (spoil(lambda c: c.position.__setitem__(0, float("nan"))), "INVALID_REQUEST", "finite"),
    "infinity": (spoil(lambda c: c.load.__setitem__(0, float("inf"))), "INVALID_REQUEST", "finite"),
    "limit of 0": (spoil(lambda c: c.velocity_safety_limit.SetInParent()), "INVALID_REQUEST", "velocity_limit"),
    "limit below 0": (
        spoil(lambda c: setattr(c.velocity_safety_limit, "value", -1.0)),
        "INVALID_REQUEST",
        "velocity_limit",
    ),
    "extrapolation below 0": (
        spoil(lambda c: c.extrapolation_duration.FromMilliseconds(-5)),
        "INVALID_REQUEST",
        "extrapolation",
    ),
    "advice for four feet": (with_advice, "INVALID_REQUEST", "2 feet"),
    "after its own end": (spoil(lambda c: setattr(c.end_time, "seconds", 1)), "EXPIRED", "after its own end"),
    "years ahead": (spoil(lambda c: setattr(c.end_time, "seconds", 2**40)), "TOO_DISTANT", "too far ahead"),
}


@pytest.mark.parametrize("name", BAD_UPDATES)
def test_a_bad_update_ends_the_stream_with_its_status(robot: SimulatedRobot, pilot: Pilot, name: str) -> None:
    change, status, said = BAD_UPDATES[name]
    stream = OpenStream(pilot.clients)
    stream.send(change(pilot.update()))
    answer = stream.answer()
    assert StreamStatus.Status.Name(answer.status) == f"STATUS_{status}"
    assert said in answer.message
    robot.advance(0.01)
    assert pilot.open().finish().status == StreamStatus.STATUS_OK, "the next stream is welcome"


def test_a_bad_update_leaves_the_run_to_the_one_before(robot: SimulatedRobot, pilot: Pilot) -> None:
    stream = pilot.begin(ahead_s=0.1)
    stream.send(UpdateRequest())
    assert stream.answer().status == StreamStatus.STATUS_INVALID_REQUEST
    robot.advance(0.08)
    assert robot.firmware.joints.running
    robot.advance(0.02)
    assert robot.firmware.state is State.DAMP


def test_updates_of_an_inactive_robot_are_taken_for_two_seconds(robot: SimulatedRobot, pilot: Pilot) -> None:
    stream = pilot.open()
    robot.advance(1.9)
    pilot.send(stream)
    robot.advance(0.1)
    stream.send(pilot.update())
    assert stream.answer().status == StreamStatus.STATUS_INACTIVE


def test_after_the_end_of_a_run_the_next_update_is_answered_inactive(robot: SimulatedRobot, pilot: Pilot) -> None:
    stream = pilot.begin(ahead_s=0.05)
    robot.advance(0.1)
    assert robot.firmware.state is State.DAMP
    stream.send(pilot.update())
    assert stream.answer().status == StreamStatus.STATUS_INACTIVE


def test_a_second_stream_is_invalid_and_the_first_goes_on(pilot: Pilot) -> None:
    stream = pilot.begin()
    newcomer = OpenStream(pilot.clients)
    newcomer.send(pilot.update())
    answer = newcomer.answer()
    assert answer.status == StreamStatus.STATUS_INVALID_REQUEST
    assert "second stream" in answer.message
    assert pilot.robot.edge.tally.dropped[DropReason.JOINT_SECOND_STREAM] == 1
    pilot.send(stream, gains=False)
    assert stream.finish().status == StreamStatus.STATUS_OK


def test_a_client_that_vanishes_leaves_its_last_update_to_run_out(
    robot: SimulatedRobot, lane: JointControlLane, pilot: Pilot
) -> None:
    pilot.begin(ahead_s=0.5)
    pilot.clients.close()
    robot.advance(0.4)
    assert robot.firmware.joints.running
    robot.advance(0.1)
    assert robot.firmware.state is State.DAMP
    others = Clients(lane.port)
    others.synchronize()
    pilot = Pilot(robot, others)

    def accepted() -> bool:
        stream = OpenStream(others)
        stream.send(pilot.update())
        return stream.finish().status == StreamStatus.STATUS_OK

    eventually(accepted, "the robot notices that the stream is gone")
    others.close()


# -- faults and refusals ---------------------------------------------------------------------------


def test_fault_and_recovery(robot: SimulatedRobot, clients: Clients, pilot: Pilot) -> None:
    far = STAND_POSITION.copy()
    far[ELBOW] = 2.0
    stream = pilot.begin(position=far, velocity_safety_limit=1.0)
    robot.advance(0.3)
    answer = stream.answer()
    assert answer.status == StreamStatus.STATUS_INACTIVE
    assert "faster" in answer.message
    assert robot.firmware.state is State.DAMP
    fared = pilot.feedback()
    assert (fared.status, fared.joint_feedback.status) == (4, 2), "ROBOT_FROZEN, ERROR"

    (fault,) = clients.state.get_robot_state().behavior_fault_state.faults
    assert fault.cause == robot_state_pb2.BehaviorFault.CAUSE_COMMAND_FAILURE
    assert fault.status == robot_state_pb2.BehaviorFault.STATUS_CLEARABLE
    with pytest.raises(BehaviorFaultError):
        clients.command.robot_command(ACTIVATE)
    with pytest.raises(NotClearedError):
        clients.command.clear_behavior_fault(fault.behavior_fault_id + 1, lease=lease_pb2.Lease())
    assert clients.command.clear_behavior_fault(fault.behavior_fault_id, lease=lease_pb2.Lease())
    assert not clients.state.get_robot_state().behavior_fault_state.faults
    assert pilot.begin().finish().status == StreamStatus.STATUS_OK


def test_safe_power_off_clears_the_fault_too(robot: SimulatedRobot, clients: Clients, pilot: Pilot) -> None:
    far = STAND_POSITION.copy()
    far[ELBOW] = 2.0
    pilot.begin(position=far, velocity_safety_limit=1.0)
    robot.advance(0.3)
    clients.command.robot_command(POWER_OFF)
    assert pilot.feedback().safe_power_off_feedback.status == 1, "POWERED_OFF"
    clients.command.robot_command(ACTIVATE)


def test_a_latched_alert_is_a_fault_that_cannot_be_cleared_here(robot: SimulatedRobot, clients: Clients) -> None:
    robot.firmware.faults.raise_alert(AlertId.FALL_DETECTED)
    (fault,) = clients.state.get_robot_state().behavior_fault_state.faults
    assert fault.cause == robot_state_pb2.BehaviorFault.CAUSE_FALL
    assert fault.status == robot_state_pb2.BehaviorFault.STATUS_UNCLEARABLE
    with pytest.raises(BehaviorFaultError):
        clients.command.robot_command(ACTIVATE)
    with pytest.raises(BehaviorFaultError):
        clients.command.robot_command(RobotCommandBuilder.synchro_stand_command())
    with pytest.raises(NotClearedError) as refusal:
        clients.command.clear_behavior_fault(fault.behavior_fault_id, lease=lease_pb2.Lease())
    assert refusal.value.response.behavior_fault == fault
    robot.restart()
    clients.command.robot_command(ACTIVATE)


def test_a_pressed_e_stop_is_motors_without_power(robot: SimulatedRobot, clients: Clients, pilot: Pilot) -> None:
    stream = pilot.begin()
    robot.edge.e_stop(True)
    robot.advance(0.005)
    assert stream.answer().status == StreamStatus.STATUS_INACTIVE
    state = clients.state.get_robot_state()
    assert state.estop_states[0].state == robot_state_pb2.EStopState.STATE_ESTOPPED
    with pytest.raises(NotPoweredOnError):
        clients.command.robot_command(ACTIVATE)
    robot.edge.e_stop(False)
    clients.command.robot_command(ACTIVATE)


def test_clients_without_a_clock_cannot_begin_but_can_stop(robot: SimulatedRobot, lane: JointControlLane) -> None:
    clients = Clients(lane.port)
    clients.endpoint._locked_clock_identifier = ""
    request = robot_command_pb2.RobotCommandRequest(command=ACTIVATE)
    answer = clients.command._stub.RobotCommand(request)
    assert answer.status == robot_command_pb2.RobotCommandResponse.STATUS_NO_TIMESYNC
    request.clock_identifier = "made up"
    with pytest.raises(NoTimeSyncError):
        clients.command.robot_command(ACTIVATE, timesync_endpoint=clients.endpoint)
    assert robot.edge.tally.dropped[DropReason.JOINT_NO_TIMESYNC] == 2
    for command in (STOP, FREEZE, POWER_OFF):
        request.command.CopyFrom(command)
        assert clients.command._stub.RobotCommand(request).status == 1, "OK"
    clients.close()


def test_commands_of_other_bodies_are_unsupported(robot: SimulatedRobot, clients: Clients) -> None:
    with pytest.raises(UnsupportedError):
        clients.command.robot_command(RobotCommandBuilder.selfright_command())
    with pytest.raises(UnsupportedError):
        clients.command.robot_command(RobotCommandBuilder.synchro_sit_command())
    with pytest.raises(UnsupportedError):
        clients.command.robot_command(RobotCommandBuilder.arm_stow_command())
    with pytest.raises(InvalidRequestError):
        clients.command.robot_command(robot_command_pb2.RobotCommand())
    with pytest.raises(UnsupportedError):
        clients.command.robot_command(full_body())
    dropped = robot.edge.tally.dropped
    assert (dropped[DropReason.JOINT_UNSUPPORTED], dropped[DropReason.JOINT_INVALID]) == (4, 1)


def test_another_controller_keeps_the_lane_out(robot: SimulatedRobot, clients: Clients, pilot: Pilot) -> None:
    stream = pilot.begin()
    with connect(robot, "operator") as operator:
        operator.stand()
        robot.advance(0.01)
        assert stream.answer().status == StreamStatus.STATUS_INACTIVE
        assert pilot.feedback().status == 2, "COMMAND_OVERRIDDEN"
        with pytest.raises(LeaseUseError):
            clients.command.robot_command(ACTIVATE)
        clients.command.robot_command(POWER_OFF)
        assert robot.firmware.state is State.DAMP, "DAMP is everybody's"


def test_stop_stands_and_freeze_holds(robot: SimulatedRobot, clients: Clients, pilot: Pilot) -> None:
    stream = pilot.begin(ahead_s=5.0)
    clients.command.robot_command(FREEZE)
    assert stream.answer().status == StreamStatus.STATUS_INACTIVE
    robot.advance(3.0)
    assert robot.firmware.joints.frozen
    assert pilot.feedback().WhichOneof("feedback") == "freeze_feedback"
    clients.command.robot_command(STOP)
    assert (robot.firmware.state, robot.firmware.joints.frozen) == (State.STAND, False)
    assert pilot.feedback().WhichOneof("feedback") == "stop_feedback"
    with pytest.raises(InvalidRequestError):
        clients.command.robot_command_feedback(99)


def test_stand_feedback_is_what_the_library_waits_for(robot: SimulatedRobot, clients: Clients) -> None:
    number = clients.command.robot_command(RobotCommandBuilder.synchro_stand_command())

    def standing() -> int:
        feedback = clients.command.robot_command_feedback(number).feedback
        return feedback.synchronized_feedback.mobility_command_feedback.stand_feedback.status

    assert standing() == 2, "IN_PROGRESS"
    robot.advance(2.1)
    assert standing() == 1, "IS_STANDING"


# -- rubbish, crowds, opening ----------------------------------------------------------------------


def test_bytes_that_are_no_messages_do_nothing(robot: SimulatedRobot, clients: Clients, pilot: Pilot) -> None:
    rubbish = b"\xff\xff\xff"
    for service, method in (
        ("RobotCommandService", "RobotCommand"),
        ("RobotCommandService", "RobotCommandFeedback"),
        ("RobotCommandService", "ClearBehaviorFault"),
        ("RobotStateService", "GetRobotState"),
        ("TimeSyncService", "TimeSyncUpdate"),
    ):
        raw = clients.channel.unary_unary(f"/bosdyn.api.{service}/{method}")(rubbish)
        answer = robot_command_pb2.RobotCommandResponse.FromString(raw)  # the header is field 1 of them all
        assert answer.header.error.code == 3, f"{method}: INVALID_REQUEST"
    call = clients.channel.stream_unary("/bosdyn.api.RobotCommandStreamingService/JointControlStream")
    answer = StreamStatus.FromString(call(iter([rubbish])))
    assert answer.status == StreamStatus.STATUS_INVALID_REQUEST
    with pytest.raises(grpc.RpcError, match="RESOURCE_EXHAUSTED"):
        call(iter([b"x" * 100_000]))
    with pytest.raises(grpc.RpcError, match="UNIMPLEMENTED"):
        clients.channel.unary_unary("/bosdyn.api.PowerService/PowerCommand")(b"")
    eventually(lambda: pilot.begin().finish().status == StreamStatus.STATUS_OK, "all goes on")


def test_damaged_updates_never_harm_the_robot(robot: SimulatedRobot, pilot: Pilot) -> None:
    """Valid updates with bytes changed, cut and added: each is taken or ends its stream, the robot runs on."""
    chance = random.Random(0)
    call = pilot.clients.channel.stream_unary("/bosdyn.api.RobotCommandStreamingService/JointControlStream")
    pilot.clients.command.robot_command(ACTIVATE)
    seen = set()
    for _ in range(150):
        good = pilot.update(ahead_s=0.2, extrapolation_duration=5_000, velocity_safety_limit=50.0)
        payload = bytearray(good.SerializeToString())
        for _ in range(chance.randint(1, 6)):
            payload[chance.randrange(len(payload))] = chance.randrange(256)
        if chance.random() < 0.3:
            del payload[chance.randrange(len(payload)) :]
        answer = StreamStatus.FromString(call(iter([bytes(payload)])))
        seen.add(StreamStatus.Status.Name(answer.status))
        robot.advance(0.005)
        if not robot.firmware.joints.running:
            pilot.clients.command.robot_command(POWER_OFF)
            pilot.clients.command.robot_command(ACTIVATE)
    assert {"STATUS_OK", "STATUS_INVALID_REQUEST"} <= seen
    assert np.isfinite(robot.firmware.snapshot.joint_position).all()
    assert robot.physics.divergences == 0


def test_a_client_that_does_not_read_keeps_nobody_waiting(robot: SimulatedRobot, clients: Clients) -> None:
    lazy = clients.states.get_robot_state_stream()
    eventually(lambda: robot.edge.wants_samples, "its stream is open")
    robot.advance(4.0)
    reader = StateReader(clients)
    robot.advance(0.01)

    def fresh() -> bool:
        robot.advance(0.005)
        return bool(reader.messages)

    eventually(fresh, "another one gets states")
    reader.stop()
    lazy.cancel()


def test_only_so_many_take_states_at_a_time(robot: SimulatedRobot, clients: Clients) -> None:
    open_calls = [clients.states.get_robot_state_stream() for _ in range(9)]

    def refused() -> int:
        robot.advance(0.005)
        return sum(call.done() and call.code() is grpc.StatusCode.RESOURCE_EXHAUSTED for call in open_calls)

    eventually(refused, "the ninth is refused")
    assert refused() == 1
    for call in open_calls:
        call.cancel()


def test_a_port_in_use_is_said_in_one_line(robot: SimulatedRobot, lane: JointControlLane) -> None:
    with pytest.raises(TransportError, match=rf"port {lane.port} of 127\.0\.0\.1: in use.*--joint-control"):
        JointControlLane(robot.edge, lane.port).start()
    with pytest.raises(TransportError, match="--joint-control must be from 0 to 65535, got 70000"):
        JointControlLane(robot.edge, 70_000)


def test_without_the_message_package_one_line_says_what_to_install(
    robot: SimulatedRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in [name for name in sys.modules if name.startswith("asimov_gym.edge.transports.joint_control.")]:
        monkeypatch.delitem(sys.modules, name)
    for name in [name for name in sys.modules if name.partition(".")[0] == "bosdyn"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "bosdyn", None)
    with pytest.raises(TransportError, match=r"pip install 'asimov-gym\[joint-control\]'"):
        JointControlLane(robot.edge, 0).start()


def test_a_lane_that_stops_ends_the_run_and_its_streams(robot: SimulatedRobot) -> None:
    lane = JointControlLane(robot.edge, 0)
    lane.start()
    clients = Clients(lane.port)
    clients.synchronize()
    pilot = Pilot(robot, clients)
    pilot.begin(ahead_s=5.0)
    lane.stop()
    lane.stop()
    assert robot.firmware.state is State.DAMP
    assert robot.edge.control.holder is None
    robot.advance(0.01)
    assert robot.physics.timestep == 0.005
    clients.close()
    lane.start()
    lane.stop()


def test_the_robots_own_side_never_loads_the_vendors_package() -> None:
    code = (
        "import sys, asimov_gym.edge, asimov_gym.recording, asimov_gym.edge.joint_control\n"
        "import asimov_gym.edge.transports.joint_control, asimov_gym.cli.robot_service\n"
        "print([name for name in sys.modules if name.partition('.')[0] in ('bosdyn', 'grpc')])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False)
    assert (done.returncode, done.stdout.strip()) == (0, "[]"), done.stderr


# -- real time -------------------------------------------------------------------------------------


class Overloads(EdgeListener):
    """How often the robot said that it cannot keep up."""

    def __init__(self) -> None:
        self.count = 0

    def on_event(self, timestamp_us: int, packet: bytes) -> None:
        self.count += cloud_pb2.EdgeEvent.FromString(packet).error.code == "overload"


@pytest.mark.slow
def test_in_real_time_states_keep_their_rate_and_a_sinusoid_is_tracked() -> None:
    with SimulatedRobot(clock=WallClock()) as robot, JointControlLane(robot.edge, 0) as lane:
        overloads = Overloads()
        robot.edge.attach(overloads)
        clients = Clients(lane.port)
        clients.synchronize()
        clients.command.robot_command(RobotCommandBuilder.synchro_stand_command())
        time.sleep(2.5)
        reader = StateReader(clients)
        stream = OpenStream(clients)
        converter = clients.endpoint.get_robot_time_converter()
        start = time.time()
        for key in range(1, 1000):
            phase = 2.0 * np.pi * 0.5 * (time.time() - start)
            position, velocity = STAND_POSITION.copy(), np.zeros(25)
            position[ELBOW] += 0.3 * np.sin(phase)
            velocity[ELBOW] = 0.3 * np.pi * np.cos(phase)
            end_us = converter.robot_timestamp_from_local_secs(time.time() + 0.5).ToMicroseconds()
            request = update(end_us, key, gains=key == 1, position=position, extrapolation_duration=5_000)
            request.joint_command.velocity[:] = velocity.tolist()
            stream.send(request)
            if key == 3:
                clients.command.robot_command(ACTIVATE)
            time.sleep(max(0.0, start + key / 333.0 - time.time()))
        answer = stream.finish()
        assert answer.status == StreamStatus.STATUS_OK, answer.message
        reader.stop()
        clients.close()
    stamps = np.array([message.joint_states.acquisition_timestamp.ToMicroseconds() for message in reader.messages])
    assert (np.diff(stamps) > 0).all()
    rate = 1e6 * (len(stamps) - 1) / (stamps[-1] - stamps[0])
    # A machine that is busy with other things cannot keep the rate, and then the robot must have said so.
    assert 300.0 < rate < 340.0 or overloads.count
    elbow = np.array([message.joint_states.position[ELBOW] for message in reader.messages])
    assert np.ptp(elbow[len(elbow) // 2 :]) == pytest.approx(0.6, abs=0.12)
    keys = [message.last_command.user_command_key for message in reader.messages]
    assert keys == sorted(keys)
    assert len(set(keys)) > 500, "most updates are the last one when some state is made"


# -- the examples ----------------------------------------------------------------------------------


def test_the_squat_keeps_its_balance_on_flat_feet() -> None:
    """The centre of mass stays over the soles, 18 cm long, all the way down; the ankles stay short of their end."""
    from asimov_gym.examples.joint_squat import JointSquat

    model = robot_model()
    data = mujoco.MjData(model)
    (low, high) = (leg.pose for leg in JointSquat(repeats=1).legs(STAND_POSITION))
    assert high is not low
    for share in np.linspace(0.0, 1.0, 11):
        pose = STAND_POSITION + share * (low - STAND_POSITION)
        assert (pose >= RANGE[:, 0]).all()
        assert (pose <= RANGE[:, 1]).all()
        mujoco.mj_resetDataKeyframe(model, data, model.key("stand").id)
        for name, angle in zip(JOINT_NAMES, pose.tolist(), strict=True):
            data.joint(name).qpos[0] = angle
        mujoco.mj_forward(model, data)
        foot = data.site("left_foot")
        ahead = foot.xmat.reshape(3, 3).T @ (data.body("pelvis_link").subtree_com - foot.xpos)
        assert abs(ahead[0]) < 0.05, f"{share:.0%} of the way down"


@pytest.mark.slow
def test_an_example_runs_and_draws_its_histogram(tmp_path: Path) -> None:
    plot = tmp_path / "loop.png"
    with SimulatedRobot(clock=WallClock()) as robot, JointControlLane(robot.edge, 0) as lane:
        command = [sys.executable, "-m", "asimov_gym.examples.joint_wiggle", "--target", f"127.0.0.1:{lane.port}"]
        command += ["--seconds", "0.4", "--repeats", "1", "--plot", str(plot)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
        assert done.returncode == 0, done.stderr
        assert robot.firmware.state is State.STAND
    assert "round trip" in done.stdout
    assert plot.read_bytes().startswith(b"\x89PNG")
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 2
    assert "Is `asimov robot --joint-control PORT` running?" in done.stderr
