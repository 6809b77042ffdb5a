"""Single key presses from the terminal, which is put back as it was whatever happens."""

from __future__ import annotations

import os
import select
import sys
import termios
import tty
from types import TracebackType

_ESCAPE = "\x1b"
_NAMES = {
    "\x1b[A": "up",
    "\x1b[B": "down",
    "\x1b[C": "right",
    "\x1b[D": "left",
    "\x1bOA": "up",
    "\x1bOB": "down",
    "\x1bOC": "right",
    "\x1bOD": "left",
    "\x1b[5~": "page up",
    "\x1b[6~": "page down",
    "\x1b[F": "end",
    "\x1b[4~": "end",
    "\x1bOF": "end",
    " ": "space",
    "\r": "enter",
    "\n": "enter",
}
"""Names of keys that are more than a letter, by what terminals send."""


class Keyboard:
    """Reads keys between `__enter__` and `__exit__`: no echo, no waiting for a line, Ctrl-C as ever.

    Args:
        file: descriptor of the terminal; standard input by default.
    """

    def __init__(self, file: int | None = None) -> None:
        self._file = sys.stdin.fileno() if file is None else file
        self._before: list | None = None
        self._pending = ""

    def __enter__(self) -> Keyboard:
        self._before = termios.tcgetattr(self._file)
        tty.setcbreak(self._file)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._before is not None:
            termios.tcsetattr(self._file, termios.TCSADRAIN, self._before)

    def key(self, timeout: float) -> str | None:
        """The next key: a name such as `up` or `space`, or the character in lower case.

        Args:
            timeout: s.

        Returns:
            None when no key was pressed in time.

        Raises:
            EOFError: the terminal is gone.
        """
        if not self._pending:
            if not select.select([self._file], [], [], timeout)[0]:
                return None
            typed = os.read(self._file, 64)
            if not typed:
                raise EOFError("the terminal is gone")
            self._pending = typed.decode(errors="ignore")
        for sequence, name in _NAMES.items():
            if self._pending.startswith(sequence):
                self._pending = self._pending[len(sequence) :]
                return name
        if self._pending.startswith(_ESCAPE) and len(self._pending) > 1:
            self._pending = ""  # a key with a meaning unknown here, such as F5
            return None
        character, self._pending = self._pending[:1], self._pending[1:]
        return character.lower() or None
