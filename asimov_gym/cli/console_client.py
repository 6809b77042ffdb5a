"""The other end of a robot's console: where its socket is, and one request to it."""

from __future__ import annotations

import json
import os
import re
import socket
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

DEFAULT_NAME = "asimov"
"""Name of a robot that was given none."""
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,31}")


class NoRobot(ConnectionError):
    """No robot of that name runs here; the message is one line for the person who asked."""


def console_path(name: str) -> Path:
    """The socket of the console of the robot with this name: in the user's runtime folder, or a folder of the user's
    own among the temporary files.

    Raises:
        ValueError: a name that is not 1 to 32 letters, digits, `-` or `_`.
    """
    if not _NAME.fullmatch(name):
        raise ValueError(f"--name must be 1 to 32 letters, digits, - or _, and begin with no sign; got {name!r}")
    runtime = os.environ.get("XDG_RUNTIME_DIR", "")
    if runtime and Path(runtime).is_dir():
        return Path(runtime, "asimov-gym", f"{name}.sock")
    return Path(tempfile.gettempdir(), f"asimov-gym-{os.getuid()}", f"{name}.sock")


def ask(name: str, request: Mapping[str, Any], timeout: float = 5.0) -> dict[str, Any]:
    """Send one request to a robot's console.

    Args:
        name: of the robot.
        request: see `asimov_gym.edge.console`.
        timeout: s, for the whole exchange.

    Returns:
        The reply: `{"done": ...}`, `{"status": ...}` or `{"error": ...}`.

    Raises:
        NoRobot: no robot of that name runs, or it does not answer.
        ValueError: a name that cannot be one.
    """
    path = console_path(name)
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
        connection.settimeout(timeout)
        try:
            connection.connect(str(path))
            connection.sendall(json.dumps(request).encode() + b"\n")
            with connection.makefile("rb") as stream:
                line = stream.readline()
        except (FileNotFoundError, ConnectionRefusedError):
            start = "asimov robot" if name == DEFAULT_NAME else f"asimov robot --name {name}"
            raise NoRobot(f"no robot named {name!r} runs here; start one with: {start}") from None
        except OSError as problem:
            raise NoRobot(f"the robot named {name!r} does not answer: {problem.strerror or problem}") from None
    if not line:
        raise NoRobot(f"the robot named {name!r} closed its console")
    return json.loads(line)
