"""Every reason for dropping a command, every clamp, and the traps of the encoding."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from asimov_gym.edge import Client, DropReason, Note, SimulatedRobot, Source
from asimov_gym.edge.decode import decode, parse
from asimov_gym.edge.wire import cloud_pb2, io_pb2
from asimov_gym.firmware import AlertId, Linkage, State, Velocity
from asimov_gym.robot.joints import RANGE

NOT_FINITE = [math.nan, math.inf, -math.inf]
HOLD = [0.0] * 25


def segment(positions: list[float] | None = None, **fields: object) -> cloud_pb2.JointSegment:
    return cloud_pb2.JointSegment(positions=HOLD if positions is None else positions, **fields)  # type: ignore[arg-type]


def dropped(robot: SimulatedRobot, reason: DropReason) -> bool:
    return robot.edge.tally.dropped == {reason: 1} and robot.firmware.state is State.DAMP


# -- drop reasons ----------------------------------------------------------------------------------


@pytest.mark.parametrize("packet", [b"\xff\xff\xff", b"\x52\x05\x01", b"velocity"])
def test_garbage_is_dropped(robot, wire, packet: bytes) -> None:
    assert wire.raw(packet).reason is DropReason.MALFORMED
    assert dropped(robot, DropReason.MALFORMED)


def test_packet_without_a_command_is_dropped(robot, wire) -> None:
    assert wire.send(sequence=7, timestamp_us=9).reason is DropReason.NO_COMMAND
    assert dropped(robot, DropReason.NO_COMMAND)


def test_empty_packet_is_dropped(robot, wire) -> None:
    assert wire.raw(b"").reason is DropReason.NO_COMMAND


def test_command_of_the_other_dialect_is_dropped(robot, wire) -> None:
    other = io_pb2.RobotCommand(mode=io_pb2.CONTROL_MODE_STAND, protocol_version=1, sequence=3)
    assert wire.raw(other.SerializeToString()).reason is DropReason.NO_COMMAND
    assert dropped(robot, DropReason.NO_COMMAND)


@pytest.mark.parametrize("number", [2, 3, 99, -1])
def test_unknown_mode_is_dropped(robot, wire, number: int) -> None:
    assert wire.mode(number).reason is DropReason.UNKNOWN_MODE
    assert dropped(robot, DropReason.UNKNOWN_MODE)


def test_empty_mode_command_is_stand_because_its_member_is_present(robot, wire) -> None:
    assert wire.send(mode=cloud_pb2.ModeCommand()).accepted
    assert robot.firmware.state is State.STAND


@pytest.mark.parametrize("bad", NOT_FINITE)
@pytest.mark.parametrize("place", range(3))
def test_velocity_that_is_not_finite_is_dropped(robot, wire, bad: float, place: int) -> None:
    wire.stand()
    values = [0.1, 0.1, 0.1]
    values[place] = bad
    assert wire.velocity(*values).reason is DropReason.VELOCITY_NOT_FINITE
    assert robot.firmware.state is State.STAND


def test_velocity_in_damp_is_dropped(robot, wire) -> None:
    assert wire.velocity(0.1).reason is DropReason.VELOCITY_IN_DAMP
    assert dropped(robot, DropReason.VELOCITY_IN_DAMP)


def test_stored_trajectory_is_dropped(robot, wire) -> None:
    verdict = wire.send(trajectory=cloud_pb2.TrajectoryRequest(id="wave"))
    assert verdict.reason is DropReason.TRAJECTORY_BY_ID
    assert dropped(robot, DropReason.TRAJECTORY_BY_ID)


def test_trajectory_without_a_source_is_dropped(robot, wire) -> None:
    verdict = wire.send(trajectory=cloud_pb2.TrajectoryRequest(upper_only=True))
    assert verdict.reason is DropReason.TRAJECTORY_NO_SOURCE
    assert dropped(robot, DropReason.TRAJECTORY_NO_SOURCE)


def test_trajectory_without_segments_is_dropped(robot, wire) -> None:
    assert wire.segments().reason is DropReason.TRAJECTORY_EMPTY
    assert dropped(robot, DropReason.TRAJECTORY_EMPTY)


@pytest.mark.parametrize("count", [0, 23, 24, 26])
def test_trajectory_of_another_length_is_dropped(robot, wire, count: int) -> None:
    assert wire.segments(segment([0.1] * count)).reason is DropReason.TRAJECTORY_LENGTH
    assert dropped(robot, DropReason.TRAJECTORY_LENGTH)


@pytest.mark.parametrize("bad", NOT_FINITE)
@pytest.mark.parametrize("place", [0, 4, 24])
def test_trajectory_that_is_not_finite_is_dropped(robot, wire, bad: float, place: int) -> None:
    positions = list(HOLD)
    positions[place] = bad
    assert wire.segments(segment(positions)).reason is DropReason.TRAJECTORY_NOT_FINITE
    assert dropped(robot, DropReason.TRAJECTORY_NOT_FINITE)


def test_one_bad_segment_drops_the_request(robot, wire) -> None:
    assert wire.segments(segment([0.0] * 24), segment()).reason is DropReason.TRAJECTORY_LENGTH


def test_latched_robot_drops_trajectories_and_takes_modes_without_effect(robot, wire) -> None:
    robot.firmware.inject(AlertId.MOTOR_COMM_LOSS)
    assert wire.segments(segment()).reason is DropReason.FAULT_LATCHED
    assert wire.velocity(0.1).reason is DropReason.VELOCITY_IN_DAMP
    assert wire.mode(cloud_pb2.MODE_DAMP).accepted
    verdict = wire.stand()
    assert (verdict.accepted, verdict.notes) == (True, (Note.LATCHED,))
    assert robot.firmware.state is State.DAMP


def test_velocity_without_a_policy_is_dropped(make_robot) -> None:
    robot = make_robot(policy=None)
    client = Client(Source.IN_PROCESS, "a")
    stand = cloud_pb2.CloudCommand(mode=cloud_pb2.ModeCommand(mode=cloud_pb2.MODE_STAND))
    walk = cloud_pb2.CloudCommand(velocity=cloud_pb2.VelocityCommand(vx=0.1))
    robot.edge.receive(stand.SerializeToString(), client)
    assert robot.edge.receive(walk.SerializeToString(), client).reason is DropReason.NO_POLICY
    assert robot.firmware.state is State.STAND


def test_every_drop_reason_is_tested() -> None:
    files = (
        "test_validation.py",
        "test_io_dialect.py",
        "test_control.py",
        "test_motion_modes.py",
        "test_motion_modes_input.py",
        "test_joint_control.py",
        "../interop/joint_control/test_refusals.py",
        "../interop/joint_control/test_streams.py",
    )
    text = "".join((Path(__file__).parent / name).read_text() for name in files)
    assert [reason.name for reason in DropReason if f"DropReason.{reason.name}" not in text] == []


# -- clamps and defaults ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("sent", "applied"), [((0.5, -0.1, 0.2), (0.5, -0.1, 0.2)), ((9.0, 9.0, -9.0), (2.0, 1.0, -2.0))]
)
def test_velocity_is_clamped_to_the_published_range(sent: tuple[float, ...], applied: tuple[float, ...]) -> None:
    message = cloud_pb2.CloudCommand(velocity=cloud_pb2.VelocityCommand(vx=sent[0], vy=sent[1], vyaw=sent[2]))
    client = Client(Source.IN_PROCESS, "a")
    decoded = decode(parse(message.SerializeToString()), Linkage(), client, epoch=1)
    assert isinstance(decoded.command, Velocity)
    assert decoded.command.vector == pytest.approx(applied)
    assert (Note.VELOCITY_CLAMPED in decoded.notes) is (sent != applied)


def test_policy_range_is_a_second_clamp(robot, wire) -> None:
    wire.stand()
    assert wire.velocity(1.5).notes == (Note.COMMAND_CLAMPED,)
    assert wire.velocity(5.0).notes == (Note.VELOCITY_CLAMPED, Note.COMMAND_CLAMPED)
    assert robot.firmware.snapshot.velocity == pytest.approx([0.0, 0.0, 0.0])
    robot.advance(0.005)
    assert robot.firmware.snapshot.velocity == pytest.approx([0.8, 0.0, 0.0])


def test_zero_velocity_is_a_command(robot, wire) -> None:
    wire.stand()
    assert wire.velocity(0.0).accepted
    assert robot.firmware.state is State.POLICY


def test_positions_are_clamped_to_the_joint_range(robot, wire) -> None:
    positions = list(HOLD)
    positions[3] = 9.0
    verdict = wire.segments(segment(positions))
    assert verdict.notes == (Note.POSITION_CLAMPED,)
    assert robot.firmware.trajectory.position[3] == RANGE[3, 1]


def test_ankle_entries_are_motor_values(robot, wire) -> None:
    positions = list(HOLD)
    positions[4], positions[5] = 2.02 * 0.2 - 0.8 * 0.1, -2.02 * 0.2 - 0.8 * 0.1
    assert wire.segments(segment(positions)).notes == ()
    assert robot.firmware.trajectory.position[4:6] == pytest.approx([0.2, 0.1], abs=1e-6)


def test_telemetry_sent_straight_back_holds_the_pose(robot, session) -> None:
    session.stand()
    robot.advance(2.5)
    sample = session.state.get()
    before = robot.firmware.snapshot.joint_position
    for _ in range(50):
        session.trajectory(list(sample.joint_pos))
        robot.advance(0.02)
    assert robot.firmware.state is State.TRAJECTORY
    assert robot.firmware.snapshot.joint_position == pytest.approx(before, abs=0.03)


@pytest.mark.parametrize("count", [1, 23, 24, 26])
def test_gains_of_another_count_become_defaults(robot, wire, count: int) -> None:
    verdict = wire.segments(segment(kp=[100.0] * count, kd=[2.0] * 25))
    assert verdict.notes == (Note.GAINS_WRONG_COUNT,)
    assert robot.firmware.trajectory.kp is None
    assert robot.firmware.trajectory.kd is not None


@pytest.mark.parametrize("bad", NOT_FINITE)
def test_gains_that_are_not_finite_become_defaults(robot, wire, bad: float) -> None:
    verdict = wire.segments(segment(kp=[100.0] * 25, kd=[2.0] * 24 + [bad]))
    assert verdict.notes == (Note.GAINS_NOT_FINITE,)
    assert robot.firmware.trajectory.kd is None
    assert robot.firmware.trajectory.kp is not None


def test_gains_are_clamped_and_enter_the_ankles_through_the_linkage(robot, wire) -> None:
    verdict = wire.segments(segment(kp=[-5.0] + [600.0] * 24, kd=[1.0] * 24 + [7.0]))
    kp, kd = robot.firmware.trajectory.kp, robot.firmware.trajectory.kd
    assert verdict.notes == (Note.GAIN_CLAMPED,)
    assert (kp[0], kp[1], kd[24]) == (0.0, 500.0, 5.0)
    assert kp[4:6] == pytest.approx([2 * 2.02**2 * 500.0, 2 * 0.8**2 * 500.0])
    assert kd[10:12] == pytest.approx([2 * 2.02**2, 2 * 0.8**2])


def test_omitted_gains_are_the_defaults_of_the_joints(robot, wire) -> None:
    assert wire.segments(segment(kp=[], kd=[])).notes == ()
    assert (robot.firmware.trajectory.kp, robot.firmware.trajectory.kd) == (None, None)


def test_last_of_several_segments_is_the_target(robot, wire) -> None:
    verdict = wire.segments(segment(), segment([0.1] * 25, duration=0.5), upper_only=True)
    assert set(verdict.notes) == {Note.EARLIER_SEGMENTS, Note.FIELD_IGNORED, Note.POSITION_CLAMPED}
    assert robot.firmware.trajectory.position[0] == pytest.approx(0.1)


def test_every_note_is_counted(robot, wire) -> None:
    wire.segments(segment(kp=[900.0] * 25))
    wire.segments(segment(kp=[900.0] * 25))
    assert robot.edge.tally.notes[Note.GAIN_CLAMPED] == 2
    assert robot.edge.tally.accepted["trajectory"] == 2


def test_nothing_on_the_wire_answers_a_dropped_command(robot, wire, session) -> None:
    robot.advance(0.1)
    list(session.events())
    wire.raw(b"\xff")
    wire.velocity(math.nan)
    robot.advance(0.2)
    assert list(session.events()) == []


def test_dropped_command_does_not_keep_a_trajectory_alive(robot, wire) -> None:
    wire.segments(segment())
    robot.advance(0.1)
    wire.segments(segment([math.nan] * 25))
    robot.advance(0.1)
    assert robot.firmware.state is State.DAMP


def test_random_bytes_never_raise(robot, wire) -> None:
    random = np.random.default_rng(0)
    for _ in range(500):
        wire.raw(random.bytes(int(random.integers(0, 40))))
    robot.advance(0.1)
    assert sum(robot.edge.tally.dropped.values()) + sum(robot.edge.tally.accepted.values()) == 500
