"""`asimov robot --joint-control`: what it prints, what it refuses."""

from __future__ import annotations

import importlib.util
import re
import shutil
import socket
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from asimov_gym.cli import main

ROBOT = ("robot", "--no-udp", "--seconds", "0.3")
needs_messages = pytest.mark.skipif(
    importlib.util.find_spec("bosdyn") is None,
    reason="bosdyn-api is not installed: pip install 'asimov-gym[joint-control]'",
)


@pytest.fixture(autouse=True)
def runtime(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A runtime folder of the test's own, with a short name."""
    folder = Path(tempfile.mkdtemp(prefix="ag-"))
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(folder))
    for name in ("LIVEKIT_URL", "LIVEKIT_TOKEN"):
        monkeypatch.delenv(name, raising=False)
    yield
    shutil.rmtree(folder)


@needs_messages
def test_the_start_names_address_and_licence_bound(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*ROBOT, "--joint-control", "0"]) == 0
    said = capsys.readouterr().out
    assert re.search(r"joints +grpc://127\.0\.0\.1:\d+ \(insecure channel\)", said)
    assert "Boston Dynamics SDK licence" in said
    assert "no other hardware" in said


@needs_messages
def test_a_port_in_use_is_said_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = str(taken.getsockname()[1])
        assert main([*ROBOT, "--joint-control", port]) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"asimov robot: cannot serve joint control on port {port} of 127.0.0.1")
    assert said.count("\n") == 1


def test_lockstep_serves_no_joint_control(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["robot", "--lockstep", "--seconds", "1", "--joint-control", "0"]) == 2
    assert "leave --joint-control out" in capsys.readouterr().err
