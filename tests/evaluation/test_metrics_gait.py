"""Steps, swings, slip, symmetry and standing, against gaits drawn by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from asimov_gym.evaluation import gait, standing
from asimov_gym.robot.joints import joint_index

DT = 0.02


def _walk(
    cycles: int = 10, period: int = 40, swing: tuple[int, int] = (16, 16), height: tuple[float, float] = (0.06, 0.06)
):
    """Contacts and sole heights (T, 2): the left foot swings from step 2 of a cycle, the right half a cycle later."""
    contact, sole = np.ones((cycles * period, 2), dtype=bool), np.zeros((cycles * period, 2))
    for cycle in range(cycles):
        for foot in range(2):
            first = cycle * period + 2 + foot * period // 2
            contact[first : first + swing[foot], foot] = False
            arc = np.sin(np.pi * np.arange(swing[foot] + 1) / swing[foot])[: swing[foot]]
            sole[first : first + swing[foot], foot] = height[foot] * arc
    return contact, sole


def test_runs() -> None:
    assert gait.runs(np.array([True, True, False, True, False, False, True])) == [(0, 2), (3, 4), (6, 7)]
    assert gait.runs(np.array([False, False])) == []


def test_contact_needs_more_than_five_newtons() -> None:
    np.testing.assert_array_equal(gait.contacts(np.array([[4.9, 5.1]])), [[False, True]])


def test_swings_are_found_with_their_height() -> None:
    contact, sole = _walk(cycles=3)
    steps = gait.swings(contact, sole, DT)
    assert [(s.foot, s.start, s.stop) for s in steps[:2]] == [(0, 2, 18), (0, 42, 58)]
    assert len(steps) == 6
    assert gait.clearance(steps) == pytest.approx(0.06, rel=1e-9)
    assert gait.clearance([]) is None


def test_bounces_and_cut_off_steps_are_no_swings() -> None:
    contact, sole = _walk(cycles=1)
    contact[30:34, 0] = False  # 80 ms
    contact[36:, 0] = False  # until the end
    assert [s.foot for s in gait.swings(contact, sole, DT)] == [0, 1]
    contact[:2, 0] = False  # from the beginning
    assert [s.foot for s in gait.swings(contact, sole, DT)] == [1]


def test_frequency_counts_cycles_not_steps() -> None:
    contact, sole = _walk(period=40)
    steps = gait.swings(contact, sole, DT)
    assert gait.frequency(steps, DT) == pytest.approx(1.25)
    assert gait.frequency([s for s in steps if s.foot == 0], DT) is None


def test_slip_is_that_of_carrying_feet_within_their_stance() -> None:
    contact, _ = _walk()
    velocity = np.zeros((len(contact), 2, 3))
    velocity[~contact] = [1.5, 0.0, 0.4]  # a swinging foot is fast
    velocity[contact] = [0.03, 0.04, 0.9]  # a carrying one slides 5 cm/s; up and down is no slip
    assert gait.slip_speed(velocity, contact) == pytest.approx(0.05)
    firm = sum(stop - start - 2 for foot in range(2) for start, stop in gait.runs(contact[:, foot]))
    assert gait.slip_distance(velocity, contact, DT) == pytest.approx(0.05 * firm * DT)
    landing = np.diff(contact.astype(int), axis=0, prepend=1) == 1
    velocity[landing] = [2.0, 0.0, 0.0]
    assert gait.slip_speed(velocity, contact) == pytest.approx(0.05)
    assert gait.slip_speed(velocity, np.zeros_like(contact)) is None


def test_asymmetry_is_a_share_of_the_mean() -> None:
    assert gait.asymmetry(0.9, 1.1) == pytest.approx(0.2)
    assert gait.asymmetry(1.1, 0.9) == pytest.approx(0.2)
    assert gait.asymmetry(0.0, 0.0) is None


def test_a_limp_shows_in_time_and_height() -> None:
    limp = gait.swings(*_walk(swing=(12, 18), height=(0.05, 0.03)), DT)
    assert gait.step_time_asymmetry(limp) == pytest.approx(6 / 15)
    assert gait.foot_lift_asymmetry(limp) == pytest.approx(0.02 / 0.04)
    even = gait.swings(*_walk(), DT)
    assert gait.step_time_asymmetry(even) == 0.0 and gait.foot_lift_asymmetry(even) == 0.0


def test_one_stumble_is_no_limp() -> None:
    contact, sole = _walk()
    contact[242:258, 0], sole[242:258, 0] = True, 0.0
    contact[242:250, 0] = False
    assert gait.step_time_asymmetry(gait.swings(contact, sole, DT)) == 0.0


def test_joint_range_asymmetry_compares_the_legs() -> None:
    t = np.arange(1000) * DT
    position = np.zeros((1000, 25))
    left, right = joint_index("left_knee_joint"), joint_index("right_knee_joint")
    position[:, left], position[:, right] = 0.4 * np.sin(9.0 * t), -0.4 * np.sin(9.0 * t)
    assert gait.joint_range_asymmetry(position) == pytest.approx(0.0, abs=1e-12)
    position[:, right] *= 0.5
    assert gait.joint_range_asymmetry(position) == pytest.approx(0.5 / 0.75, abs=1e-9)
    position[0, right] = -9.0  # an outlier
    assert gait.joint_range_asymmetry(position) == pytest.approx(0.5 / 0.75, abs=0.01)
    position[:, joint_index("left_elbow_joint")] = np.sin(t)  # arms are not legs
    assert gait.joint_range_asymmetry(position) == pytest.approx(0.5 / 0.75, abs=0.01)
    assert gait.joint_range_asymmetry(np.zeros((10, 25))) is None


def test_drift_is_the_largest_distance_on_the_way() -> None:
    position = np.zeros((500, 3))
    position[:, 2] = 0.7
    position[:100, 0] = np.linspace(0.0, 0.04, 100)  # a shuffle at the start
    position[100:, 0] = 0.04
    position[300, 1] = 0.003  # away, and back for a part
    position[301:, 1] = 0.002
    assert standing.drift(position, np.array([0.0, 0.0, 0.7])) == pytest.approx(math.hypot(0.04, 0.003))
    assert standing.settled_drift(position, DT) == pytest.approx(0.003)
    assert standing.settled_drift(position[:100], DT) is None


def test_sway_of_a_sine() -> None:
    t = np.arange(600) * DT
    position = np.stack([0.5 + 0.02 * np.sin(2.0 * math.pi * t + 1.0), 0.0 * t, 0.1 * t], axis=1)
    position[:100] = 9.0
    assert standing.sway(position, DT) == pytest.approx(0.02 / math.sqrt(2.0), rel=1e-9)  # 10 whole swings
    assert standing.sway(position[:100], DT) is None


def test_steps_while_standing() -> None:
    contact, sole = np.ones((200, 2), dtype=bool), np.full((200, 2), 0.001)
    assert standing.steps_taken(sole, contact, DT) == 0
    contact[20, 0] = False  # one missing sample
    assert standing.steps_taken(sole, contact, DT) == 0
    contact[30:33, 0] = False  # unloaded
    assert standing.steps_taken(sole, contact, DT) == 1
    sole[60:70, 1] = 0.02  # lifted, while a toe may still touch
    assert standing.steps_taken(sole, contact, DT) == 2
    sole[60:70, 1] = 0.009
    assert standing.steps_taken(sole, contact, DT) == 1
