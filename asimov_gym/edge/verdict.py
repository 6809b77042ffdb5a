"""What became of a command packet: taken, or dropped for a reason; and what was changed on the way.

The robot answers no command. Each verdict is counted, logged and recorded, which is how a client's author finds out.
"""

from __future__ import annotations

import logging
from collections import Counter
from dataclasses import dataclass
from enum import Enum

from asimov_gym.edge.control import Dialect
from asimov_gym.firmware import Outcome

_log = logging.getLogger(__name__)


class DropReason(Enum):
    """Why a packet has no effect. Documented by the robot's interface unless marked ours."""

    MALFORMED = "the bytes are no command message"
    TOO_LARGE = "the packet is larger than any command (ours)"
    NO_COMMAND = "CloudCommand without a member of the oneof `command`"
    UNKNOWN_MODE = "a mode that is neither STAND nor DAMP and comes without data"
    WRONG_VERSION = "RobotCommand with a protocol_version other than 1"
    WRONG_EPOCH = "RobotCommand for another run of the firmware: firmware_epoch_id differs (ours)"
    FACTORY_TEST = "a factory test command; the simulated robot has none (ours)"
    STALE = "streamed command older than one already taken"
    VELOCITY_NOT_FINITE = "a velocity is NaN or infinite"
    VELOCITY_IN_DAMP = "velocity while the robot is in DAMP"
    NOT_ARMED = "STAND has not yet been held upright long enough (dialect io)"
    TRAJECTORY_IN_DAMP = "joint targets while the robot is in DAMP (dialect io)"
    TRAJECTORY_BY_ID = "a stored trajectory is asked for by name; the robot has none"
    TRAJECTORY_NO_SOURCE = "TrajectoryRequest with neither `full` nor `id`"
    TRAJECTORY_EMPTY = "FullTrajectory without segments"
    TRAJECTORY_LENGTH = "positions of a segment are not exactly 25"
    TRAJECTORY_NOT_FINITE = "a position is NaN or infinite"
    FAULT_LATCHED = "trajectory, or a motion mode that stands, while a fault is latched (ours)"
    E_STOPPED = "the emergency stop is pressed (ours)"
    NO_POLICY = "velocity to a robot without a policy (ours)"
    NOT_IN_CONTROL = "another client is in control (ours)"
    JOINT_INVALID = "a message with a value missing or impossible (joint control)"
    JOINT_NO_GAINS = "the first joint command of a run carries no gains (joint control)"
    JOINT_INACTIVE = "joint command while joint control is not active (joint control)"
    JOINT_EXPIRED = "joint command that came after its own end (joint control)"
    JOINT_TOO_DISTANT = "joint command whose end is too far ahead (joint control)"
    JOINT_FAULT = "the fault of joint control is not cleared, or there is none to clear (joint control)"
    JOINT_SECOND_STREAM = "a second stream of joint commands beside an open one (joint control)"
    JOINT_NO_TIMESYNC = "a client that has not synchronised its clock (joint control)"
    JOINT_UNSUPPORTED = "a command that this robot does not have (joint control)"
    MOTION_MODE_UNKNOWN = "a motion mode that is not one of the five (motion modes)"
    MOTION_MODE_UNREACHABLE = "no way leads from the present motion mode to the one asked for (motion modes)"
    SWITCHING = "a switch to another motion mode is under way (motion modes)"
    NOT_UPRIGHT = "the robot has fallen: it is too far from upright to stand (motion modes)"
    FEET_UNLOADED = "a foot does not carry the robot, so it cannot balance (motion modes)"
    VELOCITY_NOT_BALANCING = "velocity while the robot neither balances nor walks (motion modes)"
    INPUT_SOURCE_UNKNOWN = "an input source that is not registered (motion modes)"
    INPUT_SOURCE_DISABLED = "velocity of an input source that is disabled (motion modes)"
    INPUT_SOURCE_OUTRANKED = "velocity of an input source while another one is preferred (motion modes)"
    INPUT_SOURCE_REFUSED = "an input source cannot be added or changed like this (motion modes)"


class Note(Enum):
    """What was changed or ignored in a command that was taken."""

    VELOCITY_CLAMPED = "velocity clamped to the published range"
    COMMAND_CLAMPED = "velocity clamped to the policy's trained range"
    POSITION_CLAMPED = "position clamped to the joint's range"
    GAIN_CLAMPED = "gain clamped to its range"
    GAINS_WRONG_COUNT = "gain array without exactly 25 values: defaults used"
    GAINS_LONE = "only one of kp and kd is given: defaults used for both (dialect io)"
    GAINS_NOT_FINITE = "gain array with a value that is not finite: defaults used"
    EARLIER_SEGMENTS = "several segments: the last one is the target"
    FIELD_IGNORED = "upper_only or duration is set: ignored"
    LATCHED = "STAND has no effect while a fault is latched"
    E_STOPPED = "STAND has no effect while the emergency stop is pressed"
    UNCHANGED = "what was asked for is so already (motion modes)"
    INPUT_SOURCE_UNKNOWN = "the input source is not registered (motion modes)"
    JOINT_WAITING = "joint command before joint control is active: kept until then (joint control)"
    LOAD_CLAMPED = "load clamped to the joint's effort (joint control)"
    BELOW_START = "too slow to leave standstill: zero used (motion modes)"


DROPPED_BY_FIRMWARE = {
    Outcome.DAMPED: DropReason.VELOCITY_IN_DAMP,
    Outcome.LATCHED: DropReason.FAULT_LATCHED,
    Outcome.NO_POLICY: DropReason.NO_POLICY,
    Outcome.E_STOPPED: DropReason.E_STOPPED,
    Outcome.JOINT_FAULT: DropReason.JOINT_FAULT,
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
    """`velocity`, `trajectory`, `mode`, `eol`, or empty when it could not be told; of lanes with messages of their own
    also `motion_mode`, `motion_velocity`, `motion_source`."""
    reason: DropReason | None = None
    """Why it was dropped; None when it was taken."""
    notes: tuple[Note, ...] = ()
    dialect: Dialect | None = None
    """What it was read as; None when it could not be told."""

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

    @property
    def packets(self) -> int:
        """How many packets were judged."""
        return self.accepted.total() + self.dropped.total()

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
