"""The evaluation's arithmetic, against cases worked out by hand, and its conditions, against what they say."""

from __future__ import annotations

import json

import numpy as np
import pytest

from asimov_gym.evaluation.report import Report, evaluate
from asimov_gym.evaluation.rollout import Trace, roll_out
from asimov_gym.evaluation.walking import (
    COMMAND_GRID,
    MUST_PASS_PUSHES,
    CommandResult,
    Push,
    PushResult,
    StandingResult,
    moving_mean,
    push,
    tracking_error,
    tracking_rmse,
    walk_grid,
)
from asimov_gym.policy import default_contract
from asimov_gym.robot.joints import STAND_POSITION


class Statue:
    """A policy that always asks for the standing pose."""

    def __init__(self) -> None:
        self.contract = default_contract()

    def infer(self, observation: np.ndarray) -> np.ndarray:
        return np.zeros((*observation.shape[:-1], 23), dtype=np.float32)

    __call__ = infer


def _trace(velocity: np.ndarray, command: np.ndarray, fall_step: list[int] | None = None) -> Trace:
    steps, n = velocity.shape[:2]
    nothing = np.zeros((steps, n, 3))
    return Trace(
        dt=0.02,
        command=command,
        velocity=velocity,
        position=nothing,
        gravity=nothing,
        foot_height=np.zeros((steps, n, 2)),
        joint_torque=np.zeros((steps, n, 25)),
        joint_velocity=np.zeros((steps, n, 25)),
        fall_step=np.array(fall_step or [steps] * n),
        start=np.zeros((n, 3)),
    )


def test_moving_mean() -> None:
    np.testing.assert_allclose(moving_mean(np.array([1.0, 2.0, 6.0, 4.0]), 2), [1.5, 4.0, 5.0])


def test_gait_oscillation_is_averaged_out_of_the_error_but_not_of_the_rmse() -> None:
    t = np.arange(500) * 0.02
    swing = 0.1 * np.sin(2 * np.pi * t / 0.5)  # a whole number of cycles per averaging window
    velocity = np.zeros((500, 1, 3))
    velocity[:, 0, 0], velocity[:, 0, 1], velocity[:, 0, 2] = 0.53, 0.04 + swing, -0.2 + swing
    command = np.tile([0.5, 0.0, 0.0], (500, 1, 1))
    error, yaw = tracking_error(_trace(velocity, command), period=0.5)
    assert error[0] == pytest.approx(0.05, abs=1e-3)
    assert yaw[0] == pytest.approx(0.2, abs=1e-3)
    planar, turning = tracking_rmse(_trace(velocity, command))
    assert planar[0] == pytest.approx(np.sqrt(0.05**2 + 0.1**2 / 2), abs=2e-3)
    assert turning[0] == pytest.approx(np.sqrt(0.2**2 + 0.1**2 / 2), abs=2e-3)


def test_the_first_two_seconds_do_not_count_and_fallen_robots_have_no_error() -> None:
    velocity = np.zeros((500, 2, 3))
    velocity[:100] = 5.0
    error, _ = tracking_error(_trace(velocity, np.zeros((500, 2, 3)), [500, 300]), period=0.5)
    assert error[0] == 0.0 and np.isnan(error[1])


def test_rollouts_are_reproducible_and_differ_by_seed() -> None:
    def run() -> Trace:
        return roll_out(Statue(), np.array([0, 1, 6]), 1.0, lambda now: np.zeros((3, 3)))

    first, again = run(), run()
    np.testing.assert_array_equal(first.position, again.position)
    assert np.abs(first.position[:, 0] - first.position[:, 1]).max() > 1e-5
    assert first.survived.all()


def test_delay_is_seed_mod_6_physics_steps() -> None:
    """A policy that jumps to a new target at the first step acts (seed mod 6) * 5 ms late."""

    class Kick(Statue):
        def infer(self, observation: np.ndarray) -> np.ndarray:
            action = super().infer(observation)
            action[:, 3] = 4.0
            return action

    trace = roll_out(Kick(), np.arange(12), 0.1, lambda now: np.zeros((12, 3)))
    torque = np.abs(trace.joint_torque[:, :, 3])
    # The torque read after a step is that of its last 5 ms: after 20 ms the first four delays show, the others later.
    first = (torque > 20.0).argmax(axis=0)
    assert first.tolist() == [0, 0, 0, 0, 1, 1] * 2


def test_statue_stands_but_does_not_walk() -> None:
    results = walk_grid(Statue(), commands=((0.5, 0.0, 0.0), (0.0, 0.0, 0.0)), seeds=2, seconds=4.0)
    assert [r.survived for r in results] == [2, 2]
    assert results[0].velocity_error == pytest.approx(0.5, abs=0.02)
    assert results[1].velocity_error < 0.01


def test_pushes_have_the_impulse_they_name() -> None:
    """A push adds force times 0.15 s to the momentum of a robot in free fall; a strong one fells a statue."""
    results = push(
        Statue(),
        (
            Push("pelvis_link", (1.0, 0.0, 0.0), 1.0, 0.0, "feather"),
            Push("pelvis_link", (-1.0, 0.0, 0.0), 450.0, 0.0, "pelvis back"),
        ),
        seeds=2,
        seconds=5.0,
    )
    assert [(r.push.label, r.survived) for r in results] == [("feather", 2), ("pelvis back", 0)]
    forces: list[float] = []

    class Spy(Statue):
        pass

    import asimov_gym.evaluation.walking as walking

    original = walking.roll_out

    def record(policy, seeds, seconds, command, wrench, progress):
        for step in range(round(seconds * 50)):
            acting = wrench(step / 50)
            forces.append(0.0 if acting is None else float(acting["pelvis_link"][0, 0]))
        return original(policy, seeds, 0.1, command, wrench, progress)

    walking.roll_out = record
    try:
        push(Spy(), (Push("pelvis_link", (1.0, 0.0, 0.0), 100.0, 0.0, "x"),), seeds=1)
    finally:
        walking.roll_out = original
    assert sum(forces) * 0.02 == pytest.approx(100.0 * 0.15)
    assert forces.index(100.0) == 100


def test_the_benchmark_has_its_18_must_pass_pushes() -> None:
    assert len(MUST_PASS_PUSHES) == 18
    assert {(p.body, p.force, p.speed) for p in MUST_PASS_PUSHES} >= {
        ("pelvis_link", 450, 0.0),
        ("waist_yaw_link", 225, 0.6),
    }
    assert len(COMMAND_GRID) >= 15
    axes = np.array(COMMAND_GRID)
    np.testing.assert_array_equal(axes.min(axis=0), [-0.4, -0.3, -0.6])
    np.testing.assert_array_equal(axes.max(axis=0), [0.7, 0.3, 0.6])


def test_report_counts_and_survives_json() -> None:
    nan = float("nan")
    good = CommandResult((0.5, 0, 0), 20, 20, (0.5, 0, 0), 0.02, 0.03, 0.05, 0.1)
    bad = CommandResult((0.7, 0, 0), 0, 20, (nan, nan, nan), nan, nan, nan, nan)
    pushes = [PushResult(MUST_PASS_PUSHES[0], 5, 5), PushResult(MUST_PASS_PUSHES[1], 4, 5)]
    report = Report([good, bad], StandingResult(20, 20, 0.01, 0.001, 0.0), pushes)
    assert (report.walks, report.falls, report.pushes_passed) == (40, 20, 1)
    data = json.loads(json.dumps(report.to_json(), allow_nan=False))
    assert data["summary"]["velocity_error"] is None and data["grid"][0]["velocity_error"] == 0.02
    assert "20 of 40" in report.summary() and "1 of 2" in report.summary()
    assert report.markdown().count("\n") >= 6


def test_bad_arguments_name_the_field() -> None:
    with pytest.raises(ValueError, match="seeds must be at least 1"):
        evaluate(Statue(), seeds=0)
    with pytest.raises(ValueError, match="seconds must be at least 4"):
        evaluate(Statue(), seconds=1.0)


def test_start_is_near_the_standing_pose() -> None:
    trace = roll_out(Statue(), np.arange(3), 0.02, lambda now: np.zeros((3, 3)))
    assert np.abs(trace.joint_velocity).max() < 20.0
    assert STAND_POSITION.shape == (25,)
