"""Velocities over the motion-mode interface: when they count, and whose."""

from __future__ import annotations

import math
from typing import Any

import pytest

from asimov_gym.edge import DropReason, Note, SimulatedRobot
from asimov_gym.edge.motion_modes import CommonState, MotionModesConfig
from asimov_gym.edge.motion_modes_messages import GET_INPUT, GetCurrentInputSourceRequest, McInputSource
from asimov_gym.firmware import State
from tests.edge.motion_caller import (
    ADD,
    DAMPING,
    DELETE,
    DISABLE,
    ENABLE,
    JOINT,
    LOCOMOTION,
    MODIFY,
    STAND,
    Caller,
)


@pytest.fixture
def caller(robot: SimulatedRobot) -> Caller:
    return Caller(robot)


# -- velocity --------------------------------------------------------------------------------------


@pytest.mark.parametrize("too_slow, enough", [((0.08, 0, 0), (0.09, 0, 0)), ((0, -0.59, 0), (0, -0.6, 0))])
def test_the_start_threshold(caller: Caller, too_slow: tuple[float, ...], enough: tuple[float, ...]) -> None:
    caller.go(STAND)
    assert caller.velocity(*too_slow).notes == (Note.BELOW_START,)
    assert caller.mode is STAND and not caller.robot.firmware.velocity.any()
    assert caller.velocity(*enough).accepted
    assert caller.mode is LOCOMOTION
    assert caller.velocity(0.01).notes == ()
    assert caller.robot.firmware.velocity[0] == 0.01


def test_a_turn_alone_starts_it(caller: Caller) -> None:
    caller.go(STAND)
    caller.velocity(0.02, 0.02, -0.03)
    assert caller.robot.firmware.velocity.tolist() == [0.02, 0.02, -0.03]


def test_signs_and_clamp(caller: Caller) -> None:
    caller.go(STAND)
    verdict = caller.velocity(9.0, 9.0, -9.0)
    assert verdict.notes == (Note.VELOCITY_CLAMPED, Note.COMMAND_CLAMPED)
    assert caller.robot.firmware.velocity.tolist() == [0.8, 0.4, -0.8]  # the policy's own range


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_what_is_no_number_is_dropped(caller: Caller, bad: float) -> None:
    caller.go(STAND)
    assert caller.velocity(0.3, bad).reason is DropReason.VELOCITY_NOT_FINITE
    assert caller.mode is STAND


def test_velocities_count_only_where_it_balances(caller: Caller) -> None:
    assert caller.velocity(0.3).reason is DropReason.VELOCITY_IN_DAMP
    caller.go(JOINT)
    assert caller.velocity(0.3).reason is DropReason.VELOCITY_NOT_BALANCING
    assert caller.robot.firmware.state is State.STAND


def test_a_silent_source_stops_the_robot(caller: Caller) -> None:
    caller.go(STAND)
    assert caller.current == ""  # before any velocity
    caller.velocity(0.3)
    caller.robot.advance(0.99)
    assert caller.mode is LOCOMOTION
    caller.robot.advance(0.02)
    assert caller.mode is STAND and caller.robot.firmware.state is State.POLICY
    assert caller.current == "pnc"


# -- input sources ---------------------------------------------------------------------------------


def test_registering_as_the_vendors_kit_does(caller: Caller) -> None:
    """It adds its source and, where that fails, modifies it."""
    assert caller.input(ADD, "node") == 0
    assert caller.input(ADD, "node") != 0
    assert caller.input(MODIFY, "node", 60, 500) == 0
    caller.go(STAND)
    assert caller.velocity(0.3, source="node").accepted
    assert caller.modes.call(GET_INPUT, GetCurrentInputSourceRequest()).input_source == McInputSource("node", 60, 500)
    caller.robot.advance(0.51)
    assert caller.mode is STAND


@pytest.mark.parametrize(
    "action, name, priority, timeout",
    [
        (0, "mine", 40, 1000),
        (ADD, "", 40, 1000),
        (ADD, "a\nb", 40, 1000),
        (ADD, "x" * 65, 40, 1000),
        (ADD, "rc", 40, 1000),
        (ADD, "mine", 19, 1000),
        (ADD, "mine", 101, 1000),
        (ADD, "mine", 40, -1),
        (ADD, "mine", 40, 60_001),
        (MODIFY, "nobody", 40, 1000),
        (MODIFY, "rc", 40, 1000),
        (DELETE, "nobody", 40, 1000),
        (DELETE, "rc", 40, 1000),
        (ENABLE, "nobody", 40, 1000),
    ],
)
def test_refused_input_sources(caller: Caller, action: int, name: str, priority: int, timeout: int) -> None:
    assert caller.input(action, name, priority, timeout) != 0
    assert caller.verdicts[-1].reason is DropReason.INPUT_SOURCE_REFUSED


def test_a_timeout_of_zero_is_the_default(caller: Caller) -> None:
    assert caller.input(ADD, "mine", 100, 0) == 0
    caller.velocity(0.0, source="mine")
    assert caller.modes.call(GET_INPUT, GetCurrentInputSourceRequest()).input_source.timeout == 1000


def test_there_is_an_end_to_sources(caller: Caller) -> None:
    codes = [caller.input(ADD, f"source {n}") for n in range(60)]
    assert codes[:59] == [0] * 59 and codes[59] != 0
    assert caller.input(DELETE, "source 3") == 0
    assert caller.input(ADD, "source 59") == 0


def test_the_higher_priority_wins_until_it_is_silent(caller: Caller) -> None:
    caller.go(STAND)
    assert caller.velocity(0.2, source="pnc").accepted
    assert caller.velocity(0.5, source="rc").accepted  # takes over at once
    assert caller.velocity(0.2, source="pnc").reason is DropReason.INPUT_SOURCE_OUTRANKED
    assert caller.current == "rc" and caller.robot.firmware.velocity[0] == 0.5
    for _ in range(11):  # rc says nothing more, pnc goes on
        caller.robot.advance(0.1)
        caller.velocity(0.2, source="pnc")
    assert caller.current == "pnc" and caller.robot.firmware.velocity[0] == 0.2


def test_of_equals_the_earlier_stays(caller: Caller) -> None:
    caller.input(ADD, "first", 40)
    caller.go(STAND)
    caller.velocity(0.2, source="first")
    assert caller.velocity(0.3, source="pnc").reason is DropReason.INPUT_SOURCE_OUTRANKED
    caller.robot.advance(0.9)
    caller.velocity(0.3, source="pnc")
    caller.robot.advance(0.2)  # now the first one has been silent too long
    assert caller.velocity(0.3, source="pnc").accepted
    assert caller.velocity(0.2, source="first").reason is DropReason.INPUT_SOURCE_OUTRANKED


def test_unknown_and_disabled_sources_are_dropped(caller: Caller) -> None:
    caller.go(STAND)
    assert caller.velocity(0.3, source="").reason is DropReason.INPUT_SOURCE_UNKNOWN
    assert caller.velocity(0.3, source="nobody").reason is DropReason.INPUT_SOURCE_UNKNOWN
    assert caller.velocity(0.3).accepted
    assert caller.input(DISABLE, "pnc") == 0
    assert caller.mode is STAND  # at once: the source that drove it counts no more
    assert caller.velocity(0.3).reason is DropReason.INPUT_SOURCE_DISABLED
    assert caller.input(ENABLE, "pnc") == 0
    assert caller.velocity(0.3).accepted


def test_a_restart_forgets_sources(caller: Caller) -> None:
    caller.input(ADD, "node")
    caller.robot.restart()
    assert caller.input(ADD, "node") == 0


def test_unregistered_sources_of_mode_requests(robot: SimulatedRobot) -> None:
    """Examples older than 1.0.0 leave the source empty."""
    lenient = Caller(robot)
    assert lenient.state(JOINT, source="") is CommonState.SUCCESS
    assert lenient.verdicts[-1].notes == (Note.INPUT_SOURCE_UNKNOWN,)
    strict = Caller(robot, MotionModesConfig(strict_sources=True))
    assert strict.state(DAMPING, source="") is CommonState.INVALID
    assert strict.state(DAMPING, source="rc") is CommonState.SUCCESS


@pytest.mark.parametrize(
    "wrong, words",
    [
        ({"start_velocity": (0.1, -0.1, 0.1)}, "start_velocity"),
        ({"velocity_limit": (1.0, 1.0)}, "velocity_limit"),
        ({"stand_tilt_deg": math.nan}, "stand_tilt_deg"),
        ({"foot_load_share": 0.6}, "between 0 and 0.5"),
    ],
)
def test_wrong_settings(wrong: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        MotionModesConfig(**wrong)
