"""A real ROS 2 node against the ROS 2 lane, where there is a ROS 2 installation with the vendor's messages."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

pytest.importorskip("cyclonedds", reason="needs Cyclone DDS: pip install 'asimov-gym[ros2]'")

from asimov_gym.edge import SimulatedRobot
from asimov_gym.edge.motion_modes_service import MotionModes
from asimov_gym.edge.transports.ros2 import Ros2Lane
from asimov_gym.firmware import WallClock
from tests.edge.conftest import StandInPolicy

DOMAIN = 10 + os.getpid() % 90
ENVIRONMENT = {"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp", "ROS_LOCALHOST_ONLY": "1", "ROS_DOMAIN_ID": str(DOMAIN)}


def ros_python() -> str:
    """An interpreter that has ROS 2 with Cyclone DDS and the vendor's messages; skips where there is none."""
    if "ROS_DISTRO" not in os.environ:
        pytest.skip("no ROS 2: source a setup.bash with rclpy, rmw_cyclonedds_cpp and aimdk_msgs before the tests")
    python = shutil.which("python3") or "python3"
    check = "import rclpy, aimdk_msgs.srv; rclpy.init()"
    environment = {**os.environ, **ENVIRONMENT}
    done = subprocess.run([python, "-c", check], env=environment, capture_output=True, text=True, timeout=60)
    if done.returncode != 0:
        pytest.skip(f"ROS 2 without what the test needs: {done.stderr.strip().splitlines()[-1]}")
    return python


@pytest.mark.slow
def test_a_real_node() -> None:
    python = ros_python()
    robot = SimulatedRobot(StandInPolicy(), WallClock())
    modes = MotionModes(robot.edge)
    script = Path(__file__).with_name("rclpy_client.py")
    with modes, Ros2Lane(modes, DOMAIN), robot:
        done = subprocess.run(
            [python, str(script)],
            env={**os.environ, **ENVIRONMENT},
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
    assert done.returncode == 0, done.stdout + done.stderr
    assert robot.edge.tally.dropped  # velocities in damping
