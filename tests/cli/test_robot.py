"""`asimov robot`: what a person sees of it, how it ends, and what it refuses."""

from __future__ import annotations

import logging
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from asimov_gym.cli import main
from asimov_gym.cli.console_client import ask, console_path
from asimov_gym.cli.robot import Robot, status_text, summary
from asimov_gym.cli.robot_log import RobotLog, describe_event
from asimov_gym.cli.robot_service import RobotService, RoomOptions, UdpOptions
from asimov_gym.cli.status_line import StatusLine
from asimov_gym.edge import Code, SimulatedRobot, connect
from asimov_gym.edge.events import error
from asimov_gym.edge.transports import TransportError
from asimov_gym.edge.wire import cloud_pb2
from asimov_gym.firmware import WallClock
from asimov_gym.recording import COMMANDS, STATE, SYSTEM, read_recording
from tests import network_namespace


@pytest.fixture(autouse=True)
def runtime(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A runtime folder of the test's own, with a short name, and no room in the environment."""
    folder = Path(tempfile.mkdtemp(prefix="ag-"))
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(folder))
    for name in ("LIVEKIT_URL", "LIVEKIT_TOKEN", "DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    yield folder
    shutil.rmtree(folder)


@pytest.fixture
def busy() -> Iterator[tuple[int, int]]:
    """A UDP and a TCP port that are taken."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp, socket.socket() as tcp:
        udp.bind(("127.0.0.1", 0))
        tcp.bind(("127.0.0.1", 0))
        tcp.listen()
        yield udp.getsockname()[1], tcp.getsockname()[1]


FREE = ("--udp-control-port", "0", "--facts-port", "0", "--udp-state-port", "{state}")


def free_flags() -> list[str]:
    """Flags for ports that are free at the moment."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
        udp.bind(("127.0.0.1", 0))
        return [flag.format(state=udp.getsockname()[1]) for flag in FREE]


# -- a run -------------------------------------------------------------------------------------------


def test_a_robot_in_another_terminal(tmp_path: Path) -> None:
    """Start it, drive it, break it, end it politely; the recording has all of it."""
    file = tmp_path / "run.mcap"
    process = subprocess.Popen(
        [sys.executable, "-m", "asimov_gym.cli", "robot", "--record", str(file), *free_flags()],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        lines: list[str] = []
        while not (lines and "recording" in lines[-1]):
            lines.append(process.stdout.readline())
            assert lines[-1], process.communicate()[1]
        script = next(line for line in lines if line.split()[0] == "script")
        flags = re.findall(r"--\S+ \S+", script)
        assert [flag.split()[0] for flag in flags] == ["--target", "--state-port", "--facts-port"]
        words = [word for flag in flags for word in flag.split()]
        assert main(["drive", "stand for 0.7; stop for 0.3", *words]) == 0
        assert ask("asimov", {"do": "status"})["status"]["commands"]["taken"] == {"mode": 1, "velocity": 1}
        assert main(["fault", "heat", "L_Knee", "85"]) == 0
        time.sleep(0.2)
        process.send_signal(signal.SIGTERM)
        out, err = process.communicate(timeout=30)
    finally:
        process.kill()
        process.wait()
    assert process.returncode == 0, err
    assert err == ""
    for words in ("DAMP -> STAND", "STAND -> MOVE/POLICY", "console: motor L_Knee at 85 °C", "MOTOR_OVERTEMP"):
        assert words in out
    assert re.search(r"^ended in DAMP after .* s: 2 commands taken, 0 dropped$", out, re.MULTILINE)
    assert "\x1b" not in out and "\r" not in out  # no terminal, so nothing that changes in place
    assert not console_path("asimov").exists()
    entries = list(read_recording(file))
    assert sum(entry.topic == COMMANDS for entry in entries) == 2
    modes = {entry.message.fw_mode for entry in entries if isinstance(entry.message, cloud_pb2.EdgeTelemetry)}
    assert modes == {cloud_pb2.FW_MODE_DAMP, cloud_pb2.FW_MODE_STAND, cloud_pb2.FW_MODE_MOVE}


def test_seconds_end_it(capsys: pytest.CaptureFixture[str]) -> None:
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    threads = threading.active_count()
    assert main(["robot", "--seconds", "0.3", *free_flags()]) == 0
    out = capsys.readouterr()
    for kind in ("UDP", "keyboard", "script", "Python", "menlo-sdk", "faults"):
        assert re.search(rf"^  {kind} ", out.out, re.MULTILINE), kind
    assert "ended in DAMP" in out.out and out.err == ""
    assert {number: signal.getsignal(number) for number in handlers} == handlers
    assert threading.active_count() == threads
    assert not logging.getLogger("asimov_gym").handlers


def test_a_lockstep_script_repeats_itself(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    script = "stand for 3; velocity 0.3 0 0.2 for 1; damp for 0.5"
    runs = []
    for run in ("a.mcap", "b.mcap"):
        file = tmp_path / run
        assert main(["robot", "--lockstep", "--script", script, "--record", str(file), "--seed", "7"]) == 0
        runs.append([entry.message.SerializeToString() for entry in read_recording(file, [STATE])])
    assert runs[0] == runs[1] and len(runs[0]) > 40
    out = capsys.readouterr().out
    assert "UDP" not in out and "MOVE/POLICY -> DAMP" in out


def test_a_script_that_fails_is_1(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["robot", "--lockstep", "--script", "velocity 0.3 0 0"]) == 1
    out = capsys.readouterr().out
    assert "script failed: velocity 0.3 0 0 has no effect in DAMP" in out and "VELOCITY_IN_DAMP" in out


def test_a_robot_that_dies_is_1(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    from asimov_gym.firmware import Firmware

    def tick(self: Firmware) -> None:
        raise ZeroDivisionError("broken on purpose")

    monkeypatch.setattr(Firmware, "tick", tick)
    assert main(["robot", "--no-udp"]) == 1
    out = capsys.readouterr()
    assert "ZeroDivisionError: broken on purpose" in out.err
    assert out.err.endswith("asimov robot: the simulated robot died\n")
    assert "ended in DAMP" in out.out


def test_a_recording_that_fails_is_1(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from asimov_gym.recording import Recorder

    monkeypatch.setattr(Recorder, "failure", property(lambda self: "disk full"))
    flags = ["--lockstep", "--seconds", "0.5", "--record", str(tmp_path / "x.mcap")]
    assert main(["robot", *flags]) == 1
    assert "the recording is incomplete: disk full" in capsys.readouterr().err


def test_a_second_interrupt_ends_it_at_once() -> None:
    """The first is being obeyed, but something hangs: here, the command's own loop, which is stopped meanwhile."""
    code = (
        "import time, signal, os\n"
        "from asimov_gym.cli.stop_signals import StopSignals\n"
        "with StopSignals() as signals:\n"
        "    os.kill(os.getpid(), signal.SIGINT)\n"
        "    assert signals.stopped\n"
        "    os.kill(os.getpid(), signal.SIGINT)\n"
        "    time.sleep(60)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=30, check=False)
    assert done.returncode == 128 + signal.SIGINT and "ended at once" in done.stderr


# -- what it refuses ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (["--policy", "no/such.onnx"], ["no/such.onnx"]),
        (["--policy", "{text}"], ["{text}"]),
        (["--policy", "{folder}"], ["python -m train export"]),
        (["--udp-control-port", "70000"], ["--udp-control-port", "65535", "70000"]),
        (["--udp-state-port", "0"], ["--udp-state-port", "1 to 65535"]),
        (["--facts-port", "-1"], ["--facts-port", "-1"]),
        (["--udp-control-port", "{udp}", "--facts-port", "0"], ["--udp-control-port", "{udp}", "in use"]),
        (["--facts-port", "{tcp}"], ["--facts-port", "{tcp}", "in use"]),
        (["--seconds", "0"], ["--seconds", "above 0", "got 0"]),
        (["--seconds", "nan"], ["--seconds", "finite"]),
        (["--seed", "-1"], ["--seed", "-1"]),
        (["--name", "a/b"], ["--name", "a/b"]),
        (["--script", "dance"], ["step 1, 'dance'"]),
        (["--record", "{text}"], ["--record", "nothing recorded is overwritten"]),
        (["--record", "{text}/x.mcap"], ["--record"]),
        (["--livekit", "ws://127.0.0.1:1"], ["LIVEKIT_TOKEN"]),
        (["--token", "abc"], ["--livekit"]),
        (["--camera", "first"], ["--livekit"]),
        (["--lockstep", "--livekit", "ws://127.0.0.1:1", "--token", "abc"], ["--lockstep"]),
    ],
)
def test_what_cannot_be_started_is_one_line_and_2(
    flags: list[str], words: list[str], busy: tuple[int, int], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = tmp_path / "notes.txt"
    text.write_text("no policy", encoding="utf-8")
    filled = {"udp": busy[0], "tcp": busy[1], "text": text, "folder": tmp_path}
    assert main(["robot", *(flag.format(**filled) for flag in flags)]) == 2
    out = capsys.readouterr()
    assert out.err.startswith("asimov robot: ") and out.err.count("\n") == 1
    for word in words:
        assert word.format(**filled) in out.err
    assert "abc" not in out.err  # the token
    assert not console_path("asimov").exists()


def test_a_window_without_a_display_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    if not sys.platform.startswith("linux"):
        pytest.skip("DISPLAY decides on Linux only")
    assert main(["robot", "--view"]) == 2
    assert "no display" in capsys.readouterr().err


@pytest.mark.slow
def test_a_window_opens_and_closes() -> None:
    if shutil.which("xvfb-run") is None:
        pytest.skip("needs a display of its own: install xvfb")
    command = ["xvfb-run", "-a", sys.executable, "-m", "asimov_gym.cli", "robot", "--view", "--no-udp"]
    done = subprocess.run([*command, "--seconds", "1.5"], capture_output=True, text=True, timeout=120, check=False)
    if done.returncode == 2:
        pytest.skip(f"the virtual display cannot be drawn on: {done.stderr.strip()}")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "ended in DAMP" in done.stdout


def test_a_second_robot_of_the_same_name_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with RobotService(SimulatedRobot(), console=console_path("asimov")):
        assert main(["robot", *free_flags()]) == 2
        assert "'asimov' already runs" in capsys.readouterr().err
        assert main(["robot", "--name", "two", "--seconds", "0.1", *free_flags()]) == 0
    assert "asimov fault ... --name two" in capsys.readouterr().out


def test_an_unreachable_room_is_refused_without_its_token() -> None:
    pytest.importorskip("livekit")
    if (reason := network_namespace.skip_reason()) is not None:
        pytest.skip(reason)
    command = [sys.executable, "-m", "asimov_gym.cli", "robot", "--no-udp", "--livekit", "ws://127.0.0.1:9"]
    token = "eyJhbGciOiJIUzI1NiJ9.c2VjcmV0.c2VjcmV0"
    done = network_namespace.run_in_namespace(command, timeout=60, env={"LIVEKIT_TOKEN": token})
    assert done.returncode == 2, done.stderr
    assert "ws://127.0.0.1:9" in done.stderr and done.stderr.count("\n") == 1
    assert token not in done.stdout + done.stderr


def test_an_open_address_is_warned_about(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["robot", "--listen", "0.0.0.0", "--seconds", "0.1", *free_flags()]) == 0
    assert "anyone who reaches this port can drive the robot" in capsys.readouterr().out


def test_a_token_is_in_no_repr() -> None:
    assert "secret" not in repr(Robot(livekit="ws://x", token="secret"))
    assert "secret" not in repr(RoomOptions("ws://x", "secret"))


def test_a_room_may_come_from_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LIVEKIT_URL", "ws://from.environment")
    assert Robot()._room() is None  # an address alone joins nothing
    monkeypatch.setenv("LIVEKIT_TOKEN", "secret")
    assert Robot()._room() == RoomOptions("ws://from.environment", "secret")
    assert Robot(livekit="ws://from.flag")._room() == RoomOptions("ws://from.flag", "secret")
    assert Robot(lockstep=True)._room() is None


# -- the service -------------------------------------------------------------------------------------


def test_a_failed_start_leaves_nothing_open(busy: tuple[int, int], tmp_path: Path, runtime: Path) -> None:
    robot = SimulatedRobot(clock=WallClock())
    threads, file = threading.active_count(), tmp_path / "run.mcap"
    service = RobotService(
        robot, console_path("asimov"), UdpOptions(control_port=busy[0], facts_port=0), recording=file
    )
    with pytest.raises(TransportError, match="udp-control-port"):
        service.start()
    assert threading.active_count() == threads
    assert not console_path("asimov").exists() and not robot.running
    assert list(read_recording(file)) == []  # complete, and empty: the robot never ran
    with pytest.raises(TransportError):  # and again, which a lock left behind would make another error
        service.start()


def test_everybody_sees_the_robots_first_and_last_event(tmp_path: Path) -> None:
    robot = SimulatedRobot(clock=WallClock())
    file = tmp_path / "run.mcap"
    with RobotService(robot, recording=file), connect(robot) as session:
        session.state.wait()
        assert robot.running
    events = [entry.message for entry in read_recording(file, [SYSTEM])]
    codes = [event.error.code for event in events if isinstance(event, cloud_pb2.EdgeEvent)]
    assert codes[0] == Code.BOOT_PROGRESS.value and codes[-1] == Code.SHUTDOWN.value


def test_status_and_lines_of_a_service() -> None:
    robot = SimulatedRobot()
    with RobotService(robot, udp=UdpOptions(0, state_port=9, facts_port=0)) as service:
        robot.advance(0.1)
        status = service.status()
        assert service.udp is not None and status["udp"]["control_port"] == service.udp.control_port
        assert status["recording"] is None
        lines = dict(service.connect_lines())
    assert f'connect("udp://127.0.0.1:{service.udp.control_port}", state_port=9, facts_port=' in lines["Python"]
    assert f"command_port={service.udp.control_port}" in lines["menlo-sdk"]


# -- lines -------------------------------------------------------------------------------------------


def test_the_status_line_says_what_matters() -> None:
    robot = SimulatedRobot()
    with RobotService(robot) as service:
        robot.firmware.faults.raise_alert("FALL_DETECTED")
        robot.edge.e_stop(True)
        robot.advance(0.5)
        line = status_text(service.status())
        assert summary(service.status()) == "ended in DAMP after 0.5 s: 0 commands taken, 0 dropped"
    for words in ("DAMP", "0.5 s simulated", "control: e-stop", "0 taken 0 dropped", "E-STOP", "FAULT 0x101"):
        assert words in line
    assert "FALL_DETECTED" in line and "\n" not in line


def test_news_are_told_and_routine_is_not() -> None:
    change = cloud_pb2.ControllerEvent(previous="", current="gamepad", reason="first_command")
    assert describe_event(cloud_pb2.EdgeEvent(controller=change)) == "control: nobody -> gamepad (first_command)"
    assert describe_event(error(Code.MODE_CHANGE, "DAMP -> STAND")) == "DAMP -> STAND"
    assert "asimov fault restart" in describe_event(error(Code.FAULT_LATCHED, "error_flags 0x101"))
    for code in (Code.BOOT_PROGRESS, Code.OVERLOAD, Code.SHUTDOWN):
        assert describe_event(error(code, "x")) == ""
    assert describe_event(cloud_pb2.EdgeEvent(diagnostics=cloud_pb2.EdgeDiagnostics())) == ""


def test_the_same_warning_comes_once_in_a_while() -> None:
    log = RobotLog(0)
    for factor in (0.5, 0.6):
        log.handle(logging.LogRecord("x", logging.WARNING, "", 0, "overload %.1f", (factor,), None))
    log.handle(logging.LogRecord("x", logging.WARNING, "", 0, "other", (), None))
    log.on_event(2_500_000, error(Code.MODE_CHANGE, "DAMP -> STAND").SerializeToString())
    assert log.drain() == ["warning: overload 0.5", "warning: other", "     2.5 s  DAMP -> STAND"]
    assert log.drain() == []


class Terminal:
    """Collects what is written, and says that it is a terminal."""

    def __init__(self, is_terminal: bool) -> None:
        self.text = ""
        self._is_terminal = is_terminal

    def isatty(self) -> bool:
        return self._is_terminal

    def write(self, text: str) -> None:
        self.text += text

    def flush(self) -> None:
        pass


def test_the_status_changes_in_place_below_the_lines() -> None:
    terminal = Terminal(True)
    with StatusLine(terminal) as line:
        line.show("one")
        line.say("news")
        line.show("x" * 1000)
    clear = "\r\x1b[2K"
    width = shutil.get_terminal_size().columns - 1
    assert terminal.text == f"{clear}one{clear}news\none{clear}{'x' * width}{clear}"


def test_elsewhere_only_the_lines_remain() -> None:
    terminal = Terminal(False)
    with StatusLine(terminal) as line:
        line.show("one")
        line.say("news")
    assert terminal.text == "news\n"


def test_help_needs_neither_mujoco_nor_the_robot() -> None:
    heavy = "('mujoco', 'google.protobuf', 'onnxruntime')"
    code = f"import sys, asimov_gym.cli; print([name for name in {heavy} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert done.stdout == "[]\n", done.stdout + done.stderr
