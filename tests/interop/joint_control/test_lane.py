"""The lane opens, closes, and says in one line what it needs."""

from __future__ import annotations

import subprocess
import sys

import pytest

pytest.importorskip("bosdyn", reason="bosdyn-client is not installed: pip install 'asimov-gym[joint-control,test]'")

from asimov_gym.edge import SimulatedRobot
from asimov_gym.edge.transports import TransportError
from asimov_gym.edge.transports.joint_control import JointControlLane
from asimov_gym.firmware import State
from tests.interop.joint_control.joint_client import Clients, Pilot


def test_a_port_in_use_is_said_in_one_line(robot: SimulatedRobot, lane: JointControlLane) -> None:
    with pytest.raises(TransportError, match=rf"port {lane.port} of 127\.0\.0\.1: in use.*--joint-control"):
        JointControlLane(robot.edge, lane.port).start()
    with pytest.raises(TransportError, match="--joint-control must be from 0 to 65535, got 70000"):
        JointControlLane(robot.edge, 70_000)


def test_without_the_message_package_one_line_says_what_to_install(
    robot: SimulatedRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in [name for name in sys.modules if name.startswith("asimov_gym.edge.transports.joint_control.")]:
        monkeypatch.delitem(sys.modules, name)
    for name in [name for name in sys.modules if name.partition(".")[0] == "bosdyn"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "bosdyn", None)
    with pytest.raises(TransportError, match=r"pip install 'asimov-gym\[joint-control\]'"):
        JointControlLane(robot.edge, 0).start()


def test_a_lane_that_stops_ends_the_run_and_its_streams(robot: SimulatedRobot) -> None:
    lane = JointControlLane(robot.edge, 0)
    lane.start()
    clients = Clients(lane.port)
    clients.synchronize()
    pilot = Pilot(robot, clients)
    pilot.begin(ahead_s=5.0)
    lane.stop()
    lane.stop()
    assert robot.firmware.state is State.DAMP
    assert robot.edge.control.holder is None
    robot.advance(0.01)
    assert robot.physics.timestep == 0.005
    clients.close()
    lane.start()
    lane.stop()


def test_the_robots_own_side_never_loads_the_vendors_package() -> None:
    code = (
        "import sys, asimov_gym.edge, asimov_gym.recording, asimov_gym.edge.joint_control\n"
        "import asimov_gym.edge.transports.joint_control, asimov_gym.cli.robot_service\n"
        "print([name for name in sys.modules if name.partition('.')[0] in ('bosdyn', 'grpc')])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False)
    assert (done.returncode, done.stdout.strip()) == (0, "[]"), done.stderr
