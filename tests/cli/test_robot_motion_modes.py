"""`asimov robot --motion-modes`: what it takes, what it prints, what it refuses."""

from __future__ import annotations

import json
import os
import re
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from asimov_gym.cli import main
from asimov_gym.cli.motion_mode_lanes import MotionModeOptions, parse_motion_modes
from asimov_gym.cli.robot_service import RobotService
from asimov_gym.edge import SimulatedRobot
from asimov_gym.firmware import WallClock

DOMAIN = 10 + os.getpid() % 90
ROBOT = ("robot", "--no-udp", "--seconds", "0.3")


@pytest.fixture(autouse=True)
def runtime(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A runtime folder of the test's own, with a short name, and a ROS 2 domain that no other test has."""
    folder = Path(tempfile.mkdtemp(prefix="ag-"))
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(folder))
    monkeypatch.setenv("ROS_DOMAIN_ID", str(DOMAIN))
    for name in ("LIVEKIT_URL", "LIVEKIT_TOKEN"):
        monkeypatch.delenv(name, raising=False)
    yield
    shutil.rmtree(folder)


@pytest.mark.parametrize(
    "lanes, expected",
    [
        ((), None),
        (("ros2",), MotionModeOptions(ros2=True)),
        (("rosbridge",), MotionModeOptions(rosbridge_port=9090)),
        (("rosbridge:0", "ros2"), MotionModeOptions(True, 0)),
    ],
)
def test_lanes(lanes: tuple[str, ...], expected: MotionModeOptions | None) -> None:
    assert parse_motion_modes(lanes) == expected


@pytest.mark.parametrize("lanes", [("ros1",), ("ros2:5",), ("rosbridge:",), ("rosbridge:-1",), ("ros2", "ros2")])
def test_other_lanes(lanes: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*ROBOT, *(word for lane in lanes for word in ("--motion-modes", lane))]) == 2
    err = capsys.readouterr().err
    assert err.startswith("asimov robot: --motion-modes") and err.count("\n") == 1


def test_both_lanes(capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("cyclonedds", reason="needs Cyclone DDS: pip install 'asimov-gym[ros2]'")
    pytest.importorskip("websockets", reason="needs websockets: pip install 'asimov-gym[rosbridge]'")
    assert main([*ROBOT, "--motion-modes", "ros2", "--motion-modes", "rosbridge:0"]) == 0
    out = capsys.readouterr().out
    assert re.search(rf"^  ROS 2 +domain {DOMAIN} on 127\.0\.0\.1, .*rmw_cyclonedds_cpp.*no answer", out, re.MULTILINE)
    assert re.search(r"^  rosbridge +ws://127\.0\.0\.1:\d+$", out, re.MULTILINE)


def test_a_client_of_the_service(tmp_path: Path) -> None:
    sync = pytest.importorskip("websockets.sync.client", reason="needs websockets: pip install 'asimov-gym[rosbridge]'")
    robot = SimulatedRobot(clock=WallClock())
    options = MotionModeOptions(rosbridge_port=0)
    service = RobotService(robot, recording=tmp_path / "run.mcap", motion_modes=options)
    with service:
        kind, address = service.motion_modes.connect_lines()[0]
        assert kind == "rosbridge"
        with sync.connect(address) as client:
            command = {"action_desc": "JOINT_DEFAULT"}
            call = {"op": "call_service", "service": "/aimdk_5Fmsgs/srv/SetMcAction", "args": {"command": command}}
            client.send(json.dumps(call))
            assert json.loads(client.recv(timeout=5))["values"]["response"]["status"]["value"] == 1
        end = time.monotonic() + 5.0
        while (status := service.status())["state"] != "STAND" and time.monotonic() < end:
            time.sleep(0.01)
        assert status["state"] == "STAND" and status["controller"] == "motion modes"
        assert status["commands"]["taken"] == {"motion_mode": 1}


@pytest.mark.parametrize(
    "lane, package, extra", [("ros2", "cyclonedds", "ros2"), ("rosbridge:0", "websockets", "rosbridge")]
)
def test_a_missing_package_is_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], lane: str, package: str, extra: str
) -> None:
    for name in list(sys.modules):
        if name.split(".")[0] == package or name.startswith(f"asimov_gym.edge.transports.{extra}"):
            monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, package, None)
    assert main([*ROBOT, "--motion-modes", lane]) == 2
    err = capsys.readouterr().err
    assert f"pip install 'asimov-gym[{extra}]'" in err and err.count("\n") == 1


def test_lockstep_has_no_lanes(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*ROBOT, "--lockstep", "--motion-modes", "ros2"]) == 2
    assert "leave --motion-modes out" in capsys.readouterr().err
