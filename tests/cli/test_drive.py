"""`asimov drive`: scripts in lockstep, keys through a pseudo-terminal, and the exit codes of the command."""

from __future__ import annotations

import os
import pty
import socket
import subprocess
import sys
import termios
from collections.abc import Iterator
from pathlib import Path

import pytest

from asimov_gym.assets import asset_path
from asimov_gym.cli import main, scripted_drive
from asimov_gym.cli.drive_script import parse_script
from asimov_gym.cli.keyboard import Keyboard
from asimov_gym.cli.keyboard_drive import HELP, KeyboardDrive
from asimov_gym.cli.scripted_drive import DriveFailed, Lockstep, RealTime, ScriptedDrive
from asimov_gym.edge import Dialect, Session, SimulatedRobot, connect
from asimov_gym.edge.transports.facts_server import FactsServer
from asimov_gym.edge.transports.udp import UdpLane
from asimov_gym.edge.wire import cloud_pb2
from asimov_gym.firmware import State, WallClock
from asimov_gym.policy import PolicyRunner, load_policy


@pytest.fixture(scope="module")
def policy() -> PolicyRunner:
    return load_policy(asset_path("policies", "asimov_walk.onnx"))


@pytest.fixture
def robot(policy: PolicyRunner) -> SimulatedRobot:
    return SimulatedRobot(policy)


@pytest.fixture(params=list(Dialect), ids=lambda dialect: dialect.value)
def session(robot: SimulatedRobot, request: pytest.FixtureRequest) -> Iterator[Session]:
    with connect(robot, "driver", dialect=request.param) as session:
        yield session


# -- scripts -----------------------------------------------------------------------------------------


def test_a_script_is_walked(robot: SimulatedRobot, session: Session) -> None:
    lines: list[str] = []
    drive = ScriptedDrive(session, Lockstep(robot), say=lines.append)
    drive.run(parse_script("stand for 3; velocity 0.4 0 0 for 3"))
    assert robot.firmware.state is State.POLICY
    start = robot.physics.read().base_position[0, 0]
    robot.advance(1.0)
    assert 0.2 < robot.physics.read().base_position[0, 0] - start < 0.6  # still at about 0.4 m/s
    drive.run(parse_script("stop for 1; damp for 0.5"))
    assert robot.firmware.state is State.DAMP
    assert [line.split(" s  ", 1)[1][:8] for line in lines[:2]] == ["stand fo", "velocity"]
    assert "done: DAMP" in lines[-1]


def test_velocity_in_damp_fails_with_advice(robot: SimulatedRobot, session: Session) -> None:
    with pytest.raises(DriveFailed, match="no effect in DAMP; let the robot stand first"):
        ScriptedDrive(session, Lockstep(robot)).run(parse_script("velocity 0.2 0 0"))


def test_a_fault_ends_the_script(robot: SimulatedRobot, session: Session) -> None:
    def look(line: str) -> None:
        if robot.firmware.state is State.POLICY:
            robot.firmware.faults.heat("L_Knee", 85.0)

    with pytest.raises(DriveFailed, match=r"MOTOR_OVERTEMP \(error_flags 0x9\)"):
        ScriptedDrive(session, Lockstep(robot), show=look).run(parse_script("stand for 3; velocity 0.2 0 0 for 3"))


def test_damp_is_sent_to_a_faulty_robot_all_the_same(robot: SimulatedRobot, session: Session) -> None:
    robot.firmware.faults.raise_alert("FALL_DETECTED")
    robot.advance(0.1)
    with pytest.raises(DriveFailed, match="FALL_DETECTED"):
        ScriptedDrive(session, Lockstep(robot)).run(parse_script("damp for 0.2"))
    assert robot.edge.tally.accepted["mode"] == 1


def test_somebody_elses_damp_ends_the_script(robot: SimulatedRobot, session: Session) -> None:
    def look(line: str) -> None:
        if robot.clock.now_us() > 4_000_000:  # well into the walk
            with connect(robot, "somebody") as other:
                other.damp()

    with pytest.raises(DriveFailed, match=r"left MOVE during velocity 0.2 0 0 for 3: it is in DAMP"):
        ScriptedDrive(session, Lockstep(robot), show=look).run(parse_script("stand for 3; velocity 0.2 0 0 for 3"))


def test_a_robot_without_a_policy_does_not_follow() -> None:
    robot = SimulatedRobot()
    with connect(robot) as session, pytest.raises(DriveFailed, match="no policy to walk with"):
        ScriptedDrive(session, Lockstep(robot)).run(parse_script("stand for 3; velocity 0.2 0 0"))


def test_a_closed_lane_is_a_lost_link(robot: SimulatedRobot, session: Session) -> None:
    session.on_lost("the room is gone")
    with pytest.raises(DriveFailed, match="link lost: the room is gone"):
        ScriptedDrive(session, Lockstep(robot)).run(parse_script("stand"))


def test_silence_is_a_lost_link(robot: SimulatedRobot, monkeypatch: pytest.MonkeyPatch) -> None:
    """In lockstep nobody advances the robot here, so real time passes without telemetry."""
    monkeypatch.setattr(scripted_drive, "LOST", 0.3)
    with connect(robot) as session, pytest.raises(DriveFailed, match=r"link lost: no telemetry for 0.3 s"):
        ScriptedDrive(session, RealTime()).run(parse_script("wait 4"))


def test_a_script_can_be_stopped(robot: SimulatedRobot, session: Session) -> None:
    ScriptedDrive(session, Lockstep(robot), stopped=lambda: robot.clock.now_us() > 1_000_000).run(
        parse_script("stand for 60; damp")
    )
    assert robot.firmware.state is State.STAND and robot.clock.now_us() < 1_200_000


# -- keys --------------------------------------------------------------------------------------------


@pytest.fixture
def terminal() -> Iterator[tuple[int, int]]:
    """The two ends of a pseudo-terminal: the person's, the program's."""
    person, program = pty.openpty()
    yield person, program
    os.close(person)
    os.close(program)


def test_keys_by_name(terminal: tuple[int, int]) -> None:
    person, program = terminal
    with Keyboard(program) as keyboard:
        os.write(person, b"\x1b[A\x1b[BsQ \x1b[5~\x1bOF\x1b[15~\n")
        pressed = [keyboard.key(0.5) for _ in range(9)]
        assert pressed == ["up", "down", "s", "q", "space", "page up", "end", None, None]
        os.write(person, b"\r")
        assert keyboard.key(0.5) == "enter"
        assert keyboard.key(0.01) is None


def test_the_terminal_is_put_back(terminal: tuple[int, int]) -> None:
    _, program = terminal
    before = termios.tcgetattr(program)
    with pytest.raises(RuntimeError), Keyboard(program):
        assert not termios.tcgetattr(program)[3] & termios.ECHO
        raise RuntimeError
    assert termios.tcgetattr(program) == before


def test_keys_walk_the_robot(robot: SimulatedRobot, session: Session) -> None:
    said: list[str] = []
    shown: list[str] = []
    drive = KeyboardDrive(session, shown.append, said.append)

    def press(*keys: str, seconds: float = 0.2) -> None:
        for key in keys:
            drive.press(key)
            drive.look()
        robot.advance(seconds)
        drive.look()

    press("up")
    assert said and "DAMP" in said[-1] and drive.velocity == (0.0, 0.0, 0.0)
    press("s", seconds=3.0)
    press("up", "w", "left", "a")
    assert drive.velocity == (0.2, 0.1, 0.2)
    assert robot.firmware.state is State.POLICY
    assert robot.firmware.snapshot.velocity.tolist() == pytest.approx([0.2, 0.1, 0.2])
    assert shown[-1].startswith("vx +0.2  vy +0.1 m/s  yaw +0.2 rad/s   MOVE")
    press("0")
    assert robot.firmware.state is State.POLICY and not robot.firmware.snapshot.velocity.any()
    press("down", "?", "f")
    assert drive.velocity == (-0.1, 0.0, 0.0)
    press("space", seconds=0.2)
    assert robot.firmware.state is State.DAMP and drive.velocity == (0.0, 0.0, 0.0)


def test_velocity_stops_at_the_dialects_limits(robot: SimulatedRobot) -> None:
    with connect(robot, dialect=Dialect.IO) as session:
        drive = KeyboardDrive(session, lambda line: None, lambda line: None)
        session.stand()
        robot.advance(1.0)
        for _ in range(10):
            drive.press("up")
            drive.press("d")
            drive.press("right")
        assert drive.velocity == (0.4, -0.4, -0.8)


def test_a_fault_is_said_once_and_the_velocity_forgotten(robot: SimulatedRobot, session: Session) -> None:
    said: list[str] = []
    drive = KeyboardDrive(session, lambda line: None, said.append)
    session.stand()
    robot.advance(3.0)
    drive.press("up")
    robot.advance(0.2)
    drive.look()
    robot.firmware.faults.raise_alert("FALL_DETECTED")
    for _ in range(3):
        robot.advance(0.2)
        drive.look()
    assert [line for line in said if "FALL_DETECTED" in line] == said[-1:]
    assert drive.velocity == (0.0, 0.0, 0.0)


def test_keys_until_q(robot: SimulatedRobot, session: Session, terminal: tuple[int, int]) -> None:
    person, program = terminal
    said: list[str] = []
    with Keyboard(program) as keyboard:
        os.write(person, b"sq")
        KeyboardDrive(session, lambda line: None, said.append).run(keyboard)
    robot.advance(0.01)
    assert said == [HELP] and robot.firmware.state is State.STAND


# -- the command -------------------------------------------------------------------------------------


@pytest.fixture
def ports() -> tuple[int, int]:
    """A free UDP port and a TCP port on which nothing listens."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp, socket.socket() as tcp:
        udp.bind(("127.0.0.1", 0))
        tcp.bind(("127.0.0.1", 0))
        return udp.getsockname()[1], tcp.getsockname()[1]


@pytest.fixture
def served(policy: PolicyRunner, ports: tuple[int, int]) -> Iterator[list[str]]:
    """A robot in real time with a UDP lane; gives the flags that reach it."""
    robot = SimulatedRobot(policy, WallClock())
    with UdpLane(robot.edge, 0, state_port=ports[0]) as lane, FactsServer(0) as facts, robot:
        yield [
            *("--target", f"udp://127.0.0.1:{lane.control_port}"),
            *("--state-port", str(ports[0]), "--facts-port", str(facts.port)),
        ]


def test_drive_over_udp(served: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["drive", "stand for 0.6; stop for 0.2; damp", *served]) == 0
    out = capsys.readouterr()
    assert "done: DAMP" in out.out and out.err == ""


def test_drive_fails_with_1(
    served: list[str], capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scripted_drive, "PATIENCE", 0.4)
    file = tmp_path / "moves.txt"
    file.write_text("# from DAMP\nvelocity 0.1 0 0\n", encoding="utf-8")
    assert main(["drive", "--file", str(file), *served]) == 1
    error = capsys.readouterr().err
    assert "no effect in DAMP" in error and error.count("\n") == 1


def test_a_robot_without_the_simulators_mark_is_refused(
    policy: PolicyRunner, ports: tuple[int, int], capsys: pytest.CaptureFixture[str]
) -> None:
    robot = SimulatedRobot(policy, WallClock())
    real = {"robot_model": "asimov_1", "robot_os_version": "0.2.0"}
    with UdpLane(robot.edge, 0, state_port=ports[0]) as lane, FactsServer(0, document=lambda: real) as facts, robot:
        flags = [
            *("--target", f"udp://127.0.0.1:{lane.control_port}"),
            *("--state-port", str(ports[0]), "--facts-port", str(facts.port)),
        ]
        assert main(["drive", "stand", *flags]) == 2
        error = capsys.readouterr().err
        assert "--real" in error and error.count("\n") == 1
        assert robot.edge.tally.packets == 0  # nothing was sent to it
        assert main(["drive", "stand", "--real", *flags]) == 0
    assert robot.firmware.state is State.STAND


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (["stand", "--facts-port", "{free}"], "no robot answers at http://127.0.0.1:{free}"),
        (["stand", "--target", "udp://127.0.0.1:99999"], "99999"),
        (["stand", "--target", "serial:1"], "udp://HOST"),
        (["stand", "--state-port", "0", "--facts-port", "{free}"], "state_port must be from 1 to 65535"),
        (["stand", "--livekit", "ws://127.0.0.1:1"], "LIVEKIT_TOKEN"),
        (["dance"], "step 1, 'dance'"),
        (["stand", "--file", "moves.txt"], "not both"),
        (["--file", "no/such/moves.txt"], "no/such/moves.txt: No such file"),
    ],
)
def test_what_cannot_be_tried_is_one_line_and_2(
    flags: list[str],
    words: str,
    ports: tuple[int, int],
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv("LIVEKIT_TOKEN", raising=False)
    assert main(["drive", *(flag.format(free=ports[1]) for flag in flags)]) == 2
    error = capsys.readouterr().err
    assert words.format(free=ports[1]) in error and error.count("\n") == 1


def test_the_keyboard_needs_a_terminal() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "asimov_gym.cli", "drive"],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 2
    assert "no terminal" in done.stderr and done.stderr.count("\n") == 1


def test_telemetry_of_an_unknown_fault_is_told() -> None:
    from asimov_gym.cli.telemetry_line import fault_names, telemetry_line

    assert fault_names(0) == [] and fault_names(0x1) == []
    assert fault_names(0x101) == ["FALL_DETECTED"]
    assert fault_names(1 << 7) == ["unknown"]  # no alert has number 6
    assert telemetry_line(cloud_pb2.EdgeTelemetry(error_flags=1)).endswith("FAULT latched")
