"""What became of a command packet: taken, or dropped for a reason; and what was changed on the way.

The robot answers no command. Each verdict is counted, logged and recorded, which is how a client's author finds out.
"""

from __future__ import annotations

import logging
from collections import Counter
from dataclasses import dataclass
from enum import Enum

from asimov_gym.firmware import Outcome

_log = logging.getLogger(__name__)


class DropReason(Enum):
    """Why a packet has no effect. Documented by the robot's interface unless marked ours."""

    MALFORMED = "the bytes are not a CloudCommand"
    NO_COMMAND = "no member of the oneof `command` is set"
    UNKNOWN_MODE = "ModeCommand with a number that is neither STAND nor DAMP"
    VELOCITY_NOT_FINITE = "a velocity is NaN or infinite"
    VELOCITY_IN_DAMP = "velocity while the robot is in DAMP"
    TRAJECTORY_BY_ID = "a stored trajectory is asked for by name; the robot has none"
    TRAJECTORY_NO_SOURCE = "TrajectoryRequest with neither `full` nor `id`"
    TRAJECTORY_EMPTY = "FullTrajectory without segments"
    TRAJECTORY_LENGTH = "positions of a segment are not exactly 25"
    TRAJECTORY_NOT_FINITE = "a position is NaN or infinite"
    FAULT_LATCHED = "trajectory while a fault is latched (ours)"
    NO_POLICY = "velocity to a robot without a policy (ours)"
    NOT_IN_CONTROL = "another client is in control (ours)"


class Note(Enum):
    """What was changed or ignored in a command that was taken."""

    VELOCITY_CLAMPED = "velocity clamped to the published range"
    COMMAND_CLAMPED = "velocity clamped to the policy's trained range"
    POSITION_CLAMPED = "position clamped to the joint's range"
    GAIN_CLAMPED = "gain clamped to its range"
    GAINS_WRONG_COUNT = "gain array without exactly 25 values: defaults used"
    GAINS_NOT_FINITE = "gain array with a value that is not finite: defaults used"
    EARLIER_SEGMENTS = "several segments: the last one is the target"
    FIELD_IGNORED = "upper_only or duration is set: ignored"
    LATCHED = "STAND has no effect while a fault is latched"


DROPPED_BY_FIRMWARE = {
    Outcome.DAMPED: DropReason.VELOCITY_IN_DAMP,
    Outcome.LATCHED: DropReason.FAULT_LATCHED,
    Outcome.NO_POLICY: DropReason.NO_POLICY,
}


class Dropped(Exception):
    """A command that has no effect, with the reason."""

    def __init__(self, reason: DropReason) -> None:
        super().__init__(reason.value)
        self.reason = reason


@dataclass(frozen=True)
class Verdict:
    """What became of one packet."""

    kind: str
    """`velocity`, `trajectory`, `mode`, or empty when it could not be told."""
    reason: DropReason | None = None
    """Why it was dropped; None when it was taken."""
    notes: tuple[Note, ...] = ()

    @property
    def accepted(self) -> bool:
        return self.reason is None

    def __str__(self) -> str:
        return "accepted" if self.reason is None else self.reason.name


class Tally:
    """Counters of verdicts by kind, drop reason and note."""

    def __init__(self) -> None:
        self.accepted: Counter[str] = Counter()
        self.dropped: Counter[DropReason] = Counter()
        self.notes: Counter[Note] = Counter()

    def add(self, verdict: Verdict, client: str) -> None:
        """Count a verdict. The first one of each kind is logged as a warning, the rest at debug level."""
        if verdict.reason is None:
            self.accepted[verdict.kind] += 1
        else:
            self.dropped[verdict.reason] += 1
            level = logging.WARNING if self.dropped[verdict.reason] == 1 else logging.DEBUG
            _log.log(level, "command of %s dropped: %s (%s)", client, verdict.reason.name, verdict.reason.value)
        for note in verdict.notes:
            self.notes[note] += 1
            level = logging.WARNING if self.notes[note] == 1 else logging.DEBUG
            _log.log(level, "command of %s: %s", client, note.value)
