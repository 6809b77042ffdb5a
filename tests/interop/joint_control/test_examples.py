"""The examples of joint control, which use the vendor's client."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest

pytest.importorskip("bosdyn", reason="bosdyn-client is not installed: pip install 'asimov-gym[joint-control,test]'")

from asimov_gym.edge import SimulatedRobot
from asimov_gym.edge.transports.joint_control import JointControlLane
from asimov_gym.firmware import State, WallClock
from asimov_gym.robot.joints import JOINT_NAMES, RANGE, STAND_POSITION
from asimov_gym.robot.model import robot_model


def test_the_squat_keeps_its_balance_on_flat_feet() -> None:
    """The centre of mass stays over the soles, 18 cm long, all the way down; the ankles stay short of their end."""
    from asimov_gym.examples.joint_squat import JointSquat

    model = robot_model()
    data = mujoco.MjData(model)
    (low, high) = (leg.pose for leg in JointSquat(repeats=1).legs(STAND_POSITION))
    assert high is not low
    for share in np.linspace(0.0, 1.0, 11):
        pose = STAND_POSITION + share * (low - STAND_POSITION)
        assert (pose >= RANGE[:, 0]).all()
        assert (pose <= RANGE[:, 1]).all()
        mujoco.mj_resetDataKeyframe(model, data, model.key("stand").id)
        for name, angle in zip(JOINT_NAMES, pose.tolist(), strict=True):
            data.joint(name).qpos[0] = angle
        mujoco.mj_forward(model, data)
        foot = data.site("left_foot")
        ahead = foot.xmat.reshape(3, 3).T @ (data.body("pelvis_link").subtree_com - foot.xpos)
        assert abs(ahead[0]) < 0.05, f"{share:.0%} of the way down"


@pytest.mark.slow
def test_an_example_runs_and_draws_its_histogram(tmp_path: Path) -> None:
    plot = tmp_path / "loop.png"
    with SimulatedRobot(clock=WallClock()) as robot, JointControlLane(robot.edge, 0) as lane:
        command = [sys.executable, "-m", "asimov_gym.examples.joint_wiggle", "--target", f"127.0.0.1:{lane.port}"]
        command += ["--seconds", "0.4", "--repeats", "1", "--plot", str(plot)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
        assert done.returncode == 0, done.stderr
        assert robot.firmware.state is State.STAND
    assert "round trip" in done.stdout
    assert plot.read_bytes().startswith(b"\x89PNG")
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 2
    assert "Is `asimov robot --joint-control PORT` running?" in done.stderr
