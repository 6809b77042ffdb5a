"""The mode machine against the rows of the robot's control interface, typed here a second time."""

from __future__ import annotations

import pytest

from asimov_gym.firmware import TRANSITIONS, Mode, Outcome, State, Trigger, transition

EVERY_STATE = tuple(State)


@pytest.mark.parametrize("state", EVERY_STATE)
def test_damp_command_always_leads_to_damp(state: State) -> None:
    assert transition(state, Trigger.DAMP, latched=False).state is State.DAMP
    assert transition(state, Trigger.DAMP, latched=False).outcome is Outcome.TAKEN


@pytest.mark.parametrize(
    ("start", "trigger", "goal"),
    [
        (State.DAMP, Trigger.STAND, State.STAND),
        (State.STAND, Trigger.VELOCITY, State.POLICY),
        (State.STAND, Trigger.TRAJECTORY, State.TRAJECTORY),
        (State.DAMP, Trigger.TRAJECTORY, State.TRAJECTORY),
        (State.POLICY, Trigger.STAND, State.STAND),
        (State.TRAJECTORY, Trigger.STAND, State.STAND),
        (State.STAND, Trigger.STAND, State.STAND),
        (State.POLICY, Trigger.VELOCITY, State.POLICY),
        (State.TRAJECTORY, Trigger.TRAJECTORY, State.TRAJECTORY),
        (State.POLICY, Trigger.TRAJECTORY, State.TRAJECTORY),
        (State.TRAJECTORY, Trigger.VELOCITY, State.POLICY),
        (State.TRAJECTORY, Trigger.SILENCE, State.DAMP),
        (State.STAND, Trigger.SILENCE, State.STAND),
        (State.POLICY, Trigger.SILENCE, State.POLICY),
        (State.DAMP, Trigger.SILENCE, State.DAMP),
    ],
)
def test_row_of_the_table(start: State, trigger: Trigger, goal: State) -> None:
    result = transition(start, trigger, latched=False)
    assert result.state is goal
    assert result.outcome is Outcome.TAKEN


def test_velocity_in_damp_is_dropped() -> None:
    result = transition(State.DAMP, Trigger.VELOCITY, latched=False)
    assert (result.state, result.outcome) == (State.DAMP, Outcome.DAMPED)


@pytest.mark.parametrize("state", EVERY_STATE)
def test_fault_leads_to_damp(state: State) -> None:
    assert transition(state, Trigger.FAULT, latched=False).state is State.DAMP


@pytest.mark.parametrize(
    ("trigger", "outcome"),
    [
        (Trigger.DAMP, Outcome.TAKEN),
        (Trigger.STAND, Outcome.TAKEN),
        (Trigger.VELOCITY, Outcome.DAMPED),
        (Trigger.TRAJECTORY, Outcome.LATCHED),
    ],
)
def test_nothing_leaves_a_latched_damp(trigger: Trigger, outcome: Outcome) -> None:
    result = transition(State.DAMP, trigger, latched=True)
    assert (result.state, result.outcome) == (State.DAMP, outcome)


@pytest.mark.parametrize("state", EVERY_STATE)
@pytest.mark.parametrize("latched", [False, True])
@pytest.mark.parametrize(
    ("trigger", "outcome"),
    [
        (Trigger.DAMP, Outcome.TAKEN),
        (Trigger.STAND, Outcome.TAKEN),
        (Trigger.VELOCITY, Outcome.E_STOPPED),
        (Trigger.TRAJECTORY, Outcome.E_STOPPED),
        (Trigger.SILENCE, Outcome.TAKEN),
        (Trigger.FAULT, Outcome.TAKEN),
        (Trigger.E_STOP, Outcome.TAKEN),
    ],
)
def test_a_pressed_e_stop_holds_damp(state: State, latched: bool, trigger: Trigger, outcome: Outcome) -> None:
    result = transition(state, trigger, latched, e_stop=True)
    assert (result.state, result.outcome) == (State.DAMP, outcome)


@pytest.mark.parametrize("state", EVERY_STATE)
def test_e_stop_leads_to_damp(state: State) -> None:
    assert transition(state, Trigger.E_STOP, latched=False).state is State.DAMP


def test_table_is_complete_and_read_only() -> None:
    assert set(TRANSITIONS) == {(state, trigger) for state in State for trigger in Trigger}
    with pytest.raises(TypeError):
        TRANSITIONS[State.DAMP, Trigger.DAMP] = State.STAND  # type: ignore[index]


def test_modes_reported() -> None:
    assert [state.mode for state in (State.DAMP, State.STAND, State.POLICY, State.TRAJECTORY)] == [
        Mode.DAMP,
        Mode.STAND,
        Mode.MOVE,
        Mode.MOVE,
    ]
