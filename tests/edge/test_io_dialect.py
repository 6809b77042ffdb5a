"""Dialect io: what its commands do, what it refuses, and what it reports, each against the table of the interface."""

from __future__ import annotations

import math

import numpy as np
import pytest

from asimov_gym.edge import Client, Dialect, DropReason, EdgeListener, Note, SimulatedRobot, Source, Verdict
from asimov_gym.edge.wire import cloud_pb2, io_pb2
from asimov_gym.firmware import AlertId, FirmwareConfig, State
from asimov_gym.robot.joints import RANGE, STAND_POSITION, joint_index

HOLD = [0.0] * 25
PITCH, ROLL = joint_index("left_ankle_pitch_joint"), joint_index("left_ankle_roll_joint")
NECK_PITCH, NECK_YAW = joint_index("neck_pitch_joint"), joint_index("neck_yaw_joint")


class IoWire:
    """A client that sends RobotCommands and sees the verdicts."""

    def __init__(self, robot: SimulatedRobot, source: Source = Source.UDP, name: str = "io") -> None:
        self.robot = robot
        self.client = Client(source, name, (Dialect.IO,))
        self.sequence = 0

    def send(self, streamed: bool = False, **fields: object) -> Verdict:
        self.sequence += 1
        values = {"protocol_version": 1, "sequence": self.sequence} | fields
        return self.robot.edge.receive(io_pb2.RobotCommand(**values).SerializeToString(), self.client, streamed)

    def stand(self) -> Verdict:
        return self.send(mode=io_pb2.CONTROL_MODE_STAND)

    def damp(self) -> Verdict:
        return self.send(mode=io_pb2.CONTROL_MODE_DAMP)

    def velocity(self, vx: float = 0.0, vy: float = 0.0, vyaw: float = 0.0, **fields: object) -> Verdict:
        policy = io_pb2.VelocityCommand(vx=vx, vy=vy, vyaw=vyaw)
        return self.send(mode=io_pb2.CONTROL_MODE_MOVE, policy=policy, **fields)

    def targets(self, positions: list[float], kp: list[float] = (), kd: list[float] = ()) -> Verdict:
        data = io_pb2.AllTrajectory(positions=positions, kp=kp, kd=kd)
        return self.send(mode=io_pb2.CONTROL_MODE_MOVE, command_control=1, all_trajectory=data)

    def armed(self) -> IoWire:
        self.stand()
        self.robot.advance(0.6)
        return self


class States(EdgeListener):
    """Collects RobotState frames."""

    wants_robot_state = True

    def __init__(self) -> None:
        self.frames: list[tuple[io_pb2.RobotState, bool]] = []

    def on_robot_state(self, timestamp_us: int, packet: bytes, report: bool) -> None:
        self.frames.append((io_pb2.RobotState.FromString(packet), report))


@pytest.fixture
def io(robot: SimulatedRobot) -> IoWire:
    return IoWire(robot)


@pytest.fixture
def states(robot: SimulatedRobot) -> States:
    listener = States()
    robot.edge.attach(listener)
    return listener


def dropped(verdict: Verdict, reason: DropReason) -> bool:
    return verdict.reason is reason and verdict.dialect is Dialect.IO


# -- commands --------------------------------------------------------------------------------------


def test_stand_velocity_zero_velocity_and_damp(robot, io) -> None:
    assert io.stand().accepted
    assert robot.firmware.state is State.STAND
    robot.advance(0.51)
    assert io.velocity(0.3).accepted
    assert robot.firmware.state is State.POLICY
    assert io.velocity().accepted  # its sub-message is empty, and still it is a velocity
    assert robot.firmware.state is State.POLICY
    assert io.damp().accepted
    assert robot.firmware.state is State.DAMP


def test_velocity_in_damp_is_dropped(robot, io) -> None:
    assert dropped(io.velocity(0.2), DropReason.VELOCITY_IN_DAMP)
    assert robot.firmware.state is State.DAMP


def test_joint_targets_in_damp_are_dropped(robot, io) -> None:
    assert dropped(io.targets(HOLD), DropReason.TRAJECTORY_IN_DAMP)
    assert robot.firmware.state is State.DAMP


def test_move_waits_for_half_a_second_of_upright_stand(robot, io) -> None:
    io.stand()
    robot.advance(0.495)
    assert dropped(io.velocity(), DropReason.NOT_ARMED)
    assert dropped(io.targets(HOLD), DropReason.NOT_ARMED)
    assert robot.firmware.state is State.STAND
    robot.advance(0.01)
    assert io.velocity().accepted


def test_damp_disarms_and_move_to_stand_stays_armed(robot, io) -> None:
    io.armed().velocity()
    robot.advance(0.1)
    io.stand()
    assert io.velocity().accepted
    io.damp()
    robot.advance(0.1)
    io.stand()
    robot.advance(0.1)
    assert dropped(io.velocity(), DropReason.NOT_ARMED)


def test_velocity_is_clamped_to_the_firmware_caps_of_this_dialect(robot, io) -> None:
    verdict = io.armed().velocity(2.0, -2.0, 5.0)
    assert Note.VELOCITY_CLAMPED in verdict.notes
    robot.advance(0.005)
    assert robot.firmware.snapshot.velocity == pytest.approx([0.4, -0.4, 0.8])


def test_a_velocity_at_the_cap_is_not_called_clamped(robot, io) -> None:
    assert Note.VELOCITY_CLAMPED not in io.armed().velocity(0.4, 0.4, 0.8).notes


def test_velocity_over_udp_ends_after_two_seconds_and_the_robot_stays_in_move(robot, io) -> None:
    io.armed().velocity(0.3)
    robot.advance(1.99)
    assert robot.firmware.snapshot.velocity[0] == pytest.approx(0.3)
    robot.advance(0.02)
    assert robot.firmware.snapshot.velocity[0] == 0.0
    assert robot.firmware.state is State.POLICY


def test_velocity_in_a_room_holds_until_its_client_leaves(robot) -> None:
    io = IoWire(robot, Source.LIVEKIT)
    io.armed().velocity(0.3)
    robot.advance(5.0)
    assert robot.firmware.snapshot.velocity[0] == pytest.approx(0.3)
    robot.edge.leave(io.client)
    robot.advance(0.005)
    assert robot.firmware.snapshot.velocity[0] == 0.0
    assert robot.firmware.state is State.POLICY


def test_joint_targets_fall_back_to_damp_after_two_seconds_not_after_two_hundred_milliseconds(robot, io) -> None:
    assert io.armed().targets(HOLD).accepted
    robot.advance(1.99)
    assert robot.firmware.state is State.TRAJECTORY
    robot.advance(0.02)
    assert robot.firmware.state is State.DAMP


def test_neck_entries_are_yaw_then_pitch(robot, io) -> None:
    wire = HOLD.copy()
    wire[23], wire[24] = 0.3, -0.2
    io.armed().targets(wire)
    position = robot.firmware.trajectory.position
    assert position[NECK_YAW] == pytest.approx(0.3)
    assert position[NECK_PITCH] == pytest.approx(-0.2)


def test_ankle_entries_are_pitch_and_roll_with_their_own_clamp(robot, io) -> None:
    wire = HOLD.copy()
    wire[4], wire[5] = 0.2, 0.05
    assert Note.POSITION_CLAMPED not in io.armed().targets(wire).notes
    assert robot.firmware.trajectory.position[[PITCH, ROLL]] == pytest.approx([0.2, 0.05])
    wire[4], wire[5] = 0.6, -0.3
    assert Note.POSITION_CLAMPED in io.targets(wire).notes
    assert robot.firmware.trajectory.position[[PITCH, ROLL]] == pytest.approx([0.35, -0.1])


def test_ankle_pitch_comes_back_as_the_motors_of_the_published_ratios(robot, io, states) -> None:
    # The legs hang free on the gantry, so a joint target is reached.
    wire = STAND_POSITION.copy()
    wire[[NECK_PITCH, NECK_YAW]] = wire[[NECK_YAW, NECK_PITCH]]
    wire[4], wire[5] = 0.2, 0.05
    robot.firmware.gantry.by_hand("hoist")
    io.armed()
    for _ in range(20):
        io.targets(wire.tolist())
        robot.advance(0.1)
    a, b = states.frames[-1][0].joint_pos[4:6]
    assert (a - b) / 4.04 == pytest.approx(0.2, abs=0.03)
    assert -(a + b) / 1.6 == pytest.approx(0.05, abs=0.03)


def test_gains_come_together_or_not_at_all(robot, io) -> None:
    io.armed()
    io.targets(HOLD, kp=[100.0] * 25, kd=[3.0] * 25)
    assert robot.firmware.trajectory.kp is not None
    verdict = io.targets(HOLD, kp=[100.0] * 25)
    assert Note.GAINS_LONE in verdict.notes
    assert robot.firmware.trajectory.kp is None


@pytest.mark.parametrize("length", [0, 23, 24, 26])
def test_wrong_length_is_dropped(io, length: int) -> None:
    assert dropped(io.armed().targets([0.0] * length), DropReason.TRAJECTORY_LENGTH)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_values_that_are_not_finite_are_dropped(robot, io, bad: float) -> None:
    io.armed()
    assert dropped(io.velocity(bad), DropReason.VELOCITY_NOT_FINITE)
    assert dropped(io.targets([bad, *HOLD[1:]]), DropReason.TRAJECTORY_NOT_FINITE)
    assert robot.firmware.state is State.STAND


@pytest.mark.parametrize("version", [0, 2, 7])
def test_wrong_version_is_dropped_even_where_it_reads_as_damp(robot, io, version: int) -> None:
    io.stand()
    assert dropped(io.send(protocol_version=version), DropReason.WRONG_VERSION)
    assert dropped(io.send(protocol_version=version, mode=1), DropReason.WRONG_VERSION)
    assert robot.firmware.state is State.STAND


def test_empty_datagram_is_no_damp(robot, io) -> None:
    io.stand()
    assert robot.edge.receive(b"", io.client).reason is DropReason.WRONG_VERSION
    assert robot.firmware.state is State.STAND


@pytest.mark.parametrize("mode", [2, 3, 4, 5, 99])
def test_a_mode_without_data_that_is_neither_stand_nor_damp_is_dropped(robot, io, mode: int) -> None:
    assert dropped(io.send(mode=mode), DropReason.UNKNOWN_MODE)
    assert robot.firmware.state is State.DAMP


def test_factory_commands_are_dropped(io) -> None:
    assert dropped(io.send(eol=io_pb2.EolCommand(action=io_pb2.EOL_ZERO_ENCODER)), DropReason.FACTORY_TEST)


def test_epoch_of_another_run_is_dropped_and_of_this_run_is_taken(robot, io) -> None:
    epoch = robot.firmware.snapshot.epoch
    assert epoch > 0
    assert dropped(io.send(mode=1, firmware_epoch_id=epoch + 1), DropReason.WRONG_EPOCH)
    assert io.send(mode=1, firmware_epoch_id=epoch).accepted
    robot.restart()
    assert robot.firmware.snapshot.epoch not in (0, epoch)


def test_oversized_packet_is_refused_unread(robot, io) -> None:
    packet = io_pb2.RobotCommand(protocol_version=1, mode=1, all_trajectory={"positions": [0.0] * 10_000})
    verdict = robot.edge.receive(packet.SerializeToString(), io.client)
    assert verdict.reason is DropReason.TOO_LARGE


# -- two dialects on one lane ----------------------------------------------------------------------


def test_each_packet_is_told_apart_by_its_version(robot) -> None:
    both = Client(Source.LIVEKIT, "both", (Dialect.CLOUD, Dialect.IO))
    cloud = cloud_pb2.CloudCommand(mode=cloud_pb2.ModeCommand(mode=cloud_pb2.MODE_STAND), sequence=1)
    assert robot.edge.receive(cloud.SerializeToString(), both).dialect is Dialect.CLOUD
    assert robot.firmware.state is State.STAND
    io = io_pb2.RobotCommand(protocol_version=1, sequence=2)
    assert robot.edge.receive(io.SerializeToString(), both).dialect is Dialect.IO
    assert robot.firmware.state is State.DAMP


def test_streamed_commands_older_than_one_taken_are_dropped(robot) -> None:
    io = IoWire(robot, Source.LIVEKIT)
    io.armed()
    io.sequence = 39
    assert io.velocity(0.1).accepted  # number 40
    io.sequence = 38
    assert dropped(io.velocity(0.2, streamed=True), DropReason.STALE)
    assert dropped(io.velocity(0.2, streamed=True), DropReason.STALE)  # 40 again
    assert io.velocity(0.3, streamed=True).accepted
    io.sequence = 2  # a reliable packet is in order by itself
    assert io.velocity(0.1).accepted


def test_streamed_order_survives_the_wrap_of_the_counter(robot) -> None:
    io = IoWire(robot, Source.LIVEKIT)
    io.armed()
    io.sequence = 2**32 - 3
    assert io.velocity(0.1).accepted
    io.sequence = 4
    assert io.velocity(0.1, streamed=True).accepted
    io.sequence = 2**32 - 3
    assert dropped(io.velocity(0.1, streamed=True), DropReason.STALE)


# -- reports ---------------------------------------------------------------------------------------


def test_a_state_each_tick_with_the_firmwares_clock_and_counter(robot, states) -> None:
    robot.advance(0.1)
    frames = [frame for frame, _ in states.frames]
    assert [frame.sequence for frame in frames] == list(range(1, 21))
    assert [frame.timestamp_us for frame in frames] == list(range(5000, 105_000, 5000))
    assert {frame.protocol_version for frame in frames} == {1}
    for name in ("joint_pos", "joint_vel", "joint_current", "joint_temp"):
        assert all(len(getattr(frame, name)) == 25 for frame in frames)


def test_no_states_are_made_while_nobody_wants_them(robot) -> None:
    class Silent(EdgeListener):
        made = 0

        def on_robot_state(self, timestamp_us: int, packet: bytes, report: bool) -> None:
            self.made += 1

    silent, hungry = Silent(), States()
    robot.edge.attach(silent)
    robot.advance(0.1)
    assert silent.made == 0
    robot.edge.attach(hungry)
    robot.advance(0.1)
    assert silent.made == 20  # a recorder hears what others asked for


def test_one_frame_in_twenty_carries_the_alerts(robot, states) -> None:
    robot.firmware.inject(AlertId.MOTOR_TEMP_HIGH, source=3)
    robot.advance(0.4)
    reports = [number for number, (_, report) in enumerate(states.frames) if report]
    assert np.diff(reports).tolist() == [20] * (len(reports) - 1)
    assert len(reports) == 4
    for frame, report in states.frames:
        assert bool(frame.active_alerts) == report


def test_latched_fault_reads_as_fault_damp_and_restart_restarts_both_counters(robot, io, states) -> None:
    io.stand()
    robot.advance(0.1)
    robot.firmware.inject(AlertId.FALL_DETECTED)
    robot.advance(0.005)
    frame = states.frames[-1][0]
    assert frame.current_mode == io_pb2.CONTROL_MODE_FAULT_DAMP
    assert frame.error_flags == 0x101
    assert Note.LATCHED in io.stand().notes
    robot.advance(3.0)
    robot.restart()
    robot.advance(0.005)
    frame = states.frames[-1][0]
    assert (frame.current_mode, frame.error_flags) == (io_pb2.CONTROL_MODE_DAMP, 0)
    assert frame.sequence == 1
    assert frame.timestamp_us == 5000


def test_neck_is_reported_yaw_then_pitch(make_robot) -> None:
    robot = make_robot(config=FirmwareConfig())
    states = States()
    robot.edge.attach(states)
    io = IoWire(robot).armed()
    target = HOLD.copy()
    target[23] = 0.4
    for _ in range(10):
        io.targets(target)
        robot.advance(0.1)
    frame = states.frames[-1][0]
    assert frame.joint_pos[23] == pytest.approx(0.4, abs=0.1)
    assert abs(frame.joint_pos[24]) < 0.1


def test_last_command_sequence_is_that_of_this_dialect(robot, io, states, wire) -> None:
    io.sequence = 76
    io.stand()
    wire.send(sequence=5000, mode=cloud_pb2.ModeCommand(mode=cloud_pb2.MODE_DAMP))
    robot.advance(0.005)
    assert states.frames[-1][0].last_cmd_sequence == 77


def test_targets_outside_the_joints_range_are_clamped(robot, io) -> None:
    verdict = io.armed().targets([9.0] * 25)
    assert Note.POSITION_CLAMPED in verdict.notes
    inside = robot.firmware.trajectory.position
    assert (inside <= RANGE[:, 1] + 1e-12).all()
