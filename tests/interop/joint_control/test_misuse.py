"""Rubbish, clients that do not read, and too many of them: the robot goes on."""

from __future__ import annotations

import random

import numpy as np
import pytest

pytest.importorskip("bosdyn", reason="bosdyn-client is not installed: pip install 'asimov-gym[joint-control,test]'")

import grpc

from asimov_gym.edge import SimulatedRobot
from asimov_gym.edge.transports.joint_control.vendor import robot_command_pb2
from tests.interop.joint_control.joint_client import (
    ACTIVATE,
    POWER_OFF,
    Clients,
    Pilot,
    StateReader,
    StreamStatus,
    eventually,
)


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
