"""The demo's error measure: what the gait does within a period is no error, what it does on average is."""

from __future__ import annotations

import numpy as np
import pytest

from asimov_gym.cli.tracking import Tracking, true_velocity
from asimov_gym.physics import CPhysics

PERIOD = 0.7


def walk(offset: tuple[float, float, float]) -> Tracking:
    """Six seconds that sway by 0.2 m/s once per period around the command plus `offset`."""
    tracking = Tracking(interval=0.02, window=PERIOD)
    command = np.array([0.5, 0.0, 0.3])
    for sample in range(300):
        sway = 0.2 * np.sin(2.0 * np.pi * 0.02 * sample / PERIOD)
        tracking.add(command, command + sway + np.array(offset))
    return tracking


def test_sway_within_a_period_is_no_error() -> None:
    linear, yaw = walk((0.0, 0.0, 0.0)).error(1.0, 5.0)
    assert linear < 1e-6
    assert yaw < 1e-6


def test_mean_offset_is_the_error() -> None:
    linear, yaw = walk((0.03, 0.04, -0.1)).error(1.0, 5.0)
    assert linear == pytest.approx(0.05, abs=1e-6)
    assert yaw == pytest.approx(0.1, abs=1e-6)


def test_short_record_keeps_its_length() -> None:
    tracking = Tracking(interval=0.02, window=PERIOD)
    tracking.add(np.zeros(3), np.ones(3))
    assert tracking.smoothed().shape == (1, 3)


def test_error_outside_of_the_record_is_refused() -> None:
    with pytest.raises(ValueError, match="no sample between"):
        walk((0.0, 0.0, 0.0)).error(10.0, 11.0)


def test_true_velocity_is_in_the_heading_frame() -> None:
    """A robot that faces left (+y) and moves along +y walks forward."""
    physics = CPhysics(copies=1)
    qpos, qvel = physics.standing()
    qpos[3:7] = [np.cos(np.pi / 4), 0.0, 0.0, np.sin(np.pi / 4)]
    qvel[:3], qvel[3:6] = [0.0, 0.6, 0.0], [0.0, 0.0, 0.2]
    physics.reset(qpos, qvel)
    np.testing.assert_allclose(true_velocity(physics.read()), [0.6, 0.0, 0.2], atol=1e-12)
