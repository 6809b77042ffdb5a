"""Motion modes on the robot: which request leads where, what callers are told, and who is in control."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from asimov_gym.edge import Client, Dialect, DropReason, Note, SimulatedRobot, Source, Verdict
from asimov_gym.edge.motion_modes import ActionStatus, CommonState, MotionMode, MotionModesConfig
from asimov_gym.edge.motion_modes_service import CLIENT
from asimov_gym.edge.wire import cloud_pb2, io_pb2
from asimov_gym.firmware import State
from asimov_gym.recording import Recorder, read_recording
from asimov_gym.recording.robot_replay import replay_robot
from asimov_gym.recording.schemas import COMMANDS
from asimov_gym.robot.alerts import AlertId
from asimov_gym.robot.joints import STAND_POSITION
from tests.edge.conftest import StandInPolicy, Wire
from tests.edge.motion_caller import (
    ADD,
    DAMPING,
    JOINT,
    LOCOMOTION,
    PASSIVE,
    STAND,
    Caller,
)


@pytest.fixture
def caller(robot: SimulatedRobot) -> Caller:
    return Caller(robot)


# -- the table -------------------------------------------------------------------------------------

DOCUMENTED = {
    #            passive damping joint stand locomotion
    PASSIVE: "S  S  S  x  x",
    DAMPING: "S  S  x  x  x",
    JOINT: "S  S  S  S  x",
    STAND: "S  S  S  S  S",
    LOCOMOTION: "S  S  x  S  S",
}


@pytest.mark.parametrize("present", MotionMode, ids=lambda mode: mode.name)
def test_every_transition(make_robot: Callable[..., SimulatedRobot], present: MotionMode) -> None:
    robot = make_robot()
    caller = Caller(robot)
    caller.go(present)
    for goal, sign in zip(MotionMode, DOCUMENTED[present].split(), strict=True):
        asked = caller.ask(goal)
        expected = CommonState.SUCCESS if sign == "S" else CommonState.FAILURE
        assert asked.status.value == expected, goal
        assert caller.mode is (goal if sign == "S" else present)
        if sign != "S":
            assert present.value in asked.message and goal.value in asked.message
            assert caller.verdicts[-1].reason is DropReason.MOTION_MODE_UNREACHABLE
        elif goal is not present:  # and back again
            caller.ask(PASSIVE)
            caller.go(present)


def test_a_fresh_robot_is_passive(caller: Caller) -> None:
    assert caller.now == (PASSIVE, ActionStatus.RUNNING)
    caller.robot.advance(0.5)
    assert caller.now == (PASSIVE, ActionStatus.RUNNING)


def test_a_switch_is_answered_at_once_and_seen_later(caller: Caller) -> None:
    assert caller.state(JOINT) is CommonState.SUCCESS
    assert caller.now == (JOINT, ActionStatus.TRANSITION)
    caller.robot.advance(1.9)
    assert caller.now == (JOINT, ActionStatus.TRANSITION)
    caller.robot.advance(0.2)
    assert caller.now == (JOINT, ActionStatus.RUNNING)


def test_repeats_are_harmless_while_it_switches(caller: Caller) -> None:
    """Clients send a request up to eight times."""
    caller.ask(JOINT)
    for _ in range(8):
        caller.robot.advance(0.25)
        assert caller.state(JOINT) is CommonState.SUCCESS
        assert caller.verdicts[-1].notes == (Note.UNCHANGED,)
    caller.robot.advance(0.05)
    assert caller.now == (JOINT, ActionStatus.RUNNING)  # the ramp did not begin anew


def test_only_going_limp_interrupts_a_switch(caller: Caller) -> None:
    caller.ask(JOINT)
    caller.robot.advance(0.5)
    refused = caller.ask(STAND)
    assert refused.status.value == CommonState.FAILURE and "under way" in refused.message
    assert caller.verdicts[-1].reason is DropReason.SWITCHING
    assert caller.state(DAMPING) is CommonState.SUCCESS
    assert caller.now == (DAMPING, ActionStatus.RUNNING)


def test_a_switch_may_lead_from_damping_to_joint(robot: SimulatedRobot) -> None:
    caller = Caller(robot, MotionModesConfig(joint_from_damping=True))
    caller.ask(DAMPING)
    assert caller.state(JOINT) is CommonState.SUCCESS


@pytest.mark.parametrize(
    "name", ["", "joint_default", "RUN_DEFAULT", "VR_REMOTE_CONTROLLER", "JOINT_DEFAULT ", "\0" * 99]
)
def test_other_modes_are_invalid(caller: Caller, name: str) -> None:
    answer = caller.ask(name)
    assert answer.status.value == CommonState.INVALID and "STAND_DEFAULT" in answer.message
    assert caller.verdicts[-1].reason is DropReason.MOTION_MODE_UNKNOWN
    assert caller.mode is PASSIVE


def test_standing_needs_both_feet(make_robot: Callable[..., SimulatedRobot]) -> None:
    robot = make_robot(gantry="hold")
    caller = Caller(robot)
    caller.ask(JOINT)
    robot.advance(3.0)
    answer = caller.ask(STAND)
    assert answer.status.value == CommonState.NOT_READY and "feet" in answer.message
    assert caller.verdicts[-1].reason is DropReason.FEET_UNLOADED
    assert robot.firmware.state is State.STAND


def test_standing_needs_a_policy(make_robot: Callable[..., SimulatedRobot]) -> None:
    caller = Caller(make_robot(policy=None))
    caller.go(JOINT)
    answer = caller.ask(STAND)
    assert answer.status.value == CommonState.NOT_READY and "policy" in answer.message
    assert caller.verdicts[-1].reason is DropReason.NO_POLICY
    assert caller.mode is JOINT


def test_a_fallen_robot_is_not_ready(make_robot: Callable[..., SimulatedRobot]) -> None:
    robot = make_robot(gantry="off")
    caller = Caller(robot)
    caller.ask(PASSIVE)
    robot.advance(3.0)
    answer = caller.ask(JOINT)
    assert answer.status.value == CommonState.NOT_READY and "fallen" in answer.message
    assert caller.verdicts[-1].reason is DropReason.NOT_UPRIGHT
    assert caller.mode is PASSIVE


def test_faults_and_the_emergency_stop_lead_to_damping(caller: Caller) -> None:
    caller.go(JOINT)
    caller.robot.edge.e_stop(True)
    assert caller.mode is DAMPING
    assert caller.state(PASSIVE) is CommonState.SUCCESS  # going limp is always open
    assert "emergency" in caller.ask(JOINT).message
    caller.robot.edge.e_stop(False)
    assert caller.mode is PASSIVE
    assert caller.state(JOINT) is CommonState.SUCCESS
    caller.robot.firmware.inject(AlertId.MOTOR_OVERTEMP)
    assert caller.mode is DAMPING
    caller.ask(PASSIVE)
    answer = caller.ask(JOINT)
    assert answer.status.value == CommonState.NOT_READY and "restart" in answer.message
    caller.robot.restart()
    assert caller.mode is PASSIVE
    assert caller.state(JOINT) is CommonState.SUCCESS


def test_passive_has_no_torque_and_damping_resists(make_robot: Callable[..., SimulatedRobot]) -> None:
    travelled = {}
    for mode in (PASSIVE, DAMPING):
        robot = make_robot()
        caller = Caller(robot)
        caller.ask(mode)
        robot.physics.kick([[0.0] * 6])  # rests; gravity moves the legs
        robot.firmware.gantry.by_hand("off")
        robot.advance(0.3)
        state = robot.firmware.snapshot
        assert abs(state.joint_torque).max() == 0.0 if mode is PASSIVE else abs(state.joint_torque).max() > 0.5
        travelled[mode] = abs(state.joint_position - STAND_POSITION).max()
    assert travelled[PASSIVE] > 1.2 * travelled[DAMPING]


def test_unified_standing_and_walking(caller: Caller) -> None:
    caller.go(STAND)
    caller.velocity(0.3)
    assert caller.mode is LOCOMOTION
    caller.velocity(0.0)
    assert caller.mode is STAND
    assert caller.state(LOCOMOTION) is CommonState.SUCCESS
    caller.robot.advance(0.5)
    assert caller.mode is LOCOMOTION  # asked for, though it walks on the spot
    caller.velocity(0.01)
    assert caller.robot.firmware.velocity[0] == 0.01  # no threshold where walking was asked for
    assert caller.state(STAND) is CommonState.SUCCESS
    assert caller.mode is STAND and not caller.robot.firmware.velocity.any()


# -- beside the robot's own interface --------------------------------------------------------------


def _io(robot: SimulatedRobot, client: Client, **fields: Any) -> Verdict:
    packet = io_pb2.RobotCommand(protocol_version=1, **fields).SerializeToString()
    return robot.edge.receive(packet, client)


def test_handover_and_damp_from_anywhere(caller: Caller) -> None:
    robot = caller.robot
    udp = Client(Source.UDP, "udp 127.0.0.1:50000", (Dialect.IO,))
    caller.go(STAND)
    caller.velocity(0.3)
    assert robot.edge.control.holder == CLIENT

    # The robot's own interface ranks higher and takes the robot over as it walks.
    assert _io(robot, udp, policy=io_pb2.VelocityCommand(vx=-0.2)).accepted
    assert robot.edge.control.holder == udp
    assert caller.velocity(0.3).reason is DropReason.NOT_IN_CONTROL
    assert robot.firmware.velocity[0] == pytest.approx(-0.2)
    answer = caller.ask(STAND)
    assert answer.status.value == CommonState.IN_MANUAL and udp.name in answer.message
    assert caller.mode is LOCOMOTION  # the robot's state is told whoever drives it

    # Motion modes may stop it all the same.
    assert caller.state(DAMPING) is CommonState.SUCCESS
    assert robot.firmware.state is State.DAMP and robot.edge.control.holder == udp

    # Control passes back when the other one leaves.
    robot.edge.leave(udp)
    caller.ask(PASSIVE)
    caller.go(STAND)
    assert robot.edge.control.holder == CLIENT

    # And the robot's own interface may stop it in turn, by whoever.
    assert Wire(robot).mode(cloud_pb2.MODE_DAMP).accepted
    assert robot.edge.control.holder == CLIENT and caller.mode is DAMPING


def test_what_other_interfaces_did_is_told(caller: Caller, wire: Wire) -> None:
    wire.stand()
    assert caller.now == (JOINT, ActionStatus.TRANSITION)
    pose = cloud_pb2.JointSegment(positions=caller.robot.firmware.linkage.motor_position(STAND_POSITION))
    assert wire.segments(pose).accepted
    assert caller.now == (JOINT, ActionStatus.RUNNING)
    assert caller.state(JOINT) is CommonState.FAILURE
    assert caller.state(STAND) is CommonState.FAILURE
    caller.robot.advance(0.25)  # no trajectory in time
    assert caller.mode is DAMPING


def test_leaving_frees_the_robot(caller: Caller) -> None:
    caller.go(STAND)
    caller.velocity(0.3)
    caller.modes.stop()
    assert caller.robot.edge.control.holder is None
    assert not caller.robot.firmware.velocity.any()


# -- recording -------------------------------------------------------------------------------------


def test_a_recording_holds_it_and_repeats_it(tmp_path: Path, robot: SimulatedRobot) -> None:
    file = tmp_path / "modes.mcap"
    with Recorder(file, robot.edge):
        caller = Caller(robot)
        caller.input(ADD, "node", 90, 300)
        caller.ask(STAND)
        caller.go(STAND)
        for _ in range(5):
            caller.velocity(0.3, source="node")
            caller.velocity(math.nan, source="node")
            robot.advance(0.1)
        robot.advance(0.5)
        caller.modes.stop()
        robot.advance(0.2)
    commands: list[Any] = [entry.message for entry in read_recording(file, [COMMANDS])]
    kinds = [(command.kind, command.verdict) for command in commands]
    assert kinds[0] == ("motion_source", "accepted")
    assert kinds[1] == ("motion_mode", "MOTION_MODE_UNREACHABLE")
    assert kinds.count(("motion_velocity", "accepted")) == kinds.count(("motion_velocity", "VELOCITY_NOT_FINITE")) == 5
    again = replay_robot(file, policy=StandInPolicy())
    assert again.identical, again


@pytest.mark.parametrize("payload", [b"", b"[]", b"{}", b'{"service": "/none"}', b'{"topic": []}'])
def test_a_damaged_payload_is_an_error(caller: Caller, payload: bytes) -> None:
    with pytest.raises(ValueError):
        caller.modes.repeat(payload)
