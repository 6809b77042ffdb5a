"""Current and heat of the motors."""

import numpy as np
import pytest

from asimov_gym.robot.joints import MOTOR_NAMES
from asimov_gym.robot.motor import (
    NO_LOAD_SPEED,
    PEAK_TORQUE,
    RATED_TORQUE,
    HeatModel,
    heat,
    motor_current,
    motor_torque_limits,
)


def test_current_is_torque_over_the_torque_constant():
    torque = np.zeros(25)
    torque[MOTOR_NAMES.index("L_Hip_Pitch")], torque[MOTOR_NAMES.index("R_Elbow")] = 5.5, -1.81
    current = motor_current(torque)
    assert current[MOTOR_NAMES.index("L_Hip_Pitch")] == pytest.approx(2.0)
    assert current[MOTOR_NAMES.index("R_Elbow")] == pytest.approx(-1.0)
    assert np.count_nonzero(current) == 2


def run(load: float, seconds: float, dt: float = 0.1) -> float:
    temperature = np.full((1, 25), 25.0)
    for _ in range(round(seconds / dt)):
        temperature = heat(temperature, load * RATED_TORQUE[None], dt)
    assert np.ptp(temperature) < 1e-9
    return float(temperature[0, 0])


def test_rated_torque_settles_below_the_trip():
    assert run(1.0, 6000.0) == pytest.approx(70.0, abs=0.01)


def test_an_idle_motor_stays_cold():
    assert run(0.0, 100.0) == 25.0


def test_three_times_the_rating_trips_after_about_88_s():
    assert run(3.0, 87.0) < 80.0 < run(-3.0, 89.0)


@pytest.mark.parametrize("name", ["ambient_c", "rise_at_rated_c", "time_constant_s"])
def test_figures_are_checked(name):
    with pytest.raises(ValueError, match=f"{name} must be a finite number"):
        HeatModel(**{name: float("nan")})


KNEE = MOTOR_NAMES.index("L_Knee")


@pytest.mark.parametrize(
    ("speed", "low", "high"),
    [(0.0, -75.0, 75.0), (11.414, -75.0, 25.0), (-11.414, -25.0, 75.0), (17.121, -75.0, 0.0), (30.0, -75.0, 0.0)],
)
def test_torque_falls_along_the_line_through_the_rated_point(speed: float, low: float, high: float):
    limits = motor_torque_limits(np.full((2, 25), speed))
    assert limits[0][:, KNEE] == pytest.approx(low)
    assert limits[1][:, KNEE] == pytest.approx(high)


def test_every_family_gives_its_rated_torque_at_its_rated_speed():
    rated_speed = NO_LOAD_SPEED / 1.5
    assert motor_torque_limits(rated_speed)[1] == pytest.approx(RATED_TORQUE)
    assert pytest.approx(3.0 * RATED_TORQUE) == PEAK_TORQUE
