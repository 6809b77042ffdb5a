from __future__ import annotations

from collections.abc import Callable

import pytest

from asimov_gym.firmware import AlertId, Damp, Outcome, Stand, State, Trajectory, Velocity
from asimov_gym.robot.joints import STAND_POSITION


def enter(bench, state: State) -> None:
    if state in (State.STAND, State.POLICY):
        bench.firmware.command(Stand())
    if state is State.POLICY:
        bench.firmware.command(Velocity(0.3, 0.0, 0.0))
    if state is State.TRAJECTORY:
        bench.firmware.command(Trajectory(STAND_POSITION))
    assert bench.run(0.05).state is state


@pytest.mark.parametrize("state", State)
def test_e_stop_damps_from_every_state_and_nothing_leaves_it(held, state: State) -> None:
    enter(held, state)
    held.firmware.e_stop(True)
    assert held.firmware.state is State.DAMP
    snapshot = held.run(0.005)
    assert (snapshot.e_stop, snapshot.state) == (True, State.DAMP)
    for command, outcome in (
        (Stand(), Outcome.TAKEN),
        (Velocity(0.3, 0.0, 0.0), Outcome.E_STOPPED),
        (Trajectory(STAND_POSITION), Outcome.E_STOPPED),
        (Damp(), Outcome.TAKEN),
    ):
        assert held.firmware.command(command).outcome is outcome
        assert held.run(0.05).state is State.DAMP


def test_releasing_leaves_the_robot_in_damp_and_free(held) -> None:
    enter(held, State.STAND)
    held.firmware.e_stop(True)
    held.firmware.command(Stand())
    held.firmware.e_stop(False)
    snapshot = held.run(0.5)
    assert (snapshot.e_stop, snapshot.state, snapshot.error_flags) == (False, State.DAMP, 0)
    held.firmware.command(Stand())
    assert held.run(0.1).state is State.STAND


def test_it_sets_no_error_flag_and_tells_the_change_of_mode(held) -> None:
    enter(held, State.STAND)
    held.firmware.e_stop(True)
    snapshot = held.run(0.1)
    assert [(a.id, a.value, a.threshold) for a in snapshot.alerts] == [(AlertId.MODE_CHANGE, 0, 1)]
    assert (snapshot.error_flags, snapshot.latched) == (0, False)
    assert held.run(2.6).alerts == ()


def test_it_outlives_a_restart_and_a_latched_fault(held) -> None:
    held.firmware.e_stop(True)
    held.firmware.faults.raise_alert(AlertId.MOTOR_COMM_LOSS)
    held.firmware.restart()
    snapshot = held.run(0.1)
    assert (snapshot.e_stop, snapshot.error_flags) == (True, 0)
    held.firmware.command(Stand())
    assert held.run(0.1).state is State.DAMP


def test_a_faulty_robot_stays_latched_when_it_is_released(make_bench: Callable) -> None:
    bench = make_bench("hold")
    bench.firmware.e_stop(True)
    bench.firmware.faults.raise_alert(AlertId.FALL_DETECTED)
    bench.firmware.e_stop(False)
    assert bench.firmware.command(Trajectory(STAND_POSITION)).outcome is Outcome.LATCHED
    assert bench.run(0.1).error_flags == 0x101
