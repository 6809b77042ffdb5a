"""A command that trains several runs, stopped by Ctrl-C, killed, and gone on with."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

REPOSITORY = Path(__file__).resolve().parents[2]


def interrupted_killed_and_resumed(arguments: list[str], first: Path, in_second: Callable[[], Any]) -> str:
    """What `python -m train` printed in the end. It is interrupted in its first run, killed later, and must leave alone
    what was finished by then.

    Args:
        arguments: of `python -m train`: a command and a name first.
        first: folder of its first run.
        in_second: whether it is time to kill it.
    """
    process = _start(arguments)
    try:
        _when(process, lambda: list(first.glob("curves/events.*")))
        time.sleep(0.5)  # the loop listens for signals right after
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate(timeout=300)
        assert process.returncode == 0, output
        assert f"continue with:  python -m train {' '.join(arguments[:2])}" in output
        process = _start(arguments)
        _when(process, in_second)
        process.send_signal(signal.SIGKILL)
        process.communicate(timeout=300)
        done = first / "checkpoints"
        before = {path.name: path.stat().st_mtime_ns for path in done.iterdir()}
        process = _start(arguments)
        output, _ = process.communicate(timeout=600)
    finally:
        process.kill()
    assert process.returncode == 0, output
    assert {path.name: path.stat().st_mtime_ns for path in done.iterdir()} == before
    return output


def _start(arguments: list[str]) -> subprocess.Popen[str]:
    command, pipe = [sys.executable, "-m", "train", *arguments], subprocess.PIPE
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    return subprocess.Popen(command, cwd=REPOSITORY, stdout=pipe, stderr=subprocess.STDOUT, text=True, env=environment)


def _when(process: subprocess.Popen[str], there: Callable[[], Any]) -> None:
    deadline = time.monotonic() + 300.0
    while not there():
        assert process.poll() is None, process.stdout.read() if process.stdout else ""
        assert time.monotonic() < deadline
        time.sleep(0.05)
