"""Turns lines of the program's log into messages of a recording."""

from __future__ import annotations

import logging
from collections.abc import Callable

from asimov_gym.edge.wire import recording_pb2

_LEVELS = (
    (logging.CRITICAL, recording_pb2.LogLine.FATAL),
    (logging.ERROR, recording_pb2.LogLine.ERROR),
    (logging.WARNING, recording_pb2.LogLine.WARNING),
    (logging.INFO, recording_pb2.LogLine.INFO),
    (logging.NOTSET + 1, recording_pb2.LogLine.DEBUG),
)
_MICROSECONDS = 1_000_000


class LogTap(logging.Handler):
    """A handler that passes each line on as a serialized `LogLine`.

    Args:
        take: gets the edge wall clock, microseconds, and the message.
        now_us: the edge wall clock.
    """

    def __init__(self, take: Callable[[int, bytes], None], now_us: Callable[[], int]) -> None:
        super().__init__()
        self._take = take
        self._now_us = now_us
        self._plain = logging.Formatter("%(message)s")

    def emit(self, record: logging.LogRecord) -> None:
        """Pass a line on."""
        try:
            time_us = self._now_us()
            line = recording_pb2.LogLine(
                level=next((level for number, level in _LEVELS if record.levelno >= number), _LEVELS[-1][1]),
                message=_text(self._plain.format(record)),
                name=_text(record.name),
                file=_text(record.filename),
                line=max(0, record.lineno),
            )
            line.timestamp.seconds, rest = divmod(time_us, _MICROSECONDS)
            line.timestamp.nanos = 1000 * rest
            self._take(time_us, line.SerializeToString())
            self._print_where_nobody_else_does(record)
        except Exception:  # as every handler: a line that cannot be written must not end the program
            self.handleError(record)

    def _print_where_nobody_else_does(self, record: logging.LogRecord) -> None:
        """Without any handler Python prints warnings. That we listen is no reason to hide them."""
        fallback = logging.lastResort
        if fallback is None or record.levelno < fallback.level:
            return
        logger: logging.Logger | None = logging.getLogger(record.name)
        while logger is not None:
            taps = [handler for handler in logger.handlers if isinstance(handler, LogTap)]
            if len(taps) < len(logger.handlers) or (taps and taps[0] is not self):
                return
            logger = logger.parent if logger.propagate else None
        fallback.handle(record)


def _text(text: str) -> str:
    """Text that protobuf takes: lone surrogates, as in odd file names, are replaced."""
    return text.encode("utf-8", "replace").decode("utf-8")
