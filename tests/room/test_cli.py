"""`asimov room` as a command."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("asimov_gym.room", exc_type=ImportError)

from asimov_gym.cli.room import Room
from asimov_gym.room import RoomKeys

START = "import sys; from pathlib import Path; from asimov_gym.cli.room import Room; sys.exit(Room({}).run())"


@pytest.mark.parametrize("address", ["0.0.0.0", "10.0.0.1", "robot.local"])
def test_it_is_never_offered_to_a_network(address: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert Room(listen=address, port=0).run() == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.count("\n") == 1
    assert "never offered to a network" in printed.err


def test_a_busy_port_and_a_wrong_one_are_one_line_each(capsys: pytest.CaptureFixture[str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as busy:
        assert Room(port=busy.getsockname()[1]).run() == 2
    assert Room(port=70_000).run() == 2
    in_use, wrong = capsys.readouterr().err.splitlines()
    assert "the port is in use" in in_use
    assert "port is 70000; allowed: 0 to 65535" in wrong


def test_a_key_file_that_is_none_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "keys"
    path.write_text("secret words")
    os.chmod(path, 0o600)
    assert Room(port=0, keys=path).run() == 2
    error = capsys.readouterr().err
    assert "not a key file" in error
    assert "secret words" not in error


@pytest.mark.parametrize("with_file", [True, False])
def test_it_states_its_limits_hides_its_secrets_and_closes(tmp_path: Path, with_file: bool) -> None:
    path = tmp_path / "keys.json"
    flags = "port=0" + (f", keys=Path({str(path)!r})" if with_file else "")
    process = subprocess.Popen(
        [sys.executable, "-c", START.format(flags)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout is not None
        lines = []
        for line in process.stdout:
            lines.append(line)
            if "Ctrl-C" in line:
                break
        said = "".join(lines)
        process.send_signal(signal.SIGTERM)
        out, err = process.communicate(timeout=10)
    finally:
        process.kill()
    assert (process.returncode, out, err) == (0, "The room is closed.\n", "")
    assert "no access from the network" in said
    assert "forwarded" in said
    assert re.search(r"ws://127\.0\.0\.1:\d+  room robot-sim", said)
    if with_file:
        keys = RoomKeys.from_file(path)
        assert str(path) in said
        assert keys.credential not in said and keys.secret not in said
    else:
        assert "shown on a terminal only" in said
    assert "eyJ" not in said
