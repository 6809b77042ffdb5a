"""What a client makes of the robot's reports: one translation, each sample once, in order, with its alerts."""

from __future__ import annotations

import numpy as np
import pytest

from asimov_gym.edge.clients import reports
from asimov_gym.edge.clients.reports import Arrival, ReportReader, telemetry_from_robot_state
from asimov_gym.edge.control import Dialect
from asimov_gym.edge.wire import cloud_pb2, io_pb2
from asimov_gym.robot.joints import MOTOR_NAMES

PITCH, YAW = MOTOR_NAMES.index("Neck_Pitch"), MOTOR_NAMES.index("Neck_Yaw")


def state(sequence: int = 1, timestamp_us: int | None = None, **fields: object) -> io_pb2.RobotState:
    numbers = np.arange(25.0)
    filled: dict[str, object] = {
        "sequence": sequence % 2**32,
        "timestamp_us": 5000 * sequence if timestamp_us is None else timestamp_us,
        "protocol_version": 1,
        "joint_pos": numbers,
        "joint_vel": numbers + 100,
        "joint_current": numbers + 200,
        "joint_temp": numbers + 300,
        "base_quat": [1, 2, 3, 4],
        "base_ang_vel": [5, 6, 7],
        "projected_gravity": [0, 0, -1],
    }
    return io_pb2.RobotState(**(filled | fields))  # type: ignore[arg-type]


def alert(number: int) -> io_pb2.Alert:
    return io_pb2.Alert(id=number, severity=0, value=3, threshold=2, first_set_us=9, source_id=4)


def test_every_field_is_translated_by_name() -> None:
    message = telemetry_from_robot_state(
        state(
            7,
            current_mode=io_pb2.CONTROL_MODE_MOVE,
            error_flags=0x100,
            last_cmd_sequence=12,
            active_alerts=[alert(7), alert(2)],
        ),
        edge_timestamp_us=99,
    )
    assert (message.timestamp_us, message.fw_timestamp_us, message.sequence) == (99, 35_000, 7)
    assert message.fw_mode == cloud_pb2.FW_MODE_MOVE
    assert list(message.imu_quat) == [1, 2, 3, 4]
    assert list(message.imu_gyro) == [5, 6, 7]
    assert list(message.imu_gravity) == [0, 0, -1]
    assert message.error_flags == 0x100 and message.applied_cmd.seq == 12
    assert message.alert_count == 2 and [one.id for one in message.active_alerts] == [7, 2]
    one = message.active_alerts[0]
    assert (one.severity, one.value, one.threshold, one.first_set_us, one.source_id) == (0, 3, 2, 9, 4)
    for values, offset in (
        (message.joint_pos, 0),
        (message.joint_vel, 100),
        (message.joint_current, 200),
        (message.joint_temp, 300),
    ):
        expected = np.arange(25.0) + offset
        # The other dialect has the neck's two motors the other way round: 23 is its yaw.
        expected[[PITCH, YAW]] = 24 + offset, 23 + offset
        assert list(values) == expected.tolist()


def test_fault_damp_is_damp_with_the_latch_bit() -> None:
    message = telemetry_from_robot_state(state(current_mode=io_pb2.CONTROL_MODE_FAULT_DAMP))
    assert (message.fw_mode, message.error_flags) == (cloud_pb2.FW_MODE_DAMP, 1)


@pytest.mark.parametrize(
    ("fields", "complaint"),
    [
        ({"protocol_version": 2}, "protocol_version must be 1, got 2"),
        ({"protocol_version": 0}, "protocol_version must be 1, got 0"),
        ({"joint_pos": [0.0] * 24}, "joint_pos must hold 25 values, got 24"),
        ({"joint_temp": []}, "joint_temp must hold 25 values, got 0"),
        ({"current_mode": 3}, r"current_mode must be one of \[0, 1, 2, 5\], got 3"),
    ],
)
def test_what_is_no_state_of_this_robot_is_refused(fields: dict[str, object], complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        telemetry_from_robot_state(state(**fields))
    assert ReportReader(Dialect.IO).read(state(**fields).SerializeToString()) == (None, Arrival.MALFORMED)


@pytest.mark.parametrize("dialect", list(Dialect))
def test_garbage_is_refused_in_both_dialects(dialect: Dialect) -> None:
    reader = ReportReader(dialect)
    for packet in (b"", b"\xff\xff\xff", b"hello"):
        assert reader.read(packet) == (None, Arrival.MALFORMED)


def test_the_other_dialects_state_is_not_taken_for_telemetry() -> None:
    packet = state(current_mode=io_pb2.CONTROL_MODE_MOVE).SerializeToString()
    assert ReportReader(Dialect.CLOUD).read(packet)[1] is Arrival.MALFORMED


@pytest.mark.parametrize("dialect", list(Dialect))
@pytest.mark.parametrize(
    ("first", "second", "arrival"),
    [
        ((10, 50_000), (11, 55_000), Arrival.NEWER),
        ((10, 50_000), (10, 50_000), Arrival.DUPLICATE),
        ((10, 50_000), (9, 45_000), Arrival.LATE),
        ((2000, 10_000_000), (1000, 9_900_000), Arrival.LATE),
        ((2000, 10_000_000), (999, 9_900_000), Arrival.RESTART),
        ((500, 2_500_000), (1, 5_000), Arrival.RESTART),
        ((2**32 - 1, 50_000), (0, 55_000), Arrival.NEWER),
        ((0, 50_000), (2**32 - 1, 45_000), Arrival.LATE),
        ((10, 50_000_000), (11, 5_000), Arrival.RESTART),
    ],
)
def test_samples_are_taken_once_and_in_order(
    dialect: Dialect, first: tuple[int, int], second: tuple[int, int], arrival: Arrival
) -> None:
    def packet(sequence: int, timestamp_us: int) -> bytes:
        if dialect is Dialect.IO:
            return state(sequence, timestamp_us).SerializeToString()
        return cloud_pb2.EdgeTelemetry(
            sequence=sequence, fw_timestamp_us=timestamp_us, joint_pos=[0.0] * 25
        ).SerializeToString()

    reader = ReportReader(dialect)
    assert reader.read(packet(*first))[1] is Arrival.NEWER
    sample, found = reader.read(packet(*second))
    assert found is arrival
    assert (sample is not None) == (arrival in (Arrival.NEWER, Arrival.RESTART))


def test_alerts_stand_for_the_frames_that_omit_them(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [100.0]
    monkeypatch.setattr(reports.time, "monotonic", lambda: clock[0])
    reader = ReportReader(Dialect.IO)

    def counts(sequence: int, *alerts: int) -> tuple[int, list[int]]:
        sample, _ = reader.read(state(sequence, active_alerts=[alert(one) for one in alerts]).SerializeToString())
        assert sample is not None
        return sample.alert_count, [one.id for one in sample.active_alerts]

    assert counts(1, 7) == (1, [7])
    clock[0] += 0.29
    assert counts(2) == (1, [7])
    clock[0] += 0.02
    assert counts(3) == (0, [])
    assert counts(4, 2, 7) == (2, [2, 7])
    sample, arrival = reader.read(state(1, timestamp_us=5).SerializeToString())
    assert arrival is Arrival.LATE and sample is None
    reader.read(state(5, timestamp_us=10_000_000).SerializeToString())
    restarted, arrival = reader.read(state(1, timestamp_us=5).SerializeToString())
    assert arrival is Arrival.RESTART and restarted is not None and restarted.alert_count == 0
