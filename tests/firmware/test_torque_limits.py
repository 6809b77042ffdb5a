"""Less torque at higher speed: the law against the motors' line."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from asimov_gym.firmware import Linkage, Stand, Trajectory
from asimov_gym.firmware.torque_limits import TorqueLimits
from asimov_gym.physics import JointTarget
from asimov_gym.robot.joints import EFFORT, KD, KP, STAND_POSITION, joint_index

KNEE = joint_index("left_knee_joint")
PITCH, ROLL = joint_index("left_ankle_pitch_joint"), joint_index("left_ankle_roll_joint")
KNEE_LINE = 75.0 * (1.0 - 12.0 / (1.5 * 11.414))
"""Torque that the knee's motor has left at 12 rad/s."""


@pytest.fixture
def limits() -> TorqueLimits:
    return TorqueLimits(KP, KD, Linkage())


def moving(**speeds: float) -> np.ndarray:
    velocity = np.zeros((1, 25))
    for name, speed in speeds.items():
        velocity[0, joint_index(f"left_{name}_joint")] = speed
    return velocity


def law(target: JointTarget, position: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    kp = KP if target.kp is None else target.kp
    kd = KD if target.kd is None else target.kd
    load = 0.0 if target.load is None else target.load
    return np.clip(kp * (target.position - position) - kd * velocity + load, -EFFORT, EFFORT)[0]


def test_nothing_is_limited_at_rest(limits: TorqueLimits) -> None:
    target = JointTarget(np.full((1, 25), 3.0))
    assert limits.apply(target, np.zeros((1, 25)), np.zeros((1, 25))) is target


def test_a_fast_knee_is_driven_with_what_its_motor_has(limits: TorqueLimits) -> None:
    position, velocity = np.zeros((1, 25)), moving(knee=12.0)
    target = JointTarget(np.ones((1, 25)) * 1.0, load=np.zeros((1, 25)))
    held = limits.apply(target, position, velocity)
    torque, free = law(held, position, velocity), law(target, position, velocity)
    assert free[KNEE] == 45.0
    assert torque[KNEE] == pytest.approx(KNEE_LINE)
    assert np.delete(torque, KNEE) == pytest.approx(np.delete(free, KNEE))


def test_explicit_gains_and_load_are_held_too(limits: TorqueLimits) -> None:
    position, velocity = np.zeros((1, 25)), moving(knee=-12.0)
    zero = np.zeros((1, 25))
    target = JointTarget(zero, kp=zero, kd=zero, load=np.full((1, 25), -35.0))
    held = limits.apply(target, position, velocity)
    assert law(held, position, velocity)[KNEE] == pytest.approx(-KNEE_LINE)


def test_braking_is_not_limited(limits: TorqueLimits) -> None:
    position, velocity = np.zeros((1, 25)), moving(knee=12.0)
    target = JointTarget(np.full((1, 25), -1.0))
    assert limits.apply(target, position, velocity) is target


def test_beyond_the_no_load_speed_a_motor_drives_nothing(limits: TorqueLimits) -> None:
    position, velocity = np.zeros((1, 25)), moving(knee=18.0)
    held = limits.apply(JointTarget(np.full((1, 25), 5.0)), position, velocity)
    assert law(held, position, velocity)[KNEE] == 0.0


def test_the_motors_of_a_foot_give_in_together(limits: TorqueLimits) -> None:
    position, velocity = np.zeros((1, 25)), moving(ankle_pitch=4.0)
    goal = np.zeros((1, 25))
    goal[0, PITCH], goal[0, ROLL] = 1.0, -0.05
    held = limits.apply(JointTarget(goal), position, velocity)
    pitch, roll = law(held, position, velocity)[[PITCH, ROLL]]
    free_pitch, free_roll = law(JointTarget(goal), position, velocity)[[PITCH, ROLL]]
    motor_a, motor_b = (pitch / 2.02 - roll / 0.8) / 2.0, (-pitch / 2.02 - roll / 0.8) / 2.0
    line = 36.0 * (1.0 - 2.02 * 4.0 / (1.5 * 7.854))
    assert free_pitch == 40.0
    assert max(motor_a, -motor_b) == pytest.approx(line)
    assert (pitch / free_pitch, roll / free_roll) == pytest.approx((pitch / free_pitch,) * 2)


@pytest.mark.parametrize("form", ["linear", "exact"])
def test_no_motor_is_ever_asked_for_more_than_its_line(form) -> None:
    random, linkage = np.random.default_rng(5), Linkage(form)
    limits = TorqueLimits(KP, KD, linkage)
    arm = [3.456, 11.414, 4.922, 7.854, 7.854]
    rated_speed = [11.205, 3.456, 4.922, 11.414, 7.854, 7.854] * 2 + arm * 2 + [11.205, 7.854, 7.854]
    no_load = 1.5 * np.array(rated_speed)
    peak = np.array([120, 90, 60, 75, 36, 36] * 2 + [90, 75, 60, 36, 36] * 2 + [120, 36, 36])
    bound = 0
    for scale in (0.5, 1.0, 2.0, 4.0) * 50:
        position, velocity = random.normal(0.0, 0.15, (1, 25)), random.normal(0.0, 3.0 * scale, (1, 25))
        target = JointTarget(random.normal(0.0, 0.4, (1, 25)))
        held = limits.apply(target, position, velocity)
        bound += held is not target
        torque = linkage.motor_torque(law(held, position, velocity), position[0])
        speed = linkage.motor_velocity(velocity[0], position[0])
        driving = torque * np.sign(speed)
        assert np.all(driving <= np.maximum(0.0, peak * (1.0 - np.abs(speed) / no_load)) + 1e-9)
    assert 50 < bound < 200


def test_standing_is_untouched(make_bench: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    bench = make_bench()
    touched = []
    apply = TorqueLimits.apply

    def watched(self, target, position, velocity):
        result = apply(self, target, position, velocity)
        touched.append(result is not target)
        return result

    monkeypatch.setattr(TorqueLimits, "apply", watched)
    bench.run(0.5)
    bench.firmware.command(Stand())
    bench.run(3.0)
    assert len(touched) == 700
    assert sum(touched) == 0


def test_the_simulated_motor_obeys(held) -> None:
    goal, kp = STAND_POSITION.copy(), KP.copy()
    kp[KNEE] = 500.0
    worst, fastest = -np.inf, 0.0
    before = 0.0
    for i in range(200):
        goal[KNEE] = (0.2, 1.3)[i // 20 % 2]
        held.firmware.command(Trajectory(goal, kp, KD))
        snapshot = held.run(0.005)
        line = max(0.0, 75.0 * (1.0 - abs(before) / 17.121))
        worst = max(worst, snapshot.joint_torque[KNEE] * np.sign(before) - line)
        before = snapshot.joint_velocity[KNEE]
        fastest = max(fastest, abs(before))
    assert fastest > 10.0
    assert worst < 1.0
