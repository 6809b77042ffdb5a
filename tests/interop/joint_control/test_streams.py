"""A run of joint commands from the vendor's client: its order, its bad updates, its end."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

pytest.importorskip("bosdyn", reason="bosdyn-client is not installed: pip install 'asimov-gym[joint-control,test]'")

from bosdyn.client.robot_command import RobotCommandBuilder

from asimov_gym.edge import SimulatedRobot
from asimov_gym.edge.transports.joint_control import JointControlLane
from asimov_gym.edge.verdict import DropReason
from asimov_gym.firmware import State
from asimov_gym.robot.joints import STAND_POSITION
from tests.interop.joint_control.joint_client import (
    ACTIVATE,
    ELBOW,
    Clients,
    OpenStream,
    Pilot,
    StateReader,
    StreamStatus,
    UpdateRequest,
    eventually,
)


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
