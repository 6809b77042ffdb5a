"""What a recording holds, at a glance: how long it is, what was commanded, in which modes, with which alerts."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from asimov_gym.edge import Code
from asimov_gym.edge.wire import cloud_pb2
from asimov_gym.recording.reader import Entry, is_complete, read_notes, read_recording
from asimov_gym.recording.schemas import COMMANDS, LOG, STATE, SYSTEM, TOPICS

_MICROSECONDS = 1_000_000
_UINT32 = 2**32


@dataclass(frozen=True)
class ModeSpan:
    """A stretch of time in one state of the robot. Times are seconds since the recording's first message."""

    state: str
    """`DAMP`, `STAND`, `MOVE/POLICY`, `MOVE/TRAJECTORY`; `MOVE` where a recording that began later says no more;
    `unknown` in one without telemetry."""
    start: float
    stop: float


@dataclass(frozen=True)
class AlertSpan:
    """An alert from when it was raised until it cleared."""

    text: str
    """Name, severity, source, value and threshold."""
    start: float
    stop: float | None
    """None if it was still up at the end."""


@dataclass(frozen=True)
class Event:
    """An event in words."""

    time: float
    """s since the recording's first message."""
    code: str
    """Code of an `EdgeError`; `controller` or `diagnostics` for the other kinds."""
    text: str


@dataclass(frozen=True)
class Summary:
    """What a recording holds."""

    notes: dict[str, str]
    complete: bool
    """Whether the recorder closed the file; else it was cut off, and read as far as it goes."""
    start_us: int
    """Edge wall clock of the first message, microseconds."""
    duration: float
    """From the first message to the last, s."""
    counts: Counter[str]
    """Messages by topic."""
    commands: Counter[tuple[str, str, str]]
    """Commands by client, kind and verdict."""
    modes: tuple[ModeSpan, ...]
    alerts: tuple[AlertSpan, ...]
    events: tuple[Event, ...]
    """Those that say something new: all but the diagnostics of each second."""
    log: tuple[Event, ...]
    """Lines of the log; the code is the level."""
    error_flags: int
    """All fault bits that telemetry showed."""
    largest_gap: float
    """Longest time between two telemetry frames, s; 0 with fewer than two."""
    largest_gap_at: float
    """When it began, s."""
    missing_frames: int
    """Telemetry frames that are missing by their counter."""


def summarize(path: str | Path) -> Summary:
    """Read a recording once and sum it up.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: it is not a recording.
    """
    path = Path(path)
    tally = _Tally()
    for entry in read_recording(path):
        tally.add(entry)
    return tally.summary(read_notes(path), is_complete(path))


class _Tally:
    def __init__(self) -> None:
        self.start_us: int | None = None
        self.end = 0.0
        self.counts: Counter[str] = Counter(dict.fromkeys(TOPICS, 0))
        self.commands: Counter[tuple[str, str, str]] = Counter()
        self.events: list[Event] = []
        self.log: list[Event] = []
        self.modes: list[tuple[str, float]] = [("unknown", 0.0)]
        self.mode_told = False
        self.alerts: list[AlertSpan] = []
        self.error_flags = 0
        self.last_frame: tuple[float, int] | None = None
        self.gap = (0.0, 0.0)
        self.missing = 0

    def add(self, entry: Entry) -> None:
        if self.start_us is None:
            self.start_us = entry.time_us
        self.end = time = (entry.time_us - self.start_us) / _MICROSECONDS
        self.counts[entry.topic] += 1
        message: Any = entry.message
        if entry.topic == COMMANDS:
            self.commands[message.client, message.kind or "?", message.verdict] += 1
        elif entry.topic == STATE:
            self._add_frame(time, message)
        elif entry.topic == SYSTEM:
            self._add_event(describe_event(time, message))
        elif entry.topic == LOG:
            level = message.Level.Name(message.level)
            self.log.append(Event(time, level, f"{message.name}: {message.message}"))

    def _add_frame(self, time: float, message: Any) -> None:
        self.error_flags |= message.error_flags
        if self.last_frame is not None:
            before, sequence = self.last_frame
            self.gap = max(self.gap, (time - before, before), key=lambda gap: gap[0])
            self.missing += max(0, (message.sequence - sequence) % _UINT32 - 1)
        self.last_frame = (time, message.sequence)
        if self.modes[0][0] == "unknown" and not self.mode_told:
            self.modes[0] = (cloud_pb2.FirmwareMode.Name(message.fw_mode).removeprefix("FW_MODE_"), 0.0)

    def _add_event(self, event: Event) -> None:
        if event.code != "diagnostics":
            self.events.append(event)
        if event.code == Code.BOOT.value:
            if not self.mode_told and event.text == "boot 1":
                self.modes = [("DAMP", 0.0)]  # what came before its first control step found it there
            self._enter("DAMP", event.time)
            self._clear_alerts(event.time)
        elif event.code == Code.MODE_CHANGE.value:
            before, _, after = event.text.partition(" -> ")
            if not self.mode_told:
                self.modes = [(before, 0.0)]
            self._enter(after, event.time)
        elif event.code == Code.ALERT_RAISED.value:
            self.alerts.append(AlertSpan(event.text, event.time, None))
        elif event.code == Code.ALERT_CLEARED.value:
            name, source = _identity(event.text)
            self._clear_alerts(event.time, name, source)

    def _enter(self, state: str, time: float) -> None:
        self.mode_told = True
        if self.modes[-1][0] != state:
            self.modes.append((state, time))

    def _clear_alerts(self, time: float, name: str = "", source: str = "") -> None:
        for place, alert in enumerate(self.alerts):
            if alert.stop is None and (not name or _identity(alert.text) == (name, source)):
                self.alerts[place] = AlertSpan(alert.text, alert.start, time)

    def summary(self, notes: dict[str, str], complete: bool) -> Summary:
        stops = [start for _, start in self.modes[1:]] + [self.end]
        spans = (ModeSpan(state, start, stop) for (state, start), stop in zip(self.modes, stops, strict=True))
        return Summary(
            notes=notes,
            complete=complete,
            start_us=self.start_us or 0,
            duration=self.end,
            counts=self.counts,
            commands=self.commands,
            modes=tuple(span for span in spans if span.stop > span.start),
            alerts=tuple(self.alerts),
            events=tuple(self.events),
            log=tuple(self.log),
            error_flags=self.error_flags,
            largest_gap=self.gap[0],
            largest_gap_at=self.gap[1],
            missing_frames=self.missing,
        )


def describe_event(time: float, message: Any) -> Event:
    """An `EdgeEvent` in words."""
    kind = message.WhichOneof("event")
    if kind == "error":
        return Event(time, message.error.code, message.error.message)
    if kind == "controller":
        previous, current = (name or "nobody" for name in (message.controller.previous, message.controller.current))
        return Event(time, "controller", f"{previous} -> {current} ({message.controller.reason})")
    return Event(time, kind or "unknown", "")


def _identity(text: str) -> tuple[str, str]:
    """Name and source in the text of an alert's event: `NAME [severity] source N [...]`."""
    words = text.split()
    source = words[words.index("source") + 1] if "source" in words[:-1] else ""
    return (words[0] if words else "", source)
