"""A recording at a glance."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest

from asimov_gym.edge import SimulatedRobot, connect
from asimov_gym.edge.wire import cloud_pb2
from asimov_gym.recording import Recorder, read_recording
from asimov_gym.recording.summary import summarize
from asimov_gym.robot.alerts import AlertId


def test_modes_commands_and_counts(recording: Path) -> None:
    summary = summarize(recording)
    assert summary.complete and summary.duration == pytest.approx(3.195)
    counted = Counter(entry.topic for entry in read_recording(recording))
    assert summary.counts == counted and (counted["/commands"], counted["/robot_state"]) == (5, 640)
    assert summary.commands["tester", "velocity", "accepted"] == 1
    assert summary.commands["tester", "?", "MALFORMED"] == 1
    # A command takes effect at once and is reported with the next control step; the first message is at 5 ms.
    spans = [(span.state, round(span.start, 3), round(span.stop, 3)) for span in summary.modes]
    assert spans == [
        ("DAMP", 0.0, 0.2),
        ("STAND", 0.2, 0.8),
        ("MOVE/POLICY", 0.8, 2.0),
        ("MOVE/TRAJECTORY", 2.0, 2.15),
        ("DAMP", 2.15, 3.195),
    ]
    assert summary.largest_gap == pytest.approx(0.1) and summary.missing_frames == 0
    assert summary.error_flags == 0 and summary.alerts == ()
    assert all(event.code != "diagnostics" for event in summary.events)
    assert "asimov_gym.edge.rehearsal: the rehearsal is on" in [line.text for line in summary.log]


def test_alerts_from_raised_to_cleared(tmp_path: Path) -> None:
    robot = SimulatedRobot()
    with Recorder(tmp_path / "alerts.mcap", robot.edge), connect(robot, "tester"):
        robot.advance(0.5)
        robot.firmware.faults.raise_alert(AlertId.IMU_FAILURE)
        robot.advance(0.1)
        robot.firmware.faults.raise_alert(AlertId.MOTOR_TEMP_HIGH, source=3)
        robot.firmware.faults.clear()
        robot.advance(3.0)
        robot.firmware.faults.raise_alert(AlertId.MOTOR_TEMP_HIGH, source=4)
        robot.advance(0.1)
    summary = summarize(tmp_path / "alerts.mcap")
    names = [(alert.text.split()[0], "source 4" in alert.text) for alert in summary.alerts]
    assert names == [("IMU_FAILURE", False), ("MOTOR_TEMP_HIGH", False), ("MOTOR_TEMP_HIGH", True)]
    failure, first, second = summary.alerts
    assert failure.start == pytest.approx(0.5) and failure.stop is not None and failure.stop > 2.9
    assert first.stop is not None and second.stop is None
    assert summary.error_flags & 1


def test_missing_frames_and_gaps_are_found(tmp_path: Path) -> None:
    robot = SimulatedRobot()
    with Recorder(tmp_path / "gap.mcap", robot.edge) as recorder:
        robot.advance(0.3)
        robot.edge.detach(recorder)
        robot.advance(0.4)
        robot.edge.attach(recorder)
        robot.advance(0.3)
    summary = summarize(tmp_path / "gap.mcap")
    assert summary.missing_frames == 4
    assert summary.largest_gap == pytest.approx(0.5) and summary.largest_gap_at == pytest.approx(0.295)


def test_a_recording_of_a_standing_robot_that_began_later_says_so(tmp_path: Path) -> None:
    robot = SimulatedRobot()
    connect(robot, "tester").stand()
    robot.advance(0.5)
    with Recorder(tmp_path / "late.mcap", robot.edge):
        robot.advance(0.3)
    assert robot.edge.latest and cloud_pb2.EdgeTelemetry.FromString(robot.edge.latest).fw_mode == 1
    assert [span.state for span in summarize(tmp_path / "late.mcap").modes] == ["STAND"]


def test_the_old_recording(old_recording: Path) -> None:
    summary = summarize(old_recording)
    assert [span.state for span in summary.modes] == ["DAMP", "STAND", "MOVE/POLICY", "MOVE/TRAJECTORY", "DAMP"]
    assert summary.counts["/log"] == 0 and summary.complete
