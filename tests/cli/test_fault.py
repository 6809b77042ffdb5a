"""`asimov fault` against the console of a robot in this process."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from asimov_gym.cli import main
from asimov_gym.cli.console_client import console_path
from asimov_gym.cli.fault import FaultRequest
from asimov_gym.edge import SimulatedRobot
from asimov_gym.edge.console import Console
from asimov_gym.edge.console_actions import ACTIONS


@pytest.fixture
def runtime(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A runtime folder of the test's own, with a short name: a socket's path has about a hundred characters."""
    folder = Path(tempfile.mkdtemp(prefix="ag-"))
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(folder))
    yield folder
    shutil.rmtree(folder)


@pytest.fixture(scope="module")
def robot() -> SimulatedRobot:
    return SimulatedRobot()


@pytest.fixture
def console(robot: SimulatedRobot, runtime: Path) -> Iterator[Console]:
    with Console(robot, console_path("bench-1")) as console:
        yield console
    robot.firmware.faults.clear()


@pytest.mark.parametrize(
    ("words", "reply"),
    [
        ("push --force 150 0 0 --seconds 0.1", "push of 150 N on waist_yaw_link for 0.1 s"),
        ("push --force 0 -3 4 --body pelvis_link", "push of 5 N on pelvis_link for 0.1 s"),
        ("heat L_Knee 55.5", "motor L_Knee at 55.5 °C"),
        ("heat 3 55", "motor 3 at 55 °C"),
        ("bus left_leg", "bus left_leg silent, until it is cleared"),
        ("bus 0 --seconds 2", "bus 0 silent for 2 s"),
        ("motor Neck_Yaw --seconds 2", "motor Neck_Yaw silent for 2 s"),
        ("overcurrent R_Knee 20", "motor R_Knee draws 20 A more, until it is cleared"),
        ("delay-policy 40", "inference takes 40 ms longer, until it is cleared"),
        ("fail-policy --seconds 1", "inference fails for 1 s"),
        ("battery 50", "battery at 50 %"),
        ("imu --seconds 0.5", "imu silent for 0.5 s"),
        ("encoder L_Elbow", "encoder error on motor L_Elbow, until it is cleared"),
        ("alert motor_drv_fault --source 4", "alert MOTOR_DRV_FAULT (warning), source 4"),
        ("clear", "injected faults ended: there were none"),
        ("gantry hoist", "gantry: hoist"),
        ("gantry auto", "gantry: auto"),
        ("e-stop press", "emergency stop pressed"),
        ("e-stop release", "emergency stop released; the robot is in DAMP"),
    ],
)
def test_each_request_is_done_and_said(
    console: Console, capsys: pytest.CaptureFixture[str], words: str, reply: str
) -> None:
    assert main(["fault", *words.split(), "--name", "bench-1"]) == 0
    out = capsys.readouterr()
    assert out.out == f"{reply}\n" and out.err == ""


def test_restart(console: Console, robot: SimulatedRobot, capsys: pytest.CaptureFixture[str]) -> None:
    robot.firmware.faults.raise_alert("FALL_DETECTED")
    boots = robot.firmware.boots
    assert main(["fault", "restart", "--name", "bench-1"]) == 0
    assert capsys.readouterr().out == f"the firmware restarted, boot {boots + 1}\n"
    assert not robot.firmware.alerts.latched


def test_status_is_json(console: Console, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["fault", "status", "--name", "bench-1"]) == 0
    assert json.loads(capsys.readouterr().out)["state"] == "DAMP"


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("heat L_Kne 55", "L_Knee"),
        ("heat 25 55", "24 Neck_Yaw"),
        ("heat L_Knee 1e6", "between -50 and 300"),
        ("heat L_Knee nan", "finite number"),
        ("bus tail", "left_leg"),
        ("alert NONSENSE", "FALL_DETECTED"),
        ("push --force 1e9 0 0", "at most 5000 N"),
        ("push --force 1 0 0 --body tail", "pelvis_link"),
        ("imu --seconds -1", "above 0 s"),
        ("battery 200", "between 0 and 100"),
    ],
)
def test_a_refusal_is_one_line_and_2(
    console: Console, capsys: pytest.CaptureFixture[str], words: str, expected: str
) -> None:
    assert main(["fault", *words.split(), "--name", "bench-1"]) == 2
    out = capsys.readouterr()
    assert expected in out.err and out.err.count("\n") == 1 and out.out == ""


@pytest.mark.parametrize(("name", "cure"), [("asimov", "asimov robot\n"), ("other", "asimov robot --name other\n")])
def test_without_a_robot_it_says_how_to_start_one(
    runtime: Path, capsys: pytest.CaptureFixture[str], name: str, cure: str
) -> None:
    assert main(["fault", "clear", "--name", name]) == 2
    error = capsys.readouterr().err
    assert f"no robot named '{name}' runs here" in error and error.endswith(cure) and error.count("\n") == 1


def test_a_killed_robot_is_no_robot(robot: SimulatedRobot, runtime: Path, capsys: pytest.CaptureFixture[str]) -> None:
    import socket

    path = console_path("asimov")
    path.parent.mkdir(mode=0o700)
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as dead:
        dead.bind(str(path))
    assert main(["fault", "clear"]) == 2
    assert "no robot named 'asimov' runs here" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["", "a b", "../x", "x" * 33, "-x"])
def test_a_name_that_is_none(runtime: Path, capsys: pytest.CaptureFixture[str], name: str) -> None:
    assert main(["fault", "clear", f"--name={name}"]) == 2
    assert "1 to 32 letters" in capsys.readouterr().err


def test_without_a_runtime_folder_the_socket_lies_among_the_users_temporary_files(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    assert console_path("asimov") == tmp_path / f"asimov-gym-{os.getuid()}" / "asimov.sock"
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "gone"))
    assert console_path("asimov") == tmp_path / f"asimov-gym-{os.getuid()}" / "asimov.sock"


def test_the_command_line_offers_every_action_of_the_console() -> None:
    offered = {request.__origin__.do for request in FaultRequest.__args__}
    assert offered == {"status", *ACTIONS}
