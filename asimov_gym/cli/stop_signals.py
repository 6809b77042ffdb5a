"""Ctrl-C, a closed terminal and a polite kill, turned into a question that a loop can ask."""

from __future__ import annotations

import os
import signal
import sys
from types import FrameType, TracebackType

_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class StopSignals:
    """Between `__enter__` and `__exit__` the first such signal only sets `stopped`; the second ends the process."""

    def __init__(self) -> None:
        self.stopped = False
        self._before: dict[signal.Signals, object] = {}

    def __enter__(self) -> StopSignals:
        self._before = {number: signal.signal(number, self._stop) for number in _SIGNALS}
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)  # type: ignore[arg-type]

    def _stop(self, number: int, frame: FrameType | None) -> None:
        if self.stopped:
            os.write(sys.stderr.fileno(), b"\nended at once\n")  # not print: it may be what was interrupted
            os._exit(128 + number)
        self.stopped = True
