"""The robot's console: a local socket, which only its owner can open, for what a bench operator does.

One JSON object a line goes in and one comes back. `{"do": "status"}` is answered with `{"status": {...}}`, an action
(see `asimov_gym.edge.console_actions`) with `{"done": "..."}`, and what cannot be done with `{"error": "..."}`. Every
action goes out as an event, so that clients and recordings see that it was the operator and not the robot.
"""

from __future__ import annotations

import fcntl
import json
import logging
import os
import socket
import stat
import struct
import sys
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from asimov_gym.edge.console_actions import read_action
from asimov_gym.edge.events import Code
from asimov_gym.edge.lifecycle import Lifecycle
from asimov_gym.edge.robot import SimulatedRobot
from asimov_gym.edge.status import robot_status
from asimov_gym.edge.transports import TransportError

_log = logging.getLogger(__name__)

MAX_LINE_BYTES = 16 * 1024
"""A longer request is refused and its connection closed."""
MAX_CONNECTIONS = 8
"""More at a time are closed at once."""
IDLE_S = 60.0
"""A connection that asks nothing for so long is closed."""
_POLL_S = 0.05


class Console(Lifecycle):
    """Takes requests for one robot on a Unix socket.

    The socket lies in a folder that only the owner may enter, and every caller's user is looked at where the system
    tells it (Linux). A file beside it is locked while the robot lives, so that a second robot cannot take the name and
    the socket of one that was killed is in nobody's way.

    Args:
        robot: the robot.
        path: of the socket; its folder is made where it is missing.
        more_status: further keys for the status, such as the recorder's.
    """

    def __init__(self, robot: SimulatedRobot, path: Path, more_status: Callable[[], Mapping[str, Any]] = dict) -> None:
        self.path = path
        self._robot = robot
        self._more_status = more_status
        self._stopping = threading.Event()
        self._listener: socket.socket | None = None
        self._lock_file: int | None = None
        self._thread: threading.Thread | None = None
        self._connections: set[socket.socket] = set()
        self._guard = threading.Lock()

    @property
    def connect_line(self) -> str:
        """How to reach the console, for people."""
        name = self.path.stem
        return "asimov fault --help" if name == "asimov" else f"asimov fault ... --name {name}"

    # -- life --------------------------------------------------------------------------------------

    def start(self) -> None:
        """Open the socket and take requests in a thread.

        Raises:
            TransportError: the name is another running robot's, or the folder is not the owner's alone.
        """
        try:
            _own_folder(self.path.parent)
            self._lock_file = _lock(self.path)
            self._listener = _listen(self.path)
        except OSError as problem:
            self._unlock()
            raise TransportError(f"console {self.path}: {problem.strerror or problem}") from None
        except BaseException:
            self._unlock()
            raise
        self._stopping.clear()
        self._thread = threading.Thread(target=self._accept, name="console", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Close the socket and every connection. No effect if it is not open."""
        if self._listener is None or self._thread is None:
            return
        self._stopping.set()
        self._thread.join()
        self._listener.close()
        self._listener = self._thread = None
        with self._guard:
            for connection in self._connections:
                with suppress(OSError):
                    connection.shutdown(socket.SHUT_RDWR)
        self.path.unlink(missing_ok=True)
        self._unlock()

    def _unlock(self) -> None:
        if self._lock_file is not None:
            os.close(self._lock_file)  # which releases it; the file stays, since removing it would be a race
            self._lock_file = None

    # -- connections -------------------------------------------------------------------------------

    def _accept(self) -> None:
        listener = self._listener
        assert listener is not None
        while not self._stopping.is_set():
            try:
                connection, _ = listener.accept()
            except TimeoutError:
                continue
            except OSError as problem:
                _log.warning("console: %s", problem)
                self._stopping.wait(1.0)  # out of file descriptors, most likely
                continue
            with self._guard:
                welcome = len(self._connections) < MAX_CONNECTIONS and _is_owner(connection)
                if welcome:
                    self._connections.add(connection)
            if not welcome:
                connection.close()
                continue
            threading.Thread(target=self._serve, args=(connection,), name="console-caller", daemon=True).start()

    def _serve(self, connection: socket.socket) -> None:
        connection.settimeout(IDLE_S)
        try:
            with connection, connection.makefile("rwb") as stream:
                while line := stream.readline(MAX_LINE_BYTES + 1):
                    whole = len(line) <= MAX_LINE_BYTES
                    reply = self.answer(line) if whole else _error(f"a request has at most {MAX_LINE_BYTES} bytes")
                    stream.write(json.dumps(reply).encode() + b"\n")
                    stream.flush()
                    if not whole:
                        break
        except OSError:
            pass  # idle for too long, or gone: its own business
        finally:
            with self._guard:
                self._connections.discard(connection)

    # -- requests ----------------------------------------------------------------------------------

    def answer(self, line: bytes) -> dict[str, Any]:
        """Do what a request asks and return the reply. Never raises."""
        try:
            request = json.loads(line)
        except (ValueError, RecursionError):
            return _error("a request is a JSON object on one line")
        if not isinstance(request, dict) or not isinstance(request.get("do"), str):
            return _error('a request is a JSON object with the key "do", such as {"do": "status"}')
        try:
            return self._do(request.pop("do"), request)
        except ValueError as problem:
            return _error(str(problem))
        except Exception as problem:  # a robot at work must not die of its console
            _log.exception("console: a request failed")
            return _error(f"{type(problem).__name__}: {problem}")

    def _do(self, name: str, arguments: Mapping[str, Any]) -> dict[str, Any]:
        if name == "status":
            if arguments:
                raise ValueError(f"status has no argument {next(iter(arguments))!r}; it has no arguments")
            with self._robot.edge.lock:
                status = robot_status(self._robot)
            return {"status": {**status, **self._more_status()}}
        action = read_action(name, arguments)
        with self._robot.edge.lock:
            done = action.act(self._robot)
            if not action.reports_itself:
                self._robot.edge.error(Code.CONSOLE, done)
        _log.info("console: %s", done)
        return {"done": done}


def _error(message: str) -> dict[str, Any]:
    return {"error": message}


def _own_folder(folder: Path) -> None:
    """Make the folder for the owner alone, or check that it is so."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    with suppress(FileExistsError):
        folder.mkdir(mode=0o700)
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or found.st_mode & 0o077:
        raise TransportError(f"console: {folder} must be a folder that only you can enter (chmod 700); it is not")


def _lock(path: Path) -> int:
    """The locked file that marks the name as taken while this process lives.

    Raises:
        TransportError: another robot holds it.
    """
    file = os.open(path.with_suffix(".lock"), os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(file)
        raise TransportError(
            f"a robot named {path.stem!r} already runs on this machine; choose another --name for this one"
        ) from None
    return file


def _listen(path: Path) -> socket.socket:
    path.unlink(missing_ok=True)  # left by a robot that was killed: the lock is ours, so nobody serves it
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        listener.bind(str(path))
        path.chmod(0o600)  # before `listen`: until then nobody can connect
        listener.listen(MAX_CONNECTIONS)
        listener.settimeout(_POLL_S)
    except BaseException:
        listener.close()
        raise
    return listener


def _is_owner(connection: socket.socket) -> bool:
    """Whether the caller is this process's user. Where the system does not tell, the folder's rights must do."""
    if not sys.platform.startswith("linux"):
        return True
    size = struct.calcsize("3i")
    _, user, _ = struct.unpack("3i", connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, size))
    return user in (os.getuid(), 0)
