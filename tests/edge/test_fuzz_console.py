"""The console's socket under garbage, mutated requests, huge lines and half lines: a reply to each line, no remains."""

from __future__ import annotations

import json
import random
import shutil
import socket
import tempfile
import threading
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from asimov_gym.edge import SimulatedRobot
from asimov_gym.edge.console import MAX_CONNECTIONS, MAX_LINE_BYTES, Console
from asimov_gym.edge.console_actions import ACTIONS
from tests.edge.conftest import StandInPolicy
from tests.footprint import Footprint, eventually

REPORT_S = 0.1
"""Robot time until the next report: what was done must not break the robot's loop, and must be sayable in telemetry."""
SOUND: tuple[dict[str, Any], ...] = (
    {"do": "status"},
    {"do": "restart"},
    {"do": "e_stop", "to": "press"},
    {"do": "e_stop", "to": "release"},
    {"do": "gantry", "to": "hoist"},
    {"do": "push", "force": [10.0, -20.0, 5.0], "seconds": 0.1, "body": "waist_yaw_link"},
    {"do": "heat", "motor": "L_Knee", "celsius": 60.0},
    {"do": "drop_bus", "bus": "left_leg", "seconds": 0.05},
    {"do": "drop_motor", "motor": 3, "seconds": None},
    {"do": "overcurrent", "motor": 7, "amperes": 30.0, "seconds": 0.1},
    {"do": "delay_policy", "ms": 30.0, "seconds": 0.2},
    {"do": "fail_policy", "seconds": 0.1},
    {"do": "battery", "percent": 50.0},
    {"do": "imu", "seconds": 0.02},
    {"do": "encoder", "motor": "R_Knee", "seconds": 0.1},
    {"do": "alert", "alert": "FALL_DETECTED", "source": 3},
    {"do": "clear"},
)
ODD_VALUES: tuple[Any, ...] = (
    None, True, -1, 0, 2**32, 2**70, 10**400, -0.0, 1e300, 1e-300, float("nan"), float("inf"), "", "all", "é\ud800",
    [], [1.0, 2.0, 3.0], ["x"] * 3, {}, {"do": "clear"}, "x" * 3000,
)  # fmt: skip


def values() -> Iterator[bytes]:
    """Sound requests, then each with every argument left out and replaced by every odd value, and with one too many."""
    for request in SOUND:
        yield json.dumps(request).encode()
        yield json.dumps({**request, "more": 1}).encode()
        for key in request:
            yield json.dumps({name: value for name, value in request.items() if name != key}).encode()
            for odd in ODD_VALUES:
                yield json.dumps({**request, key: odd}).encode()


def garbage(count: int, seed: int) -> Iterator[bytes]:
    """Sound requests with bytes changed, cut out and put in, and noise; never a line's end within."""
    dice = random.Random(seed)
    for _ in range(count):
        line = bytearray(json.dumps(dice.choice(SOUND)).encode())
        for _ in range(dice.choice((1, 2, 5, 20))):
            place = dice.randrange(len(line) + 1)
            match dice.randrange(4):
                case 0:
                    line[place : place + 1] = dice.randbytes(1)
                case 1:
                    del line[place : place + dice.randrange(10)]
                case 2:
                    line[place:place] = dice.choice(
                        (b'"', b"{", b"[" * 2000, b"\\", b":", b",", b"\x00", b"\xef\xbb\xbf")
                    )
                case _:
                    line[place:place] = dice.randbytes(dice.randrange(1, 30))
        yield bytes(line).replace(b"\n", b"\r")


@pytest.fixture
def path() -> Iterator[Path]:
    """Of a socket: short, since the system allows about a hundred characters."""
    folder = Path(tempfile.mkdtemp(prefix="ag-"))
    yield folder / "console" / "fuzz.sock"
    shutil.rmtree(folder)


def call(path: Path) -> socket.socket:
    caller = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    caller.settimeout(10.0)
    caller.connect(str(path))
    return caller


def check_status(path: Path) -> None:
    """Assert that somebody who comes now is served."""
    with call(path) as caller, caller.makefile("rwb") as stream:
        stream.write(b'{"do": "status"}\n')
        stream.flush()
        assert json.loads(stream.readline())["status"]["state"]


def test_every_line_gets_one_reply_and_the_robot_lives(path: Path) -> None:
    robot = SimulatedRobot(StandInPolicy())
    before = Footprint.now()
    replies: Counter[str] = Counter()
    with Console(robot, path):
        lines = [*values(), *garbage(1000, seed=32)]
        random.Random(33).shuffle(lines)
        with call(path) as caller, caller.makefile("rwb") as stream:
            for line in lines:
                stream.write(line + b"\n")
                stream.flush()
                reply = json.loads(stream.readline())
                assert reply.keys() <= {"status", "done", "error"} and len(reply) == 1, (line, reply)
                replies.update(reply.keys())
                if "done" in reply:
                    robot.advance(REPORT_S)
        check_status(path)
    assert replies["done"] > 60 and replies["error"] > 1000 and replies["status"] > 0, replies
    eventually(lambda: threading.active_count() == len(before.threads), "every caller's thread has ended")
    assert Footprint.now().files == before.files


@pytest.mark.parametrize("action", ACTIONS)
def test_every_action_is_among_the_requests(action: str) -> None:
    assert action in {request["do"] for request in SOUND}


def test_half_lines_and_huge_lines_end_their_own_connection_only(path: Path) -> None:
    robot = SimulatedRobot(StandInPolicy())
    before = Footprint.now()
    with Console(robot, path), call(path) as patient, patient.makefile("rwb") as stream:
        stream.write(b'{"do": ')
        stream.flush()
        for number in range(40):
            with call(path) as caller:
                match number % 4:
                    case 0:  # half a line, and gone
                        caller.sendall(b'{"do": "restart"')
                    case 1:  # a line without an end
                        huge(caller)
                    case 2:  # many lines, no reply taken
                        caller.sendall(b'{"do": "status"}\n' * 100)
                    case _:  # nothing
                        pass
            robot.advance(0.005)
            eventually(lambda: threading.active_count() <= len(before.threads) + 2, "the caller has been let go")
        # A line that was cut off is no request, unless what there is of it is one.
        assert robot.firmware.boots == 1
        stream.write(b'"clear"}\n')
        stream.flush()
        assert "done" in json.loads(stream.readline())
        check_status(path)
    eventually(lambda: threading.active_count() == len(before.threads), "every caller's thread has ended")
    assert Footprint.now().files == before.files


def huge(caller: socket.socket) -> None:
    """Send a line without an end: an error may come back, then the connection ends."""
    with suppress(BrokenPipeError, ConnectionResetError):
        caller.sendall(b"[" * (40 * MAX_LINE_BYTES))
    with suppress(ConnectionResetError):
        assert b"error" in caller.recv(65_536)
        assert caller.recv(65_536) == b""


def test_a_crowd_of_silent_callers_is_bounded(path: Path) -> None:
    robot = SimulatedRobot(StandInPolicy())
    before = Footprint.now()
    with Console(robot, path):
        crowd = [call(path) for _ in range(MAX_CONNECTIONS)]
        with call(path) as one_more:
            assert one_more.recv(100) == b""
        assert threading.active_count() <= len(before.threads) + MAX_CONNECTIONS + 1
        for caller in crowd:
            caller.close()
        eventually(lambda: threading.active_count() == len(before.threads) + 1, "the callers have been let go")
        check_status(path)
    eventually(lambda: threading.active_count() == len(before.threads), "every caller's thread has ended")
    assert Footprint.now().files == before.files
