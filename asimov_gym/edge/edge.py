"""The edge: between the firmware and whatever carries packets. Knows bytes and clients, no transport.

`receive` takes one packet from one client, `tick` runs after every control step and emits telemetry (10 Hz) and events.
Transports, the in-process session and the recorder attach as listeners.
"""

from __future__ import annotations

import logging
import threading
from typing import Protocol

from asimov_gym.edge.control import Client, Control, Handover
from asimov_gym.edge.decode import decode, parse
from asimov_gym.edge.diagnostics import diagnostics
from asimov_gym.edge.events import ChangeWatch, Code, error, handover
from asimov_gym.edge.telemetry import UINT32, AppliedCommand, MediaTimes, telemetry
from asimov_gym.edge.verdict import DROPPED_BY_FIRMWARE, Dropped, DropReason, Note, Tally, Verdict
from asimov_gym.edge.wire import cloud_pb2
from asimov_gym.firmware import MICROSECONDS, Clock, Damp, Firmware, FirmwareState, Outcome, Stand

_log = logging.getLogger(__name__)

TELEMETRY_PERIOD_US = MICROSECONDS // 10
DIAGNOSTICS_PERIOD_US = MICROSECONDS
"""Period of the diagnostics event; ours, none is published."""


class EdgeListener(Protocol):
    """Gets a copy of everything that passes. Called with the edge's lock held: be quick, do not call back."""

    def on_command(self, received_us: int, client: Client, packet: bytes, verdict: Verdict) -> None:
        """A packet came in and got a verdict. `received_us` is the edge's wall clock."""
        ...

    def on_telemetry(self, timestamp_us: int, packet: bytes) -> None:
        """A serialized EdgeTelemetry went out."""
        ...

    def on_event(self, timestamp_us: int, packet: bytes) -> None:
        """A serialized EdgeEvent went out."""
        ...


class Edge:
    """Validates commands, reports state.

    Args:
        firmware: takes the commands and gives the states.
        clock: the same as the firmware's.
    """

    def __init__(self, firmware: Firmware, clock: Clock) -> None:
        self.firmware = firmware
        self.clock = clock
        self.lock = threading.RLock()
        """Held while a packet is taken or a tick runs."""
        self.tally = Tally()
        """Verdicts so far, counted."""
        self.control = Control()
        self.media = MediaTimes()
        """Set by whoever sends media."""
        self._listeners: list[EdgeListener] = []
        self._watch = ChangeWatch()
        self._waiting: list[tuple[int, int]] = []
        self._applied: AppliedCommand | None = None
        self._telemetry_sequence = 0
        self._event_sequence = 0
        now = clock.now_us()
        self._telemetry_due_us = now + TELEMETRY_PERIOD_US
        self._diagnostics_due_us = now + DIAGNOSTICS_PERIOD_US
        self.latest = self._telemetry(firmware.snapshot)
        """The last EdgeTelemetry, serialized. There is one from the start."""

    # -- listeners ---------------------------------------------------------------------------------

    def attach(self, listener: EdgeListener) -> None:
        """Give a listener a copy of everything from now on."""
        with self.lock:
            self._listeners.append(listener)

    def detach(self, listener: EdgeListener) -> None:
        """Stop that; no effect if it was not attached."""
        with self.lock:
            self._listeners = [known for known in self._listeners if known is not listener]

    # -- commands ----------------------------------------------------------------------------------

    def receive(self, packet: bytes, client: Client) -> Verdict:
        """Take one packet of the commands channel.

        Args:
            packet: a serialized CloudCommand, or whatever came in.
            client: who sent it.

        Returns:
            What became of it. For counters and recordings: it must not be sent to the client.
        """
        with self.lock:
            received_us = self.clock.realtime_us()
            verdict = self._judge(packet, client, received_us)
            self.tally.add(verdict, client.name)
            for listener in self._listeners:
                listener.on_command(received_us, client, packet, verdict)
            return verdict

    def _judge(self, packet: bytes, client: Client, received_us: int) -> Verdict:
        kind = ""
        try:
            message = parse(packet)
            kind = message.WhichOneof("command") or ""
            decoded = decode(message, self.firmware.linkage)
            self._claim(client, exempt=isinstance(decoded.command, Damp))
            receipt = self.firmware.command(decoded.command)
            if receipt.outcome is not Outcome.TAKEN:
                raise Dropped(DROPPED_BY_FIRMWARE[receipt.outcome])
        except Dropped as dropped:
            return Verdict(kind, dropped.reason)
        self._waiting.append((message.sequence, received_us))
        notes = list(decoded.notes)
        if receipt.clamped:
            notes.append(Note.COMMAND_CLAMPED)
        if isinstance(decoded.command, Stand) and self.firmware.alerts.latched:
            notes.append(Note.LATCHED)
        return Verdict(kind, None, tuple(notes))

    def _claim(self, client: Client, exempt: bool) -> None:
        """One controller at a time; DAMP is exempt, and takes no control away."""
        if exempt and client != self.control.holder:
            return
        granted, change = self.control.claim(client, self.clock.now_us())
        if change is not None:
            self._emit_handover(change)
        if not granted:
            raise Dropped(DropReason.NOT_IN_CONTROL)

    def leave(self, client: Client) -> None:
        """A client has gone: control is free if it had it. Its last velocity holds, its trajectory times out."""
        with self.lock:
            change = self.control.leave(client)
            if change is not None:
                self._emit_handover(change)

    # -- telemetry and events ----------------------------------------------------------------------

    def tick(self, state: FirmwareState) -> None:
        """Report the state after a control step: events at once, telemetry and diagnostics when they are due."""
        with self.lock:
            for event in self._watch.events(state):
                self.emit(event)
            now, wall = self.clock.now_us(), self.clock.realtime_us()
            for sequence, received_us in self._waiting:
                self._applied = AppliedCommand(sequence, received_us, max(0, wall - received_us))
            self._waiting.clear()
            if now >= self._telemetry_due_us:
                self._telemetry_due_us = _next_due(self._telemetry_due_us, TELEMETRY_PERIOD_US, now)
                self.latest = self._telemetry(state)
                for listener in self._listeners:
                    listener.on_telemetry(wall, self.latest)
            if now >= self._diagnostics_due_us:
                self._diagnostics_due_us = _next_due(self._diagnostics_due_us, DIAGNOSTICS_PERIOD_US, now)
                holder = self.control.holder
                self.emit(diagnostics(self.firmware, "" if holder is None else holder.name))

    def emit(self, event: cloud_pb2.EdgeEvent) -> None:
        """Stamp an event and send it."""
        with self.lock:
            event.timestamp_us = self.clock.realtime_us()
            self._event_sequence = (self._event_sequence + 1) % UINT32
            event.sequence = self._event_sequence
            packet = event.SerializeToString()
            for listener in self._listeners:
                listener.on_event(event.timestamp_us, packet)

    def overload(self, factor: float) -> None:
        """Say that the simulation runs at `factor` times real time only."""
        _log.warning("overload: the simulation runs at %.2f times real time", factor)
        message = f"{factor:.2f} times real time"
        self.emit(error(Code.OVERLOAD, message, cloud_pb2.SUBSYSTEM_FW_LINK))

    def _emit_handover(self, change: Handover) -> None:
        self.emit(handover(change))

    def _telemetry(self, state: FirmwareState) -> bytes:
        self._telemetry_sequence = (self._telemetry_sequence + 1) % UINT32
        age = self.firmware.now_us - state.timestamp_us
        message = telemetry(state, self._telemetry_sequence, self.clock.realtime_us(), age, self._applied, self.media)
        return message.SerializeToString()


def _next_due(due_us: int, period_us: int, now_us: int) -> int:
    """The next multiple of the period; after a long stall, one period from now instead of a burst."""
    following = due_us + period_us
    return following if following > now_us else now_us + period_us
