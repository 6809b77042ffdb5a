"""Faults and refusals, as the errors that the vendor's client raises for them; stopping, freezing, standing."""

from __future__ import annotations

import pytest

pytest.importorskip("bosdyn", reason="bosdyn-client is not installed: pip install 'asimov-gym[joint-control,test]'")

from bosdyn.client.exceptions import InvalidRequestError, LeaseUseError
from bosdyn.client.robot_command import (
    BehaviorFaultError,
    NotClearedError,
    NoTimeSyncError,
    NotPoweredOnError,
    RobotCommandBuilder,
    UnsupportedError,
)

from asimov_gym.edge import SimulatedRobot, connect
from asimov_gym.edge.transports.joint_control import JointControlLane
from asimov_gym.edge.transports.joint_control.vendor import lease_pb2, robot_command_pb2, robot_state_pb2
from asimov_gym.edge.verdict import DropReason
from asimov_gym.firmware import AlertId, State
from asimov_gym.robot.joints import STAND_POSITION
from tests.interop.joint_control.joint_client import (
    ACTIVATE,
    ELBOW,
    FREEZE,
    POWER_OFF,
    STOP,
    Clients,
    Pilot,
    StreamStatus,
    full_body,
)


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
