"""The console: what it does, what it refuses, and who may open it."""

from __future__ import annotations

import json
import os
import shutil
import socket
import stat
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from asimov_gym.edge import Code, SimulatedRobot, connect
from asimov_gym.edge.console import MAX_CONNECTIONS, MAX_LINE_BYTES, Console
from asimov_gym.edge.transports import TransportError
from asimov_gym.firmware import AlertId, State
from asimov_gym.robot.joints import MOTOR_NAMES


@pytest.fixture
def path() -> Iterator[Path]:
    """Of a socket: short, since the system allows about a hundred characters."""
    folder = Path(tempfile.mkdtemp(prefix="ag-"))
    yield folder / "console" / "test.sock"
    shutil.rmtree(folder)


@pytest.fixture
def console(robot: SimulatedRobot, path: Path) -> Iterator[Console]:
    with Console(robot, path) as console:
        yield console


@pytest.fixture
def ask(robot: SimulatedRobot, path: Path) -> Callable[..., dict[str, Any]]:
    """One request without the socket in between."""
    console = Console(robot, path)

    def ask(do: str, **arguments: object) -> dict[str, Any]:
        return console.answer(json.dumps({"do": do, **arguments}).encode())

    return ask


def talk(path: Path, *lines: bytes) -> list[bytes]:
    """Send lines over the socket, return the lines that come back before it closes or falls silent."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as caller:
        caller.settimeout(2.0)
        caller.connect(str(path))
        caller.sendall(b"".join(line + b"\n" for line in lines))
        caller.shutdown(socket.SHUT_WR)
        with caller.makefile("rb") as stream:
            return stream.readlines()


# -- what it does ------------------------------------------------------------------------------------


def test_status_says_what_the_robot_does(robot: SimulatedRobot, ask: Callable[..., dict[str, Any]]) -> None:
    with connect(robot, "walker") as session:
        session.stand()
        robot.advance(2.5)
        session.velocity(0.3)
        robot.advance(0.1)
        status = ask("status")["status"]
    assert status["state"] == "MOVE/POLICY"
    assert status["controller"] == "walker"
    assert status["commands"]["taken"] == {"mode": 1, "velocity": 1}
    assert status["uptime_s"] == pytest.approx(2.6)
    assert (status["error_flags"], status["latched"], status["e_stop"], status["alerts"]) == (0, False, False, [])
    assert status["lateness_ms"] is None and status["realtime_factor"] is None  # lockstep


def test_push_moves_the_robot(robot: SimulatedRobot, ask: Callable[..., dict[str, Any]]) -> None:
    robot.advance(0.5)
    before = robot.physics.read().base_velocity[0].copy()
    assert "200 N" in ask("push", force=[200, 0, 0], seconds=0.1)["done"]
    robot.advance(0.1)
    change = robot.physics.read().base_velocity[0] - before
    assert change[0] > 0.2 and abs(change[1]) < 0.1


def test_heat_latches_damp_and_restart_clears_it(robot: SimulatedRobot, ask: Callable[..., dict[str, Any]]) -> None:
    with connect(robot) as session:
        session.stand()
        robot.advance(2.5)
        ask("heat", motor="L_Knee", celsius=85)
        robot.advance(0.01)
        assert robot.firmware.state is State.DAMP and robot.firmware.alerts.latched
        assert any("MOTOR_OVERTEMP critical source 3" in alert for alert in ask("status")["status"]["alerts"])
        ask("heat", motor=3, celsius=30)
        assert ask("restart")["done"].endswith("boot 2")
        robot.advance(0.01)
        assert not robot.firmware.alerts.latched
        session.stand()
        robot.advance(0.01)
    assert robot.firmware.state is State.STAND


def test_restart_is_one_event(robot: SimulatedRobot, ask: Callable[..., dict[str, Any]]) -> None:
    with connect(robot) as session:
        ask("restart")
        console_events = [event for event in session.events() if event.error.code == Code.CONSOLE.value]
    assert len(console_events) == 1


def test_emergency_stop_holds_damp(robot: SimulatedRobot, ask: Callable[..., dict[str, Any]]) -> None:
    with connect(robot) as session:
        session.stand()
        robot.advance(0.1)
        assert "error" not in ask("e_stop", to="press")
        session.stand()
        robot.advance(0.1)
        assert robot.firmware.state is State.DAMP and ask("status")["status"]["e_stop"]
        ask("e_stop", to="release")
        session.stand()
        robot.advance(0.1)
    assert robot.firmware.state is State.STAND


def test_gantry_by_hand(robot: SimulatedRobot, ask: Callable[..., dict[str, Any]]) -> None:
    robot.advance(0.5)
    assert robot.firmware.snapshot.gantry_force > 100.0  # it boots hanging
    ask("gantry", to="off")
    robot.advance(0.01)
    assert robot.firmware.snapshot.gantry_force == 0.0
    assert ask("status")["status"]["gantry"]["setting"] == "off"


@pytest.mark.parametrize(
    ("request_", "ongoing"),
    [
        ({"do": "drop_bus", "bus": "left_leg"}, "bus left_leg"),
        ({"do": "drop_bus", "bus": 1, "seconds": 2}, "bus right_leg"),
        ({"do": "drop_motor", "motor": "Waist_Yaw"}, "motor Waist_Yaw"),
        ({"do": "overcurrent", "motor": 0, "amperes": 30}, "overcurrent L_Hip_Pitch"),
        ({"do": "encoder", "motor": "R_Knee"}, "encoder R_Knee"),
        ({"do": "imu"}, "imu"),
        ({"do": "delay_policy", "ms": 40}, "policy delay"),
        ({"do": "fail_policy"}, "policy failure"),
        ({"do": "push", "force": [1, 2, 3]}, "push"),
    ],
)
def test_faults_last_until_clear(ask: Callable[..., dict[str, Any]], request_: dict[str, Any], ongoing: str) -> None:
    assert "error" not in ask(**request_)
    assert ask("status")["status"]["injected"] == [ongoing]
    assert ongoing in ask("clear")["done"]
    assert ask("status")["status"]["injected"] == []


def test_battery(robot: SimulatedRobot, ask: Callable[..., dict[str, Any]]) -> None:
    ask("battery", percent=15)
    robot.advance(1.0)
    assert AlertId.BMS_LOW_SOC in {alert.id for alert in robot.firmware.snapshot.alerts}


def test_alert_by_name_in_any_case(robot: SimulatedRobot, ask: Callable[..., dict[str, Any]]) -> None:
    assert "FALL_DETECTED (critical)" in ask("alert", alert="fall_detected")["done"]
    robot.advance(0.005)
    assert robot.firmware.snapshot.error_flags == 0x101


def test_every_action_is_an_event(robot: SimulatedRobot, ask: Callable[..., dict[str, Any]]) -> None:
    with connect(robot) as session:
        done = ask("heat", motor="L_Knee", celsius=40)["done"]
        events = [event.error for event in session.events()]
    assert [(event.code, event.message) for event in events] == [(Code.CONSOLE.value, done)]


# -- what it refuses ---------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def untouched() -> SimulatedRobot:
    """One robot for all the requests that must change nothing."""
    return SimulatedRobot()


@pytest.mark.parametrize(
    ("request_", "words"),
    [
        ({"do": "dance"}, ["dance", "restart", "status"]),
        ({"do": "heat", "motor": "L_Kne", "celsius": 85}, ["L_Kne", "L_Knee"]),
        ({"do": "heat", "motor": 25, "celsius": 85}, ["25", "L_Knee"]),
        ({"do": "heat", "motor": "L_Knee"}, ["heat", "celsius"]),
        ({"do": "heat", "motor": "L_Knee", "celsius": 1000}, ["celsius", "1000", "300"]),
        ({"do": "heat", "motor": "L_Knee", "celsius": "hot"}, ["celsius", "finite number", "'hot'"]),
        ({"do": "heat", "motor": "L_Knee", "celsius": True}, ["celsius", "True"]),
        ({"do": "heat", "motor": None, "celsius": 20}, ["motor", "None"]),
        ({"do": "heat", "motor": "L_Knee", "celsius": 85, "fast": 1}, ["fast", "motor, celsius"]),
        ({"do": "push", "force": [1, 2]}, ["force", "3 numbers"]),
        ({"do": "push", "force": [1, 2, "3"]}, ["force", "'3'"]),
        ({"do": "push", "force": [9e3, 0, 0]}, ["force", "5000", "9000"]),
        ({"do": "push", "force": [1, 2, 3], "body": "tail"}, ["tail", "pelvis_link"]),
        ({"do": "push", "force": [1, 2, 3], "seconds": 0}, ["above 0"]),
        ({"do": "drop_bus", "bus": "tail"}, ["tail", "left_leg"]),
        ({"do": "delay_policy", "ms": -1}, ["ms", "-1"]),
        ({"do": "gantry", "to": "up"}, ["up", "hoist"]),
        ({"do": "e_stop", "to": "smash"}, ["smash", "press"]),
        ({"do": "battery", "percent": 101}, ["101", "100"]),
        ({"do": "alert", "alert": "NONSENSE"}, ["NONSENSE", "FALL_DETECTED"]),
        ({"do": "status", "all": True}, ["all"]),
        ({"do": "clear", "what": "imu"}, ["what", "no arguments"]),
        ({"do": 7}, ["do"]),
        ({"please": "status"}, ["do"]),
        ([1, 2], ["object"]),
        ("status", ["object"]),
    ],
)
def test_bad_requests_name_what_is_wrong_and_change_nothing(
    untouched: SimulatedRobot, request_: object, words: list[str]
) -> None:
    robot, console = untouched, Console(untouched, Path("unused.sock"))
    temperature = robot.firmware.motors.temperature.copy()
    with connect(robot) as session:
        reply = console.answer(json.dumps(request_).encode())
        assert list(session.events()) == []
    assert set(reply) == {"error"}
    for word in words:
        assert word in reply["error"], reply
    assert not robot.firmware.faults.ongoing and not robot.firmware.alerts.latched
    np.testing.assert_array_equal(robot.firmware.motors.temperature, temperature)
    assert robot.firmware.boots == 1


@pytest.mark.parametrize(
    "line",
    [b"", b"\n", b"\xff\xfe", b"{", b"[" * 10_000, b"1" * 5000, b'{"do": "heat", "motor": 0, "celsius": NaN}', b"null"],
)
def test_garbage_is_answered(untouched: SimulatedRobot, line: bytes) -> None:
    assert set(Console(untouched, Path("unused.sock")).answer(line)) == {"error"}


# -- the socket --------------------------------------------------------------------------------------


def test_requests_over_the_socket(console: Console, path: Path) -> None:
    replies = [json.loads(line) for line in talk(path, b'{"do": "status"}', b"garbage", b'{"do": "clear"}')]
    assert [set(reply) for reply in replies] == [{"status"}, {"error"}, {"done"}]


def test_a_long_line_ends_the_connection(console: Console, path: Path) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as caller:
        caller.settimeout(2.0)
        caller.connect(str(path))
        caller.sendall(b"x" * (MAX_LINE_BYTES + 1))
        with caller.makefile("rb") as stream:
            assert b"at most" in stream.readline()
    assert b"status" in talk(path, b'{"do": "status"}')[0]


def test_only_so_many_callers_at_a_time(console: Console, path: Path) -> None:
    callers = [socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) for _ in range(MAX_CONNECTIONS)]
    try:
        for caller in callers:
            caller.settimeout(2.0)
            caller.connect(str(path))
            caller.sendall(b'{"do": "clear"}\n')
            assert caller.recv(1000)
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as late:
            late.settimeout(2.0)
            late.connect(str(path))
            assert late.recv(1) == b""  # closed at once
    finally:
        for caller in callers:
            caller.close()


def test_only_the_owner_can_open_it(console: Console, path: Path) -> None:
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700


def test_another_user_is_turned_away(console: Console, path: Path) -> None:
    """Even where somebody has opened the folder's and the socket's rights."""
    if not sys.platform.startswith("linux") or os.geteuid() != 0:
        pytest.skip("needs Linux, which tells who calls, and root, to become somebody else")
    for place, mode in ((path.parent.parent, 0o755), (path.parent, 0o755), (path, 0o666)):
        place.chmod(mode)
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as stranger:
        stranger.settimeout(2.0)
        os.seteuid(65534)
        try:
            stranger.connect(str(path))
        finally:
            os.seteuid(0)
        assert stranger.recv(1) == b""  # closed at once, unheard
    assert b"status" in talk(path, b'{"do": "status"}')[0]


def test_a_folder_that_others_may_enter_is_refused(robot: SimulatedRobot, path: Path) -> None:
    path.parent.mkdir(mode=0o755)
    with pytest.raises(TransportError, match="chmod 700"):
        Console(robot, path).start()
    assert not path.exists()


def test_a_link_in_the_place_of_the_folder_is_refused(robot: SimulatedRobot, path: Path) -> None:
    elsewhere = path.parent.parent / "elsewhere"
    elsewhere.mkdir(mode=0o700)
    path.parent.symlink_to(elsewhere)
    with pytest.raises(TransportError):
        Console(robot, path).start()


def test_a_living_robots_name_is_refused(robot: SimulatedRobot, console: Console, path: Path) -> None:
    with pytest.raises(TransportError, match="'test' already runs"):
        Console(robot, path).start()
    assert b"status" in talk(path, b'{"do": "status"}')[0]  # the living one is unharmed


def test_a_dead_robots_socket_is_in_nobodys_way(robot: SimulatedRobot, path: Path) -> None:
    path.parent.mkdir(mode=0o700)
    dead = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    dead.bind(str(path))
    dead.close()  # leaves the file, as a kill does
    with Console(robot, path):
        assert b"status" in talk(path, b'{"do": "status"}')[0]


def test_stop_leaves_no_socket_and_no_thread(robot: SimulatedRobot, path: Path) -> None:
    before = threading.active_count()
    console = Console(robot, path)
    for _ in range(3):
        console.start()
        assert talk(path, b'{"do": "clear"}')
        console.stop()
        console.stop()
        assert not path.exists()
    for thread in threading.enumerate():
        if thread.name == "console-caller":
            thread.join(2.0)
    assert threading.active_count() == before


def test_names_are_those_of_the_motors(ask: Callable[..., dict[str, Any]]) -> None:
    for number, name in enumerate(MOTOR_NAMES):
        assert "error" not in ask("heat", motor=number, celsius=25) and "error" not in ask(
            "heat", motor=name, celsius=25
        )
