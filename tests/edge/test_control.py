"""Who may command the robot."""

from __future__ import annotations

import pytest

from asimov_gym.edge import Client, DropReason, Note, Source, connect
from asimov_gym.firmware import State


def handovers(session) -> list[tuple[str, str, str]]:
    changes = [event.controller for event in session.events() if event.HasField("controller")]
    return [(change.previous, change.current, change.reason) for change in changes]


def test_lower_source_is_not_in_control(robot) -> None:
    with connect(robot, "console", Source.CONSOLE) as console, connect(robot, "remote", Source.UDP) as remote:
        console.stand()
        remote.velocity(0.3)
        assert robot.edge.tally.dropped == {DropReason.NOT_IN_CONTROL: 1}
        assert robot.firmware.state is State.STAND


def test_everybody_may_damp_and_that_takes_no_control(robot) -> None:
    with connect(robot, "console", Source.CONSOLE) as console, connect(robot, "remote", Source.UDP) as remote:
        console.stand()
        remote.damp()
        assert robot.firmware.state is State.DAMP
        assert robot.edge.control.holder == Client(Source.CONSOLE, "console")


def test_higher_source_takes_control_at_once(robot) -> None:
    with connect(robot, "remote", Source.UDP) as remote, connect(robot, "console", Source.CONSOLE) as console:
        remote.stand()
        console.velocity(0.1)
        assert robot.firmware.state is State.POLICY
        assert handovers(console) == [("", "remote", "first_command"), ("remote", "console", "priority")]


def test_control_passes_on_after_two_seconds_of_silence(robot) -> None:
    with connect(robot, "a") as first, connect(robot, "b") as second:
        first.stand()
        robot.advance(1.995)
        second.velocity(0.1)
        assert robot.firmware.state is State.STAND
        robot.advance(0.005)
        second.velocity(0.1)
        assert robot.firmware.state is State.POLICY
        assert handovers(first)[-1] == ("a", "b", "silence")


def test_control_is_free_when_its_holder_leaves_and_its_velocity_ends(robot) -> None:
    with connect(robot, "b") as second:
        with connect(robot, "a") as first:
            first.stand()
            first.velocity(0.2)
        assert handovers(second)[-1] == ("a", "", "left")
        robot.advance(0.1)
        assert robot.firmware.state is State.POLICY
        assert robot.firmware.snapshot.velocity[0] == 0.0
        second.stand()
        assert robot.firmware.state is State.STAND


def test_malformed_packets_claim_no_control(robot, wire) -> None:
    wire.raw(b"\xff")
    wire.velocity(float("nan"))
    assert robot.edge.control.holder is None


def test_a_client_without_control_that_leaves_stops_nobody(robot) -> None:
    with connect(robot, "a") as first:
        with connect(robot, "b", Source.UDP):
            first.stand()
            first.velocity(0.2)
        robot.advance(0.1)
        assert robot.firmware.snapshot.velocity[0] == pytest.approx(0.2)


def test_e_stop_wins_over_everything_until_it_is_released(robot) -> None:
    with connect(robot, "a", Source.CONSOLE) as session:
        session.stand()
        session.velocity(0.2)
        robot.advance(0.1)
        robot.edge.e_stop(True)
        assert robot.firmware.state is State.DAMP
        session.velocity(0.2)
        session.trajectory([0.0] * 25)
        assert robot.edge.tally.dropped == {DropReason.E_STOPPED: 2}
        session.stand()
        assert robot.edge.tally.notes[Note.E_STOPPED] == 1
        session.damp()
        robot.advance(0.1)
        assert robot.firmware.state is State.DAMP
        assert session.state.get().error_flags == 0
        robot.edge.e_stop(True)  # pressing twice changes nothing
        robot.edge.e_stop(False)
        assert robot.firmware.state is State.DAMP
        session.stand()
        assert robot.firmware.state is State.STAND
        assert handovers(session) == [
            ("", "a", "first_command"),
            ("a", "e-stop", "e_stop"),
            ("e-stop", "", "e_stop_released"),
            ("", "a", "first_command"),
        ]


def test_a_name_that_no_message_can_carry_is_refused(robot) -> None:
    with pytest.raises(ValueError, match="name must be text without lone surrogates"):
        connect(robot, "\ud800")
    robot.advance(1.1)  # diagnostics name who is in control
