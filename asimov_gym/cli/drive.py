"""`asimov drive`: moves a robot by a script or by the keyboard, over UDP or a LiveKit room."""

from __future__ import annotations

import os
import signal
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

if TYPE_CHECKING:
    from asimov_gym.cli.drive_script import Step
    from asimov_gym.edge import Session


@dataclass(frozen=True)
class Drive:
    """Move a robot: by the script given, or by the keyboard without one.

    A script is steps separated by semicolons: stand, velocity VX VY YAW (m/s, m/s, rad/s), stop, damp, each with an
    optional "for SECONDS", and wait SECONDS. Example: asimov drive "stand for 3; velocity 0.4 0 0 for 5; stop for 1;
    damp". On leaving, a robot that walks is told to walk on the spot.

    Exit code 0 when all was done, 1 when the robot had a fault, did not follow or was lost, 2 when it could not be
    tried.
    """

    script: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="[SCRIPT]")] = None
    """Steps to do. Without them the keyboard drives."""
    file: Path | None = None
    """Read the script from this file; there a line ends a step too, and # starts a comment."""
    target: str = "udp://127.0.0.1"
    """The robot: udp://HOST or udp://HOST:CONTROL_PORT."""
    state_port: int | None = None
    """UDP: port on this machine that the robot sends its state to; 8851 when left out."""
    facts_port: int | None = None
    """UDP: port of the robot's facts; 3000 when left out."""
    livekit: str | None = None
    """Join the robot in a LiveKit room instead: ws://HOST:PORT or wss://HOST."""
    token: str | None = None
    """Token for the room. Better put it in the environment as LIVEKIT_TOKEN: other users see the command line."""
    real: bool = False
    """Also drive a robot that does not say that it is simulated."""

    def run(self) -> int:
        """Connect and drive."""
        try:
            steps = self._steps()
        except (OSError, ValueError) as error:
            print(f"asimov drive: {_one_line(error)}", file=sys.stderr)
            return 2
        if steps is None and not sys.stdin.isatty():
            print('asimov drive: no terminal to take keys from; give a script, such as "stand for 3"', file=sys.stderr)
            return 2
        try:
            session = self._connect()
        except (ConnectionError, ImportError, ValueError) as error:
            print(f"asimov drive: {_one_line(error)}", file=sys.stderr)
            return 2
        before = signal.signal(signal.SIGTERM, _interrupt)
        try:
            with session:
                return self._drive(session, steps)
        finally:
            signal.signal(signal.SIGTERM, before)

    def _steps(self) -> tuple[Step, ...] | None:
        from asimov_gym.cli.drive_script import parse_script

        if self.script is not None and self.file is not None:
            raise ValueError("give a script or --file, not both")
        text = self.script if self.file is None else self.file.read_text(encoding="utf-8")
        return None if text is None else parse_script(text)

    def _connect(self) -> Session:
        from asimov_gym.edge import connect
        from asimov_gym.edge.facts import is_simulated

        if self.livekit is None:
            session = connect(self.target, state_port=self.state_port, facts_port=self.facts_port)
        else:
            token = self.token or os.environ.get("LIVEKIT_TOKEN", "")
            if not token:
                raise ValueError("a room needs a token: set LIVEKIT_TOKEN, or give --token")
            session = connect(self.livekit, token=token)
        if not self.real and not is_simulated(dict(session.facts or {})):
            session.close()
            raise ConnectionError("this robot does not say that it is simulated; --real drives it all the same")
        return session

    def _drive(self, session: Session, steps: tuple[Step, ...] | None) -> int:
        from asimov_gym.cli.keyboard import Keyboard
        from asimov_gym.cli.keyboard_drive import KeyboardDrive
        from asimov_gym.cli.scripted_drive import DriveFailed, RealTime, ScriptedDrive
        from asimov_gym.cli.status_line import StatusLine

        with StatusLine() as line:
            try:
                if steps is not None:
                    ScriptedDrive(session, RealTime(), line.show, line.say).run(steps)
                else:
                    with Keyboard() as keyboard:
                        KeyboardDrive(session, line.show, line.say).run(keyboard)
            except DriveFailed as error:
                line.close()
                print(f"asimov drive: {error}", file=sys.stderr)
                return 1
        return 0


def _interrupt(number: int, frame: Any) -> None:
    raise KeyboardInterrupt


def _one_line(error: Exception) -> str:
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    return " ".join(str(error).split())
