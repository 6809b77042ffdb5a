"""One line at the bottom of the terminal that changes in place, with lasting lines scrolling above it."""

from __future__ import annotations

import shutil
import sys
import threading
from types import TracebackType
from typing import TextIO

_CLEAR = "\r\x1b[2K"


class StatusLine:
    """Writes to a terminal, or to anything else: there only the lasting lines appear. Safe to use from any thread.

    Args:
        stream: standard output by default.
    """

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream = stream or sys.stdout
        self._shown = ""
        self._lock = threading.Lock()
        self.in_place = self._stream.isatty()
        """Whether the status is shown at all."""

    def show(self, status: str) -> None:
        """Put this in the place of the last status."""
        if not self.in_place:
            return
        width = shutil.get_terminal_size().columns
        with self._lock:
            self._shown = status[: max(1, width - 1)]
            self._write(_CLEAR + self._shown)

    def say(self, line: str) -> None:
        """Leave a line behind, above the status."""
        with self._lock:
            self._write(f"{_CLEAR}{line}\n{self._shown}" if self.in_place else f"{line}\n")

    def close(self) -> None:
        """Remove the status, so that what is printed next begins on a line of its own."""
        with self._lock:
            if self._shown:
                self._shown = ""
                self._write(_CLEAR)

    def _write(self, text: str) -> None:
        self._stream.write(text)
        self._stream.flush()

    def __enter__(self) -> StatusLine:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
