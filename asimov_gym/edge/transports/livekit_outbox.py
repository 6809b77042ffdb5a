"""What the robot has to say in a room, kept until the room takes it."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from asimov_gym.edge.control import Dialect
from asimov_gym.edge.listener import EdgeListener

EVENTS_KEPT = 500
"""Events held while the room is away; beyond it the oldest is lost. (A recording has them all.)"""


@dataclass(frozen=True)
class Report:
    """One sample of the robot's state."""

    timestamp_us: int
    """Edge wall clock."""
    packet: bytes


class Outbox(EdgeListener):
    """Filled by the edge, emptied by the room.

    Of reports the newest counts: what the room has not taken when the next one comes is lost, as on any lossy lane.
    Events queue in order.

    Args:
        dialects: whose reports are wanted. Events belong to dialect `cloud`.
    """

    def __init__(self, dialects: tuple[Dialect, ...]) -> None:
        self.wants_robot_state = Dialect.IO in dialects
        self.replaced = 0
        """Reports that a newer one replaced before the room took them."""
        self.lost_events = 0
        self._cloud = Dialect.CLOUD in dialects
        self._lock = threading.Lock()
        self._reports: dict[Dialect, Report] = {}
        self._events: deque[bytes] = deque()
        self._wake: Callable[[], object] | None = None

    # -- the room's side -------------------------------------------------------------------------------

    def on_filled(self, wake: Callable[[], object] | None) -> None:
        """Have a function called, from any thread, when something was put in; None for nothing."""
        with self._lock:
            self._wake = wake

    def take_reports(self) -> dict[Dialect, Report]:
        """The newest reports that were not yet taken."""
        with self._lock:
            taken, self._reports = self._reports, {}
            return taken

    def next_event(self) -> bytes | None:
        """The oldest event. It stays until `event_sent`, so that none is lost with the connection."""
        with self._lock:
            return self._events[0] if self._events else None

    def event_sent(self, packet: bytes) -> None:
        """Take the oldest event out, if it is this one."""
        with self._lock:
            if self._events and self._events[0] is packet:
                self._events.popleft()

    # -- the edge's side -------------------------------------------------------------------------------

    def on_telemetry(self, timestamp_us: int, packet: bytes) -> None:
        if self._cloud:
            self._put(Dialect.CLOUD, Report(timestamp_us, packet))

    def on_robot_state(self, timestamp_us: int, packet: bytes, report: bool) -> None:
        if report and self.wants_robot_state:
            self._put(Dialect.IO, Report(timestamp_us, packet))

    def on_event(self, timestamp_us: int, packet: bytes) -> None:
        if not self._cloud:
            return
        with self._lock:
            if len(self._events) >= EVENTS_KEPT:
                self._events.popleft()
                self.lost_events += 1
            self._events.append(packet)
            wake = self._wake
        if wake is not None:
            wake()

    def _put(self, dialect: Dialect, report: Report) -> None:
        with self._lock:
            self.replaced += dialect in self._reports
            self._reports[dialect] = report
            wake = self._wake
        if wake is not None:
            wake()
