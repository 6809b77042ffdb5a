"""Who may command the robot."""

from __future__ import annotations

import pytest

from asimov_gym.edge import Client, DropReason, Source, connect
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


def test_control_is_free_when_its_holder_leaves_and_the_robot_walks_on(robot) -> None:
    with connect(robot, "b") as second:
        with connect(robot, "a") as first:
            first.stand()
            first.velocity(0.2)
        assert handovers(second)[-1] == ("a", "", "left")
        robot.advance(3.0)
        assert robot.firmware.state is State.POLICY
        assert robot.firmware.snapshot.velocity[0] == pytest.approx(0.2)
        second.stand()
        assert robot.firmware.state is State.STAND


def test_malformed_packets_claim_no_control(robot, wire) -> None:
    wire.raw(b"\xff")
    wire.velocity(float("nan"))
    assert robot.edge.control.holder is None
