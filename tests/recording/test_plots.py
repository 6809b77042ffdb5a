"""Plots of a recording. How they look was judged by eye; here, that they come and say what they must."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from asimov_gym.edge import SimulatedRobot, connect
from asimov_gym.recording import Recorder, plots
from asimov_gym.recording.odometry import estimate_motion
from asimov_gym.recording.series import read_telemetry, read_velocity_commands
from asimov_gym.recording.summary import summarize
from asimov_gym.robot.joints import JOINT_NAMES
from asimov_gym.robot.motor import KT

NAMES = ["timeline.png", "velocity.png", "positions.png", "currents.png", "temperatures.png", "torques.png"]


def test_every_plot_is_drawn(old_recording: Path, tmp_path: Path) -> None:
    written = plots.save_plots(old_recording, tmp_path / "plots")
    assert [path.name for path in written] == NAMES
    for path in written:
        assert path.read_bytes().startswith(b"\x89PNG") and path.stat().st_size > 10_000


def test_a_recording_without_telemetry_has_its_timeline(tmp_path: Path) -> None:
    robot = SimulatedRobot()
    with Recorder(tmp_path / "short.mcap", robot.edge):
        robot.advance(0.05)
    assert [path.name for path in plots.save_plots(tmp_path / "short.mcap", tmp_path)] == ["timeline.png"]


def test_commanded_velocity_counts_while_the_policy_walks(recording: Path) -> None:
    summary, motion = summarize(recording), estimate_motion(read_telemetry(recording))
    asked = plots._held(summary, read_velocity_commands(recording), motion.time)
    walking = (motion.time > 0.81) & (motion.time < 1.99)
    assert np.allclose(asked[walking], [0.4, 0.0, 0.0]) and not asked[~walking & (motion.time > 2.01)].any()


def test_thinned_lines_keep_their_peaks() -> None:
    time = np.arange(50_000) * 0.005
    values = np.zeros(50_000)
    values[31_234] = 7.0
    thin_time, thin_values = plots._thin(time, values)
    assert len(thin_values) <= plots._POINTS + 2 and thin_values.max() == 7.0
    assert thin_time[thin_values.argmax()] == pytest.approx(time[31_234], abs=0.2)


def test_torques_are_those_that_the_robot_applied(tmp_path: Path) -> None:
    """Each current reading has a noise of 0.1 A; five times that is not met by chance."""
    robot = SimulatedRobot(gantry="off", seed=3)
    with Recorder(tmp_path / "stand.mcap", robot.edge), connect(robot) as session:
        session.stand()
        robot.advance(0.5)
    reported, applied = read_telemetry(tmp_path / "stand.mcap").motor_torque()[-1], robot.physics.read().joint_torque[0]
    knees = [JOINT_NAMES.index(f"{side}_knee_joint") for side in ("left", "right")]
    assert np.abs(applied[knees]).min() > 2.0
    assert np.allclose(reported[knees], applied[knees], atol=0.5 * KT[knees[0]])
