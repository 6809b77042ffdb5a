from __future__ import annotations

from asimov_gym.edge import Code, EdgeListener
from asimov_gym.edge.telemetry import UINT32
from asimov_gym.edge.wire import cloud_pb2
from asimov_gym.firmware import AlertId, FirmwareState


def errors(session) -> list[tuple[str, str]]:
    return [(e.error.code, e.error.message) for e in session.events() if e.WhichOneof("event") == "error"]


def test_boot_and_mode_changes_are_told(robot, session) -> None:
    robot.advance(0.005)
    session.stand()
    robot.advance(0.005)
    session.velocity(0.1)
    robot.advance(0.005)
    session.damp()
    robot.advance(0.005)
    assert errors(session) == [
        ("boot_progress", "1/4 motors: 25 of 25 answer"),
        ("boot_progress", "2/4 imu: answers"),
        ("boot_progress", "3/4 policy: asimov-80"),
        ("boot_progress", "4/4 ready"),
        ("boot", "boot 1"),
        ("mode_change", "DAMP -> STAND"),
        ("mode_change", "STAND -> MOVE/POLICY"),
        ("mode_change", "MOVE/POLICY -> DAMP"),
    ]


def test_alert_is_told_when_raised_when_cleared_and_when_it_latches(robot, session) -> None:
    session.stand()
    robot.advance(0.005)
    list(session.events())
    robot.firmware.inject(AlertId.FALL_DETECTED, value=610, threshold=600)
    robot.advance(0.005)
    assert errors(session) == [
        ("alert_raised", "FALL_DETECTED critical source 0 value 610 threshold 600"),
        ("fault_latched", "error_flags 0x101"),
        ("mode_change", "STAND -> DAMP"),
    ]
    robot.advance(2.6)
    assert errors(session) == [("alert_cleared", "FALL_DETECTED source 0")]


def test_restart_is_a_boot(robot, session) -> None:
    robot.advance(0.005)
    list(session.events())
    robot.restart()
    robot.advance(0.005)
    told = errors(session)
    assert told[0] == ("console", "restart of the firmware")
    assert [code for code, _ in told[1:5]] == ["boot_progress"] * 4
    assert told[5:] == [("boot", "boot 2")]


def test_events_are_stamped_and_numbered(robot, session) -> None:
    robot.edge._event_sequence = UINT32 - 2
    robot.advance(0.005)
    for _ in range(2):
        session.stand()
        robot.advance(0.005)
        session.damp()
        robot.advance(0.005)
    events = list(session.events())
    assert [event.sequence for event in events][:3] == [UINT32 - 1, 0, 1]
    assert all(event.timestamp_us > 0 for event in events)
    assert all(event.error.subsystem == cloud_pb2.SUBSYSTEM_FIRMWARE for event in events if event.HasField("error"))


def test_diagnostics_every_second_count_bus_and_network(robot, session) -> None:
    session.stand()
    session.velocity(0.1)
    robot.advance(2.0)
    found = [event.diagnostics for event in session.events() if event.HasField("diagnostics")]
    assert len(found) == 2
    last = found[-1]
    assert [bus.frames_sent for bus in last.can_health] == [400 * n for n in (6, 6, 5, 5, 3)]
    assert last.onnx_count == 100
    assert 0.0 < last.onnx_avg_ms <= last.onnx_max_ms
    assert last.controller == "tester"
    assert last.provisioned


def test_codes_are_unique_and_lower_case() -> None:
    values = [code.value for code in Code]
    assert len(set(values)) == len(values)
    assert all(value == value.lower() for value in values)


def test_a_listener_that_fails_stops_neither_the_robot_nor_the_others(robot, session, caplog) -> None:
    class Broken(EdgeListener):
        def on_tick(self, state: FirmwareState) -> None:
            raise RuntimeError("broken")

    robot.edge.attach(Broken())
    robot.advance(0.5)
    assert robot.firmware.ticks == 100
    assert session.state.get().sequence == 6
    assert [record.message for record in caplog.records if record.levelname == "ERROR"] == [
        "Broken failed as a listener; its further failures are not told"
    ]


def test_a_mode_that_no_control_step_saw_is_told_too(robot, session) -> None:
    robot.advance(0.005)
    list(session.events())
    session.stand()
    session.damp()
    robot.advance(0.005)
    assert errors(session) == [("mode_change", "DAMP -> STAND"), ("mode_change", "STAND -> DAMP")]
