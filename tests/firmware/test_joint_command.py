"""A joint command at an instant, against cases worked out by hand."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from asimov_gym.firmware.joint_command import (
    ASIMOV_LIMITS,
    Advice,
    JointCommand,
    JointGains,
    JointLimits,
    contact_made,
    desired_target,
    extrapolated_position,
)
from asimov_gym.robot.joints import EFFORT, RANGE, joint_index

ZERO = np.zeros(25)
GAINS = JointGains(np.full(25, 100.0), np.full(25, 2.0))
ELBOW = joint_index("left_elbow_joint")
"""Range 0 to 2.443461 rad, effort 12 N·m."""


def one(joint: int, value: float) -> np.ndarray:
    vector = np.zeros(25)
    vector[joint] = value
    return vector


def command(**fields: Any) -> JointCommand:
    """The elbow at 1.0 rad, moving at 0.5 rad/s, from 0 to 50 ms."""
    given = {"position": one(ELBOW, 1.0), "velocity": one(ELBOW, 0.5), "load": ZERO, "end_us": 50_000}
    return JointCommand(**(given | fields))


# -- extrapolation ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("fields", "now_us", "expected"),
    [
        # Without a duration nothing is extrapolated, whatever the velocity.
        ({}, 20_000, 1.0),
        # 0.5 rad/s for the 10 ms since it came in at 10 ms.
        ({"extrapolation_us": 30_000}, 20_000, 1.005),
        # For 30 ms at most.
        ({"extrapolation_us": 30_000}, 49_000, 1.015),
        # The end at 50 ms is sooner than 10 + 60 ms.
        ({"extrapolation_us": 60_000}, 70_000, 1.020),
        # From a reference time before it came in: 20 - 4 = 16 ms.
        ({"extrapolation_us": 30_000, "reference_us": 4_000}, 20_000, 1.008),
        # From one in the future: nothing until then, then 5 ms.
        ({"extrapolation_us": 30_000, "reference_us": 30_000}, 20_000, 1.0),
        ({"extrapolation_us": 30_000, "reference_us": 30_000}, 35_000, 1.0025),
        # A reference beyond the end leaves no time at all, and never runs backwards.
        ({"extrapolation_us": 30_000, "reference_us": 80_000}, 90_000, 1.0),
        ({"extrapolation_us": 0}, 20_000, 1.0),
    ],
)
def test_position_moves_on_from_the_reference_time(fields: dict[str, Any], now_us: int, expected: float) -> None:
    position = extrapolated_position(command(**fields), received_us=10_000, now_us=now_us)
    assert position[ELBOW] == pytest.approx(expected, abs=1e-12)
    assert np.count_nonzero(position) == 1


# -- the law and its limits ------------------------------------------------------------------------


def law(target: Any, position: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    return target.kp * (target.position - position) + target.kd * (target.velocity - velocity) + target.load


def test_the_law_is_position_derivative_and_feed_forward() -> None:
    target = desired_target(command(load=one(ELBOW, 3.0)), GAINS, 0, 10_000, ZERO)
    # 100 (1.0 - 0.9) + 2 (0.5 - 0.2) + 3 = 10 + 0.6 + 3
    assert law(target, one(ELBOW, 0.9), one(ELBOW, 0.2))[0, ELBOW] == pytest.approx(13.6)


def test_pure_torque_is_gains_of_zero() -> None:
    pure = command(position=ZERO, velocity=ZERO, load=one(ELBOW, -4.0))
    target = desired_target(pure, JointGains(ZERO, ZERO), 0, 10_000, ZERO)
    assert law(target, np.full(25, 0.3), np.full(25, 1.0))[0] == pytest.approx(one(ELBOW, -4.0))


def test_wanted_position_is_held_within_the_range_after_extrapolation() -> None:
    near = command(position=one(ELBOW, 2.44), velocity=one(ELBOW, 1.0), extrapolation_us=50_000)
    target = desired_target(near, GAINS, 0, 40_000, ZERO)  # 2.48 beyond 2.443461
    assert target.position[0, ELBOW] == RANGE[ELBOW, 1]
    assert desired_target(command(position=one(ELBOW, -9.0)), GAINS, 0, 0, ZERO).position[0, ELBOW] == RANGE[ELBOW, 0]


def test_wanted_load_is_held_within_the_joints_effort() -> None:
    target = desired_target(command(load=np.full(25, 1e4)), GAINS, 0, 0, ZERO)
    assert target.load[0] == pytest.approx(EFFORT)
    assert desired_target(command(load=np.full(25, -1e4)), GAINS, 0, 0, ZERO).load[0] == pytest.approx(-EFFORT)


def test_load_limits_may_depend_on_the_measured_pose() -> None:
    weak_when_bent = JointLimits(ASIMOV_LIMITS.low, ASIMOV_LIMITS.high, lambda pose: EFFORT * (1.0 - 0.25 * pose))
    heavy = command(load=one(ELBOW, 100.0))
    straight, bent = (desired_target(heavy, GAINS, 0, 0, one(ELBOW, angle), weak_when_bent) for angle in (0.0, 2.0))
    assert (straight.load[0, ELBOW], bent.load[0, ELBOW]) == pytest.approx((12.0, 6.0))


def test_gains_are_clamped_whole() -> None:
    clamped = JointGains(np.full(25, 936.0), np.full(25, 5.2)).within(500.0, 5.0)
    assert (clamped.kp == 500.0).all()
    assert (clamped.kd == 5.0).all()
    assert GAINS.within(500.0, 5.0) is GAINS


# -- refused on construction -----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"position": np.zeros(24)}, "position must hold 25 values, one for each joint, got 24"),
        ({"load": np.zeros(0)}, "load must hold 25 values"),
        ({"velocity": one(ELBOW, np.nan)}, "velocity of left_elbow_joint must be a finite number"),
        ({"load": one(ELBOW, np.inf)}, "load of left_elbow_joint must be a finite number"),
        ({"extrapolation_us": -1}, "extrapolation_us must be 0 or more, got -1"),
        ({"velocity_limit": 0.0}, "velocity_limit must be a finite number above 0 rad/s, got 0"),
        ({"velocity_limit": float("nan")}, "velocity_limit"),
        ({"key": 2**32}, "key must be from 0 to 4294967295"),
        ({"advice": (Advice.NONE,)}, "advice must be given for 2 feet or none, got 1"),
    ],
)
def test_a_wrong_field_is_named(fields: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        command(**fields)


def test_gains_come_whole_and_not_negative() -> None:
    with pytest.raises(ValueError, match=r"gains\.kd must hold 25 values, one for each joint, got 3"):
        JointGains(np.zeros(25), np.zeros(3))
    with pytest.raises(ValueError, match=r"gains\.kp of left_elbow_joint must be 0 or more, got -1"):
        replace(GAINS, kp=one(ELBOW, -1.0))


# -- contact advice --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("made", "touching", "advice", "expected"),
    [
        (True, True, Advice.NONE, True),
        (True, False, Advice.NONE, False),
        (True, False, Advice.IN_CONTACT, True),
        (True, True, Advice.NOT_IN_CONTACT, False),
        (False, True, Advice.NONE, True),
        (False, True, Advice.IN_CONTACT, True),
        (False, False, Advice.IN_CONTACT, False),
        (False, True, Advice.NOT_IN_CONTACT, False),
    ],
)
def test_contact_advice(made: bool, touching: bool, advice: Advice, expected: bool) -> None:
    assert contact_made(made, touching, advice) is expected
