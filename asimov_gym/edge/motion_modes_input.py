"""Input sources: who may send velocities over the motion-mode interface, and whose count.

Each source has a name, a priority and a time after which its silence makes it passive. Of those that are active the
highest priority is preferred; of equals the one that came first.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum
from types import MappingProxyType

from asimov_gym.firmware import MICROSECONDS

PRIORITY_RANGE = (20, 100)
"""Of sources that clients add."""
DEFAULT_TIMEOUT_MS = 1000
"""Taken where a client gives 0."""
MAX_TIMEOUT_MS = 60_000
MAX_SOURCES = 64
"""Sources at a time, the robot's own included."""
MAX_NAME = 64
"""Characters of a name."""

_MILLISECOND = MICROSECONDS // 1000


class InputAction(IntEnum):
    """What SetMcInputSource is to do. The vendor's numbers."""

    ADD = 1001
    MODIFY = 1002
    DELETE = 1003
    ENABLE = 2001
    DISABLE = 2002


@dataclass(frozen=True)
class InputSource:
    """A source of velocities."""

    name: str
    priority: int
    timeout_ms: int = DEFAULT_TIMEOUT_MS
    """After this long without a velocity another source takes over; without any other the robot stops walking."""


OWN_SOURCES = (
    InputSource("rc", 80),
    InputSource("vr", 70),
    InputSource("app_proxy", 60),
    InputSource("interaction", 50),
    InputSource("pnc", 40),
)
"""The robot's own, there from the start."""
_OWN_NAMES = frozenset(source.name for source in OWN_SOURCES)


class InputRefused(ValueError):
    """A request that is not carried out; the message says why."""


@dataclass(frozen=True)
class _Entry:
    source: InputSource
    enabled: bool = True
    heard_us: int | None = None
    """When it last sent a velocity; None if never."""
    arrival: int = 0
    """Its place among those that began to send, without a break longer than their time-out since."""

    def active(self, now_us: int) -> bool:
        heard = self.heard_us
        return self.enabled and heard is not None and now_us - heard < self.source.timeout_ms * _MILLISECOND


class InputSources:
    """The registered sources. Times are those of any one clock, microseconds."""

    def __init__(self) -> None:
        self._entries = {source.name: _Entry(source) for source in OWN_SOURCES}
        self._current: str | None = None
        self._arrivals = 0

    def change(self, action: int, wanted: InputSource) -> None:
        """Carry out a request.

        Args:
            action: a number of `InputAction`.
            wanted: the source; of its fields only those matter that the action needs. A time-out of 0 is the default.

        Raises:
            InputRefused: it is not carried out.
        """
        if action not in _ACTIONS:
            raise InputRefused(f"action {action} is none of {_action_numbers()}")
        known = self._entries.get(wanted.name)
        if (action == InputAction.ADD) == (known is not None):
            state = "registered already" if known else "not registered"
            raise InputRefused(f"the input source {wanted.name!r} is {state}")
        if action == InputAction.ADD:
            if len(self._entries) >= MAX_SOURCES:
                raise InputRefused(f"there are {MAX_SOURCES} input sources already")
            self._entries[wanted.name] = _Entry(_checked(wanted))
            return
        assert known is not None
        if action in (InputAction.MODIFY, InputAction.DELETE) and wanted.name in _OWN_NAMES:
            raise InputRefused(f"{wanted.name!r} is one of the robot's own input sources and stays as it is")
        if action == InputAction.DELETE:
            del self._entries[wanted.name]
            if self._current == wanted.name:
                self._current = None
        elif action == InputAction.MODIFY:
            self._entries[wanted.name] = replace(known, source=_checked(wanted))
        else:
            self._entries[wanted.name] = replace(known, enabled=action == InputAction.ENABLE, heard_us=None)

    def find(self, name: str) -> InputSource | None:
        """A registered source."""
        entry = self._entries.get(name)
        return None if entry is None else entry.source

    def is_enabled(self, name: str) -> bool:
        """Whether a registered source is enabled."""
        return self._entries[name].enabled

    def hear(self, name: str, now_us: int) -> bool:
        """A registered, enabled source has sent a velocity; whether it counts, since no other one is preferred."""
        entry = self._entries[name]
        if not entry.active(now_us):
            self._arrivals += 1
            entry = replace(entry, arrival=self._arrivals)
        self._entries[name] = replace(entry, heard_us=now_us)
        chosen = self.current(now_us)
        return chosen is not None and chosen.name == name

    def current(self, now_us: int) -> InputSource | None:
        """The source that counts: the preferred of the active ones, else the one that counted last; None before any."""
        active = [entry for entry in self._entries.values() if entry.active(now_us)]
        if active:
            best = max(active, key=lambda entry: (entry.source.priority, -entry.arrival))
            self._current = best.source.name
        return None if self._current is None else self._entries[self._current].source


_ACTIONS = MappingProxyType({action.value: action for action in InputAction})


def _action_numbers() -> str:
    return ", ".join(f"{action.value} {action.name}" for action in InputAction)


def _checked(source: InputSource) -> InputSource:
    """The source with its time-out filled in.

    Raises:
        InputRefused: a field is out of range.
    """
    low, high = PRIORITY_RANGE
    if not (0 < len(source.name) <= MAX_NAME and source.name.isprintable()):
        raise InputRefused(f"name must be 1 to {MAX_NAME} printable characters")
    if not low <= source.priority <= high:
        raise InputRefused(f"priority must be from {low} to {high}, got {source.priority}")
    if not 0 <= source.timeout_ms <= MAX_TIMEOUT_MS:
        raise InputRefused(
            f"timeout must be from 1 to {MAX_TIMEOUT_MS} ms, or 0 for {DEFAULT_TIMEOUT_MS}, got {source.timeout_ms}"
        )
    return source if source.timeout_ms else replace(source, timeout_ms=DEFAULT_TIMEOUT_MS)
