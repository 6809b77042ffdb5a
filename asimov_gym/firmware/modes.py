"""The mode machine: which command or event takes the robot from which state to which.

This module is the whole of it, and pure: a table and a function that reads it. `TRANSITIONS` has one row for each state
and one column for each trigger, as in the robot's control interface; the two cells between POLICY and TRAJECTORY are
not in that document and follow "the last command wins". What holds the machine in DAMP whatever comes, a latched fault
or a pressed E-stop, is the second table, `HELD`.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, IntEnum
from types import MappingProxyType


class Mode(IntEnum):
    """What telemetry reports, with the numbers of `FirmwareMode`."""

    DAMP = 0
    STAND = 1
    MOVE = 2


class State(Enum):
    """Where the machine is: the three modes, MOVE split by who drives the joints."""

    DAMP = "DAMP"
    STAND = "STAND"
    POLICY = "MOVE/POLICY"
    TRAJECTORY = "MOVE/TRAJECTORY"

    @property
    def mode(self) -> Mode:
        return _MODES[self]


_MODES = {State.DAMP: Mode.DAMP, State.STAND: Mode.STAND, State.POLICY: Mode.MOVE, State.TRAJECTORY: Mode.MOVE}


class Trigger(Enum):
    """What can move the machine: four commands, then three events."""

    DAMP = "ModeCommand(DAMP)"
    STAND = "ModeCommand(STAND)"
    VELOCITY = "VelocityCommand"
    TRAJECTORY = "TrajectoryRequest"
    SILENCE = "no trajectory in time"
    FAULT = "critical alert"
    E_STOP = "E-stop pressed"


COLUMNS = (
    Trigger.DAMP,
    Trigger.STAND,
    Trigger.VELOCITY,
    Trigger.TRAJECTORY,
    Trigger.SILENCE,
    Trigger.FAULT,
    Trigger.E_STOP,
)
_D, _S, _P, _T, _X = State.DAMP, State.STAND, State.POLICY, State.TRAJECTORY, None
# fmt: off
_ROWS = {
    #                   damp  stand velo. traj. sil.  fault stop       (_X: no effect; a command is dropped)
    State.DAMP:        (_D,   _S,   _X,   _T,   _X,   _D,   _D),
    State.STAND:       (_D,   _S,   _P,   _T,   _X,   _D,   _D),
    State.POLICY:      (_D,   _S,   _P,   _T,   _X,   _D,   _D),
    State.TRAJECTORY:  (_D,   _S,   _P,   _T,   _D,   _D,   _D),
}
# fmt: on
TRANSITIONS = MappingProxyType(
    {(state, trigger): goal for state, row in _ROWS.items() for trigger, goal in zip(COLUMNS, row, strict=True)}
)
"""Next state by (state, trigger); None where the trigger has no effect. Boot is in DAMP. A latched fault or a pressed
E-stop overrides this table: see `HELD`."""


class Outcome(Enum):
    """What became of a command."""

    TAKEN = "taken"
    DAMPED = "dropped: the robot is in DAMP"
    LATCHED = "dropped: a fault is latched"
    NO_POLICY = "dropped: no policy is loaded"
    E_STOPPED = "dropped: the E-stop is pressed"
    JOINT_FAULT = "dropped: the fault of joint control is not cleared"


class Hold(Enum):
    """What can hold the machine in DAMP."""

    FAULT = "a critical alert has latched DAMP, until the firmware restarts"
    E_STOP = "the E-stop is pressed, until it is released; the machine then stays in DAMP"


HELD = MappingProxyType(
    {
        Hold.FAULT: {Trigger.VELOCITY: Outcome.DAMPED, Trigger.TRAJECTORY: Outcome.LATCHED},
        Hold.E_STOP: {Trigger.VELOCITY: Outcome.E_STOPPED, Trigger.TRAJECTORY: Outcome.E_STOPPED},
    }
)
"""Outcomes while the machine is held in DAMP. A mode command is taken all the same, as ever, but STAND changes nothing.
A pressed E-stop answers before a latched fault does."""


@dataclass(frozen=True)
class Transition:
    """Result of a trigger: the next state (may be the present one) and, for a command, what became of it."""

    state: State
    outcome: Outcome


def transition(state: State, trigger: Trigger, latched: bool, e_stop: bool = False) -> Transition:
    """Look a trigger up.

    Args:
        state: present state.
        trigger: command or event.
        latched: whether a critical alert has latched DAMP.
        e_stop: whether the E-stop is pressed.
    """
    hold = Hold.E_STOP if e_stop else Hold.FAULT if latched else None
    if hold is not None:
        return Transition(State.DAMP, HELD[hold].get(trigger, Outcome.TAKEN))
    goal = TRANSITIONS[state, trigger]
    if goal is None:
        return Transition(state, Outcome.DAMPED if trigger is Trigger.VELOCITY else Outcome.TAKEN)
    return Transition(goal, Outcome.TAKEN)
