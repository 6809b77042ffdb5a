from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from google.protobuf.message import Message

from asimov_gym.edge import EdgeListener, connect
from asimov_gym.edge.telemetry import UINT32, AppliedCommand, MediaTimes, telemetry
from asimov_gym.edge.wire import cloud_pb2
from asimov_gym.firmware import Alert, AlertId, State, StepClock
from asimov_gym.robot.joints import MOTOR_NAMES


def unset_fields(message: Message, path: str = "") -> list[str]:
    """Names of the fields, also of messages inside, that hold their default."""
    set_fields = {field.name: value for field, value in message.ListFields()}
    missing = [path + name for name in message.DESCRIPTOR.fields_by_name if name not in set_fields]
    for name, value in set_fields.items():
        inner = value if isinstance(value, Message) else value[0] if hasattr(value, "add") else None
        if inner is not None:
            missing += unset_fields(inner, f"{path}{name}.")
    return missing


def test_every_field_is_filled(robot) -> None:
    robot.advance(0.5)
    state = replace(
        robot.firmware.snapshot,
        state=State.STAND,
        error_flags=0x101,
        alerts=(Alert(AlertId.MOTOR_TEMP_HIGH, 3, 605, 600, first_set_us=7, last_set_us=8),),
    )
    applied = AppliedCommand(sequence=4, received_us=900, processed_us=50)
    message = telemetry(state, 5, now_us=1_000, age_us=6_000, applied=applied, media=MediaTimes(11, 12))
    assert unset_fields(message) == []
    lengths = {f.name: len(v) for f, v in message.ListFields() if f.name.startswith(("joint_", "imu_"))}
    assert lengths == dict.fromkeys(("joint_pos", "joint_vel", "joint_current", "joint_temp"), 25) | {
        "imu_quat": 4,
        "imu_gyro": 3,
        "imu_gravity": 3,
    }
    assert (message.alert_count, message.fw_age_ms, message.applied_cmd.age_us) == (1, 6, 100)
    assert (message.active_alerts[0].id, message.active_alerts[0].severity) == (17, 1)


def test_values_are_the_robots(robot, session) -> None:
    session.stand()
    robot.advance(2.5)
    sample, snapshot = session.state.get(), robot.firmware.snapshot
    assert sample.fw_mode == cloud_pb2.FW_MODE_STAND
    assert list(sample.joint_pos) == pytest.approx(snapshot.motor_position, abs=1e-6)
    assert list(sample.joint_vel) == pytest.approx(snapshot.motor_velocity, abs=1e-6)
    assert list(sample.joint_current) == pytest.approx(snapshot.motor_current, abs=1e-5)
    assert list(sample.joint_temp) == pytest.approx(snapshot.motor_temperature, abs=1e-4)
    assert list(sample.imu_quat) == pytest.approx(snapshot.imu_quat, abs=1e-6)
    assert np.linalg.norm(sample.imu_quat) == pytest.approx(1.0, abs=1e-5)
    assert sample.imu_gravity[2] == pytest.approx(-1.0, abs=0.02)
    assert max(abs(current) for current in sample.joint_current) > 0.5
    assert sample.joint_pos[MOTOR_NAMES.index("L_Ankle_A")] == pytest.approx(-2.02 * 0.3, abs=0.2)


class Frames(EdgeListener):
    """Collects telemetry."""

    def __init__(self) -> None:
        self.frames: list[cloud_pb2.EdgeTelemetry] = []

    def on_telemetry(self, timestamp_us: int, packet: bytes) -> None:
        self.frames.append(cloud_pb2.EdgeTelemetry.FromString(packet))


def test_ten_frames_a_second(robot) -> None:
    listener = Frames()
    frames = listener.frames
    robot.edge.attach(listener)
    robot.advance(2.0)
    assert len(frames) == 20
    times = [frame.timestamp_us for frame in frames]
    assert {later - earlier for earlier, later in pairwise(times)} == {100_000}
    assert times[0] == StepClock.EPOCH_US + 100_000
    assert [frame.fw_timestamp_us for frame in frames] == [100_000 * (i + 1) for i in range(20)]
    sequences = [frame.sequence for frame in frames]
    assert sequences == list(range(sequences[0], sequences[0] + 20))


def test_state_is_there_before_the_first_step(session) -> None:
    sample = session.state.get()
    assert sample.fw_mode == cloud_pb2.FW_MODE_DAMP
    assert len(sample.joint_pos) == 25


def test_sequence_wraps(robot) -> None:
    robot.edge._telemetry_sequence = UINT32 - 2
    listener = Frames()
    robot.edge.attach(listener)
    robot.advance(0.3)
    assert [frame.sequence for frame in listener.frames] == [UINT32 - 1, 0, 1]


def test_applied_command_is_echoed_with_its_timing(robot, session) -> None:
    robot.advance(0.1)
    assert not session.state.get().HasField("applied_cmd")
    sent = session.stand()
    received = robot.clock.realtime_us()
    robot.advance(0.3)
    applied = session.state.get().applied_cmd
    assert (applied.seq, applied.recv_us, applied.proc_us, applied.age_us) == (sent, received, 5_000, 300_000)


def test_dropped_command_is_not_echoed(robot, session) -> None:
    session.velocity(0.3)
    robot.advance(0.1)
    assert not session.state.get().HasField("applied_cmd")


def test_error_flags_stay_when_the_alert_is_gone_and_restart_clears(robot, session) -> None:
    robot.firmware.inject(AlertId.FALL_DETECTED, value=610, threshold=600)
    robot.advance(0.1)
    assert (session.state.get().error_flags, session.state.get().alert_count) == (0x101, 1)
    robot.advance(2.6)
    assert (session.state.get().error_flags, session.state.get().alert_count) == (0x101, 0)
    robot.restart()
    robot.advance(0.1)
    sample = session.state.get()
    assert sample.error_flags == 0
    assert sample.fw_timestamp_us == 100_000


def test_same_seed_and_commands_give_the_same_telemetry(make_robot) -> None:
    def run(seed: int) -> list[bytes]:
        robot = make_robot(seed=seed)
        frames = []
        with connect(robot, "same") as session:
            session.stand()
            for i in range(25):
                if i == 20:
                    session.velocity(0.4)
                robot.advance(0.1)
                frames.append(session.state.get().SerializeToString(deterministic=True))
        return frames

    first, again, other = run(3), run(3), run(4)
    assert first == again
    assert first != other
