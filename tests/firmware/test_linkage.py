from __future__ import annotations

import numpy as np
import pytest

from asimov_gym.firmware import Linkage
from asimov_gym.robot.ankle import gains_to_joint

STEP = 1e-6


def slope(linkage: Linkage, pose: np.ndarray, motor: int, joint: int) -> float:
    """Motor angle per joint angle, by differences."""
    ahead, behind = pose.copy(), pose.copy()
    ahead[joint] += STEP
    behind[joint] -= STEP
    return float(linkage.motor_position(ahead)[motor] - linkage.motor_position(behind)[motor]) / (2.0 * STEP)


def test_gains_of_the_exact_form_follow_the_slopes_at_the_pose() -> None:
    linkage, random = Linkage("exact"), np.random.default_rng(1)
    kp, kd = random.uniform(10.0, 100.0, 25), random.uniform(0.1, 5.0, 25)
    pose = random.uniform(-0.2, 0.2, 25)
    joint_kp, joint_kd = linkage.joint_gains(kp, kd, pose)
    for a in (4, 10):
        for joint in (a, a + 1):
            squares = np.array([slope(linkage, pose, motor, joint) ** 2 for motor in (a, a + 1)])
            assert joint_kp[joint] == pytest.approx(kp[a : a + 2] @ squares, rel=1e-5)
            assert joint_kd[joint] == pytest.approx(kd[a : a + 2] @ squares, rel=1e-5)
    others = np.delete(np.arange(25), [4, 5, 10, 11])
    assert np.array_equal(joint_kp[others], kp[others])


def test_forms_agree_on_gains_in_the_middle() -> None:
    kp, kd = np.full(25, 30.0), np.full(25, 2.0)
    exact, linear = Linkage("exact").joint_gains(kp, kd, np.zeros(25)), Linkage().joint_gains(kp, kd, np.zeros(25))
    assert exact[0] == pytest.approx(linear[0])
    assert exact[1] == pytest.approx(linear[1])
    assert np.array_equal(linear[0], gains_to_joint(kp, kd)[0])


@pytest.mark.parametrize("form", ["linear", "exact"])
def test_speeds_go_there_and_back(form) -> None:
    linkage, random = Linkage(form), np.random.default_rng(2)
    speed, pose = random.normal(size=25), random.uniform(-0.2, 0.2, 25)
    assert linkage.joint_velocity(linkage.motor_velocity(speed, pose), pose) == pytest.approx(speed)
