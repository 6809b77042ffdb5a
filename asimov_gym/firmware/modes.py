"""The mode machine: which command or event takes the robot from which state to which.

This module is the whole of it, and pure: a table and a function that reads it. `TRANSITIONS` has one row for each state
and one column for each trigger, as in the robot's control interface; the two cells between POLICY and TRAJECTORY are
not in that document and follow "the last command wins".
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
    """What can move the machine: four commands, then two events."""

    DAMP = "ModeCommand(DAMP)"
    STAND = "ModeCommand(STAND)"
    VELOCITY = "VelocityCommand"
    TRAJECTORY = "TrajectoryRequest"
    SILENCE = "no trajectory for 200 ms"
    FAULT = "critical alert"


COLUMNS = (Trigger.DAMP, Trigger.STAND, Trigger.VELOCITY, Trigger.TRAJECTORY, Trigger.SILENCE, Trigger.FAULT)
_D, _S, _P, _T, _X = State.DAMP, State.STAND, State.POLICY, State.TRAJECTORY, None
# fmt: off
_ROWS = {
    #                   damp  stand velo. traj. sil.  fault      (_X: no effect; a command is dropped)
    State.DAMP:        (_D,   _S,   _X,   _T,   _X,   _D),
    State.STAND:       (_D,   _S,   _P,   _T,   _X,   _D),
    State.POLICY:      (_D,   _S,   _P,   _T,   _X,   _D),
    State.TRAJECTORY:  (_D,   _S,   _P,   _T,   _D,   _D),
}
# fmt: on
TRANSITIONS = MappingProxyType(
    {(state, trigger): goal for state, row in _ROWS.items() for trigger, goal in zip(COLUMNS, row, strict=True)}
)
"""Next state by (state, trigger); None where the trigger has no effect. Boot is in DAMP. While a fault is latched every
trigger leads to DAMP, see `transition`."""


class Outcome(Enum):
    """What became of a command."""

    TAKEN = "taken"
    DAMPED = "dropped: the robot is in DAMP"
    LATCHED = "dropped: a fault is latched"
    NO_POLICY = "dropped: no policy is loaded"


@dataclass(frozen=True)
class Transition:
    """Result of a trigger: the next state (may be the present one) and, for a command, what became of it."""

    state: State
    outcome: Outcome


def transition(state: State, trigger: Trigger, latched: bool) -> Transition:
    """Look a trigger up.

    Args:
        state: present state.
        trigger: command or event.
        latched: whether a critical alert has latched DAMP. Mode commands are then still taken, but STAND changes
            nothing; only a restart of the firmware leaves DAMP.
    """
    if latched:
        dropped = {Trigger.VELOCITY: Outcome.DAMPED, Trigger.TRAJECTORY: Outcome.LATCHED}
        return Transition(State.DAMP, dropped.get(trigger, Outcome.TAKEN))
    goal = TRANSITIONS[state, trigger]
    if goal is None:
        return Transition(state, Outcome.DAMPED if trigger is Trigger.VELOCITY else Outcome.TAKEN)
    return Transition(goal, Outcome.TAKEN)
