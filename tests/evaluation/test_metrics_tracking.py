"""Velocity errors, dead reckoning and drift, against motions worked out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from asimov_gym.evaluation import tracking

DT = 0.02


def _errors(found: tuple[float, float] | None) -> tuple[float, float]:
    assert found is not None
    return found


def _rows(vx: float, vy: float, wz: float, steps: int = 500) -> np.ndarray:
    return np.tile([vx, vy, wz], (steps, 1))


def test_moving_mean() -> None:
    np.testing.assert_allclose(tracking.moving_mean(np.array([1.0, 2.0, 6.0, 4.0]), 2), [1.5, 4.0, 5.0])


def test_sway_at_the_gait_frequency_is_no_error_of_the_cycle_but_one_of_the_instant() -> None:
    t = np.arange(500) * DT
    swing = 0.1 * np.sin(2.0 * math.pi * t / 0.5)  # a whole number of cycles in the window and in the time
    velocity = _rows(0.53, 0.04, -0.05) + np.stack([0.0 * t, swing, swing], axis=1)
    error, yaw = _errors(tracking.cycle_error(velocity, _rows(0.5, 0.0, 0.0), DT, 0.5))
    # 3 cm/s forwards and 4 sideways make 5; the window and the sway are commensurate, so what is left is rounding.
    assert error == pytest.approx(0.05, abs=1e-9) and yaw == pytest.approx(0.05, abs=1e-9)
    planar, turning = _errors(tracking.instantaneous_rmse(velocity, _rows(0.5, 0.0, 0.0), DT))
    assert planar == pytest.approx(math.sqrt(0.05**2 + 0.1**2 / 2), abs=1e-9)
    assert turning == pytest.approx(math.sqrt(0.05**2 + 0.1**2 / 2), abs=1e-9)


def test_the_planar_error_is_the_norm_of_the_mean_not_the_mean_of_the_norm() -> None:
    """An error that changes its sign within each cycle vanishes."""
    velocity = _rows(0.0, 0.0, 0.0)
    velocity[::2, 0], velocity[1::2, 0] = 0.3, -0.3
    error, _ = _errors(tracking.cycle_error(velocity, _rows(0.0, 0.0, 0.0), DT, 0.5 - DT))
    assert error == pytest.approx(0.0, abs=1e-9)


def test_errors_of_different_cycles_do_not_cancel() -> None:
    """Too fast for four seconds and too slow for four is an error all the time."""
    velocity = np.concatenate([_rows(0.1, 0.0, 0.2, 300), _rows(-0.1, 0.0, -0.2, 200)])
    error, yaw = _errors(tracking.cycle_error(velocity, _rows(0.0, 0.0, 0.0), DT, 0.5))
    # Windows across the change, 24 of 376, see a part of both: half of the error on average.
    assert error == pytest.approx(0.1 * (352 + 12) / 376, rel=0.01) and yaw == pytest.approx(2.0 * error)


def test_the_first_two_seconds_do_not_count() -> None:
    velocity = _rows(0.0, 0.0, 0.0)
    velocity[:100] = 5.0
    assert tracking.cycle_error(velocity, _rows(0.0, 0.0, 0.0), DT, 0.5) == (0.0, 0.0)
    assert tracking.instantaneous_rmse(velocity, _rows(0.0, 0.0, 0.0), DT) == (0.0, 0.0)
    np.testing.assert_array_equal(tracking.mean_velocity(velocity, DT), [0.0, 0.0, 0.0])
    velocity[100] = 5.0
    assert tracking.instantaneous_rmse(velocity, _rows(0.0, 0.0, 0.0), DT)[0] > 0.1


def test_too_short_a_time_has_no_error() -> None:
    assert tracking.cycle_error(_rows(1.0, 0.0, 0.0, 110), _rows(0.0, 0.0, 0.0, 110), DT, 0.5) is None
    assert tracking.instantaneous_rmse(_rows(1.0, 0.0, 0.0, 100), _rows(0.0, 0.0, 0.0, 100), DT) is None
    assert tracking.mean_velocity(_rows(1.0, 0.0, 0.0, 100), DT) is None


def test_dead_reckoning_of_a_half_circle() -> None:
    """0.5 m/s and 0.5 rad/s go round a circle of 1 m; half of it ends 2 m to the left, facing back."""
    steps = round(math.pi / 0.5 / DT)
    path, heading = tracking.dead_reckoned_path(_rows(0.5, 0.0, 0.5, steps), DT, np.array([3.0, -1.0]))
    angle = 0.5 * DT * np.arange(1, steps + 1)
    circle = np.stack([3.0 + np.sin(angle), -1.0 + 1.0 - np.cos(angle)], axis=1)
    np.testing.assert_allclose(path, circle, atol=1e-4)  # chords of 1 cm on a radius of 1 m fall short by 4e-6 each
    np.testing.assert_allclose(heading, angle, rtol=1e-12)


def test_sideways_commands_go_left_of_the_heading() -> None:
    command = np.concatenate([_rows(0.0, 0.0, 0.5 * math.pi, 50), _rows(0.0, 0.4, 0.0, 50)])
    path, _ = tracking.dead_reckoned_path(command, DT, np.zeros(2))
    np.testing.assert_allclose(path[-1], [-0.4, 0.0], atol=1e-12)  # facing +y, left is -x


def test_drift_of_a_robot_that_walks_straight_instead_of_round() -> None:
    steps = round(math.pi / 0.5 / DT)
    path, heading = tracking.dead_reckoned_path(_rows(0.5, 0.0, 0.5, steps), DT, np.zeros(2))
    straight = np.zeros((steps, 3))
    straight[:, 0] = 0.5 * DT * np.arange(1, steps + 1)
    assert tracking.final_drift(straight, path) == pytest.approx(math.hypot(math.pi, 2.0), abs=0.02)
    assert tracking.final_heading_error(np.zeros(steps), heading) == pytest.approx(math.pi, abs=0.01)


def test_heading_error_knows_the_circle() -> None:
    assert tracking.final_heading_error(np.array([-3.1]), np.array([3.1 + 4.0 * math.pi])) == pytest.approx(
        2.0 * math.pi - 6.2, abs=1e-9
    )


def test_the_way_of_a_swaying_robot_is_that_of_its_middle() -> None:
    t = np.arange(501) * DT
    position = np.stack([0.6 * t, 0.03 * np.sin(2.0 * math.pi * t / 0.5)], axis=1)
    assert tracking.path_length(position, DT, 0.5) == pytest.approx(6.0, rel=1e-9)
    raw = np.linalg.norm(np.diff(position, axis=0), axis=1).sum()
    assert raw > 6.3  # what a sum over instants would say
    assert tracking.path_length(position[:10], DT, 0.5) == 0.0


def test_gait_period_of_a_policy_with_and_without_a_clock() -> None:
    assert tracking.gait_period(1.25) == 0.8 and tracking.gait_period(None) == 0.7
