"""MOVE/TRAJECTORY: joint targets, their gains, and what silence does, on a step clock."""

from __future__ import annotations

import math

import numpy as np
import pytest

from asimov_gym.firmware import (
    AlertId,
    Mode,
    State,
    Trajectory,
    Velocity,
)
from asimov_gym.robot.joints import KD, KP, STAND_POSITION, joint_index

LEFT_KNEE = joint_index("left_knee_joint")
ELBOW = joint_index("left_elbow_joint")


def test_trajectory_engages_from_damp_at_once_and_drives_every_joint(held) -> None:
    goal = STAND_POSITION.copy()
    goal[ELBOW] = 1.2
    for _ in range(100):
        held.firmware.command(Trajectory(goal))
        snapshot = held.run(0.02)
    assert snapshot.state is State.TRAJECTORY
    assert snapshot.joint_position == pytest.approx(goal, abs=0.05)


def test_trajectory_silence_of_200_ms_damps(held) -> None:
    held.firmware.command(Trajectory(STAND_POSITION))
    assert held.run(0.195).state is State.TRAJECTORY
    assert held.run(0.005).state is State.DAMP
    assert not held.firmware.snapshot.latched


def test_trajectory_within_200_ms_keeps_the_session(held) -> None:
    for _ in range(6):
        held.firmware.command(Trajectory(STAND_POSITION))
        assert held.run(0.19).state is State.TRAJECTORY


def test_the_timeout_reads_the_clock_and_not_the_ticks(held) -> None:
    held.firmware.command(Trajectory(STAND_POSITION))
    held.clock.advance(200_000)
    held.firmware.tick()
    assert held.firmware.state is State.DAMP


def test_trajectory_gains_reach_the_joints(held) -> None:
    kp, kd = KP.copy(), KD.copy()
    kp[ELBOW] = 0.0
    goal = STAND_POSITION.copy()
    goal[ELBOW] = 2.0
    for _ in range(20):
        held.firmware.command(Trajectory(goal, kp, kd))
        limp = held.run(0.02)
    assert abs(limp.joint_torque[ELBOW]) < 1.0
    for _ in range(20):
        held.firmware.command(Trajectory(goal))
        driven = held.run(0.02)
    assert driven.joint_position[ELBOW] > limp.joint_position[ELBOW] + 0.5


def test_trajectory_is_checked() -> None:
    with pytest.raises(ValueError, match="position must be 25 finite numbers"):
        Trajectory(np.zeros(24))
    with pytest.raises(ValueError, match="kd must be 25 finite numbers"):
        Trajectory(np.zeros(25), kd=np.full(25, np.nan))


def test_a_trajectory_may_bring_its_own_timeout(held) -> None:
    held.firmware.command(Trajectory(STAND_POSITION, timeout_s=2.0))
    assert held.run(1.995).state is State.TRAJECTORY
    assert held.run(0.005).state is State.DAMP
    held.firmware.command(Trajectory(STAND_POSITION, timeout_s=2.0))
    held.firmware.command(Trajectory(STAND_POSITION))
    assert held.run(0.195).state is State.TRAJECTORY
    assert held.run(0.005).state is State.DAMP


def test_silence_is_told_by_an_alert_and_latches_nothing(held) -> None:
    held.firmware.command(Trajectory(STAND_POSITION))
    snapshot = held.run(0.205)
    assert [(a.id, a.value, a.threshold) for a in snapshot.alerts] == [(AlertId.MODE_CHANGE, Mode.DAMP, Mode.MOVE)]
    assert snapshot.error_flags == 0
    held.firmware.command(Trajectory(STAND_POSITION))
    assert held.run(0.1).state is State.TRAJECTORY


@pytest.mark.parametrize("timeout", [0.0, -1.0, math.nan, math.inf])
def test_a_timeout_is_checked(timeout: float) -> None:
    with pytest.raises(ValueError, match="timeout_s must be None or a finite number > 0"):
        Velocity(0.0, 0.0, 0.0, timeout_s=timeout)
    with pytest.raises(ValueError, match="timeout_s must be None or a finite number > 0"):
        Trajectory(STAND_POSITION, timeout_s=timeout)
