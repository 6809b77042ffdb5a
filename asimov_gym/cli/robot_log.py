"""What happens to a running robot, in lines for people: its events, and the warnings of the log."""

from __future__ import annotations

import logging
import time
from collections import deque

from asimov_gym.edge import Code, EdgeListener
from asimov_gym.edge.wire import cloud_pb2

KEPT = 1000
"""Lines that may wait to be printed; beyond that the oldest is lost."""
AGAIN_S = 10.0
"""The same kind of warning is shown at most this often, s."""

_PHRASES = {
    Code.BOOT.value: "firmware: {}",
    Code.MODE_CHANGE.value: "{}",
    Code.ALERT_RAISED.value: "alert: {}",
    Code.ALERT_CLEARED.value: "alert cleared: {}",
    Code.FAULT_LATCHED.value: "fault latched, {}; clear it with: asimov fault restart",
    Code.E_STOP.value: "emergency stop {}",
    Code.CONSOLE.value: "console: {}",
    Code.JOINT_CONTROL.value: "joint control: {}",
    Code.CAMERA.value: "camera: {}",
    Code.MICROPHONE.value: "microphone: {}",
    Code.SPEAKER.value: "speaker: {}",
    Code.CLOUD.value: "room: {}",
}
"""Events that are shown. The log tells of overload and of the recorder, too; boot steps and shutdown are no news."""

_FIRMWARE = "asimov_gym.firmware"
"""Logger whose warnings come as events too."""


class RobotLog(EdgeListener, logging.Handler):
    """Collects lines from the edge and from the log; `drain` gives them. Nothing waits for the terminal.

    Args:
        start_us: edge wall clock from which the lines count their time, microseconds.
        level: of the log.
    """

    def __init__(self, start_us: int, level: int = logging.WARNING) -> None:
        logging.Handler.__init__(self, level)
        self._start_us = start_us
        self._lines: deque[str] = deque(maxlen=KEPT)
        self._last: dict[object, float] = {}

    def drain(self) -> list[str]:
        """The lines since the last call."""
        lines = []
        while self._lines:
            lines.append(self._lines.popleft())
        return lines

    def on_event(self, timestamp_us: int, packet: bytes) -> None:
        """An event of the robot."""
        text = describe_event(cloud_pb2.EdgeEvent.FromString(packet))
        if text:
            self._lines.append(f"{(timestamp_us - self._start_us) / 1e6:8.1f} s  {text}")

    def emit(self, record: logging.LogRecord) -> None:
        """A line of the log."""
        if record.name.startswith(_FIRMWARE) and self.level > logging.INFO and record.levelno < logging.ERROR:
            return
        now = time.monotonic()
        if now - self._last.get(record.msg, -AGAIN_S) < AGAIN_S:
            return
        if len(self._last) > KEPT:
            self._last.clear()
        self._last[record.msg] = now
        try:
            self._lines.append(f"{record.levelname.lower()}: {record.getMessage()}")
        except Exception:  # a bad format string must not end the robot's loop, from which it may come
            self.handleError(record)


def describe_event(event: cloud_pb2.EdgeEvent) -> str:
    """An event in words; empty for those that are no news."""
    if event.HasField("controller"):
        change = event.controller
        return f"control: {change.previous or 'nobody'} -> {change.current or 'nobody'} ({change.reason})"
    if event.HasField("error") and event.error.code in _PHRASES:
        return _PHRASES[event.error.code].format(event.error.message)
    return ""
