"""Motion modes: the five modes of the AimDK X2 interface, and which of them leads to which.

Names and numbers are the vendor's (AimDK X2, versions 0.8 to 1.0). The vendor publishes a diagram of a few transitions
and no table; `TRANSITIONS` is this project's reading of it, in favour of the robot: whatever goes limp is always open.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum, IntEnum
from types import MappingProxyType

from asimov_gym.edge.verdict import DropReason


class MotionMode(Enum):
    """A mode by its name on the wire."""

    PASSIVE = "PASSIVE_DEFAULT"
    """No torque at all; also what a freshly booted robot reports."""
    DAMPING = "DAMPING_DEFAULT"
    """No position control, the joints damped; also where faults, time-outs and the emergency stop lead."""
    JOINT = "JOINT_DEFAULT"
    """Stiff in the standing pose, without balance."""
    STAND = "STAND_DEFAULT"
    """Balancing in place."""
    LOCOMOTION = "LOCOMOTION_DEFAULT"
    """Walking."""

    @property
    def number(self) -> int:
        """The mode's integer, which clients are not to use since version 0.8.2 but which is still reported."""
        return _NUMBERS[self]


_NUMBERS = {
    MotionMode.PASSIVE: 1,
    MotionMode.DAMPING: 3,
    MotionMode.JOINT: 100,
    MotionMode.STAND: 200,
    MotionMode.LOCOMOTION: 300,
}
MODES = MappingProxyType({mode.value: mode for mode in MotionMode})
"""Modes by name."""


class ActionStatus(IntEnum):
    """What `McActionStatus` says of the present mode."""

    RUNNING = 100
    TRANSITION = 200


class CommonState(IntEnum):
    """What a service says of a request. The vendor's numbers; the ones that are used here."""

    SUCCESS = 1
    FAILURE = 2
    """A transition that does not exist, or one at a time."""
    INVALID = 5
    """The request makes no sense."""
    IN_MANUAL = 6
    """Another interface is in control of the robot. This use is ours."""
    NOT_READY = 100
    """The robot is not fit for it: fallen, faulty, stopped, without a policy."""


_YES, _NO = True, False
# fmt: off
_ROWS = {
    #                       passive damping joint stand locomotion
    MotionMode.PASSIVE:    (_YES,   _YES,   _YES, _NO,  _NO),
    MotionMode.DAMPING:    (_YES,   _YES,   _NO,  _NO,  _NO),
    MotionMode.JOINT:      (_YES,   _YES,   _YES, _YES, _NO),
    MotionMode.STAND:      (_YES,   _YES,   _YES, _YES, _YES),
    MotionMode.LOCOMOTION: (_YES,   _YES,   _NO,  _YES, _YES),
}
# fmt: on
TRANSITIONS = MappingProxyType(
    {(mode, goal): open_ for mode, row in _ROWS.items() for goal, open_ in zip(MotionMode, row, strict=True)}
)
"""Whether a request leads from the present mode to the goal. From a mode to itself it changes nothing and succeeds."""

LIMP = (MotionMode.PASSIVE, MotionMode.DAMPING)
"""Modes that are granted to everybody at any time."""


@dataclass(frozen=True)
class MotionModesConfig:
    """What the vendor leaves open, or changes between releases."""

    start_velocity: tuple[float, float, float] = (0.09, 0.60, 0.03)
    """|forward|, |lateral| (m/s) and |angular| (rad/s) of which one must be reached to leave standstill."""
    velocity_limit: tuple[float, float, float] = (2.0, 1.0, 2.0)
    """|forward|, |lateral| (m/s) and |angular| (rad/s) that a velocity is clamped to: the robot's published range."""
    strict_sources: bool = False
    """Whether SetMcAction of an unregistered input source is refused; else it is taken with a note."""
    joint_from_damping: bool = False
    """Whether DAMPING leads to JOINT directly, which the vendor's diagram does not show but people do."""
    stand_tilt_deg: float = 30.0
    """To balance, the robot must be closer to upright than this."""
    foot_load_share: float = 0.1
    """To balance, each foot must carry at least this share of the robot's weight."""

    def __post_init__(self) -> None:
        for name in ("start_velocity", "velocity_limit"):
            values = getattr(self, name)
            if len(values) != 3 or not all(math.isfinite(value) and value >= 0.0 for value in values):
                raise ValueError(f"motion modes {name} must be three finite numbers >= 0, got {values!r}")
        for name, high in (("stand_tilt_deg", 60.0), ("foot_load_share", 0.5)):
            value = getattr(self, name)
            if not (math.isfinite(value) and 0.0 <= value <= high):
                raise ValueError(f"motion modes {name} must be between 0 and {high:g}, got {value!r}")


@dataclass(frozen=True)
class Fitness:
    """What the robot must be to take a mode other than the limp ones, as found at the moment of the request."""

    e_stopped: bool
    latched: bool
    fallen: bool
    """The tilt is beyond the firmware's fall angle."""
    leaning: bool
    """The tilt is beyond `MotionModesConfig.stand_tilt_deg`."""
    feet_loaded: bool
    has_policy: bool


class Refused(Exception):
    """A mode that is not taken, with what the caller is told and what the recording says."""

    def __init__(self, state: CommonState, reason: DropReason, message: str) -> None:
        super().__init__(message)
        self.state = state
        self.reason = reason


def check_transition(present: MotionMode, goal: MotionMode, switching: bool, config: MotionModesConfig) -> None:
    """Whether the goal can be asked for now, going by the table alone.

    Args:
        present: mode that is reported.
        goal: another mode.
        switching: whether the robot is still on its way to the present mode.
        config: says whether DAMPING leads to JOINT.

    Raises:
        Refused: it cannot, with `FAILURE`.
    """
    if goal in LIMP:
        return
    if switching:
        message = f"the switch to {present.value} is still under way; only {_names(LIMP)} can interrupt it"
        raise Refused(CommonState.FAILURE, DropReason.SWITCHING, message)
    relaxed = config.joint_from_damping and (present, goal) == (MotionMode.DAMPING, MotionMode.JOINT)
    if not (relaxed or TRANSITIONS[present, goal]):
        ways = [mode for mode in MotionMode if mode is not present and TRANSITIONS[present, mode]]
        message = f"{present.value} does not lead to {goal.value}, only to {_names(ways)}"
        raise Refused(CommonState.FAILURE, DropReason.MOTION_MODE_UNREACHABLE, message)


def check_fitness(goal: MotionMode, fitness: Fitness, present: MotionMode) -> None:
    """Whether the robot is fit for a goal that the table allows.

    Args:
        goal: mode asked for.
        fitness: of the robot now.
        present: mode that is reported.

    Raises:
        Refused: it is not, with `NOT_READY`.
    """
    if goal in LIMP:
        return
    if fitness.e_stopped:
        raise _not_ready(DropReason.E_STOPPED, "the emergency stop is pressed")
    if fitness.latched:
        raise _not_ready(DropReason.FAULT_LATCHED, "a fault is latched; only a restart of the firmware clears it")
    if fitness.fallen:
        raise _not_ready(DropReason.NOT_UPRIGHT, "the robot has fallen")
    if goal is MotionMode.JOINT:
        return
    if not fitness.has_policy:
        raise _not_ready(DropReason.NO_POLICY, "no walking policy is loaded")
    if present is not MotionMode.JOINT:
        return
    if fitness.leaning:
        raise _not_ready(DropReason.NOT_UPRIGHT, "the robot is not upright")
    if not fitness.feet_loaded:
        raise _not_ready(DropReason.FEET_UNLOADED, "both feet must carry the robot before it can balance")


def _not_ready(reason: DropReason, message: str) -> Refused:
    return Refused(CommonState.NOT_READY, reason, message)


def _names(modes: tuple[MotionMode, ...] | list[MotionMode]) -> str:
    return " and ".join(mode.value for mode in modes) if len(modes) < 3 else ", ".join(mode.value for mode in modes)
