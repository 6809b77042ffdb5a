"""The edge: between the firmware and whatever carries packets. Knows bytes and clients, no transport.

`receive` takes one packet from one client, `tick` runs after every control step and emits telemetry (10 Hz), RobotState
(200 Hz, where a lane wants it) and events. Transports, sessions and the recorder attach as listeners.
"""

from __future__ import annotations

import logging
import threading
from dataclasses import replace

from asimov_gym.edge.arming import Arming
from asimov_gym.edge.command_order import CommandOrder
from asimov_gym.edge.control import Client, Control, Dialect, Handover
from asimov_gym.edge.decode import Parsed, decode, parse
from asimov_gym.edge.diagnostics import LaneStatus, diagnostics
from asimov_gym.edge.dialect import RULES
from asimov_gym.edge.events import ChangeWatch, Code, boot_progress, error, handover
from asimov_gym.edge.listener import EdgeListener, Listeners
from asimov_gym.edge.robot_state import robot_state
from asimov_gym.edge.telemetry import UINT32, AppliedCommand, MediaTimes, telemetry
from asimov_gym.edge.verdict import DROPPED_BY_FIRMWARE, Dropped, DropReason, Note, Tally, Verdict
from asimov_gym.edge.wire import cloud_pb2
from asimov_gym.firmware import (
    MICROSECONDS,
    Clock,
    Command,
    Damp,
    Firmware,
    FirmwareState,
    Outcome,
    Stand,
    State,
    Trajectory,
    Velocity,
)

_log = logging.getLogger(__name__)

TELEMETRY_PERIOD_US = MICROSECONDS // 10
DIAGNOSTICS_PERIOD_US = MICROSECONDS
"""Period of the diagnostics event; ours, none is published."""


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
        self.lanes = LaneStatus()
        self._media = MediaTimes()
        self._arming = Arming()
        self._order = CommandOrder()
        self._listeners = Listeners()
        self._watch = ChangeWatch()
        self._taken: tuple[int, int] | None = None
        self._applied: AppliedCommand | None = None
        self._telemetry_sequence = 0
        self._event_sequence = 0
        now = clock.now_us()
        self._telemetry_due_us = now + TELEMETRY_PERIOD_US
        self._diagnostics_due_us = now + DIAGNOSTICS_PERIOD_US
        self._boot = 0
        self.latest = self._telemetry(firmware.snapshot)
        """The last EdgeTelemetry, serialized. There is one from the start."""
        self.latest_robot_state = robot_state(firmware.snapshot, 0, alerts=True).SerializeToString()
        """The last RobotState, serialized. There is one from the start; it ages while no listener wants any."""

    # -- listeners ---------------------------------------------------------------------------------

    def attach(self, listener: EdgeListener) -> None:
        """Give a listener a copy of everything from now on."""
        with self.lock:
            self._listeners.add(listener)

    def detach(self, listener: EdgeListener) -> None:
        """Stop that; no effect if it was not attached."""
        with self.lock:
            self._listeners.remove(listener)

    # -- commands ----------------------------------------------------------------------------------

    def receive(self, packet: bytes, client: Client, streamed: bool = False) -> Verdict:
        """Take one packet of the commands channel.

        Args:
            packet: a serialized CloudCommand or RobotCommand, or whatever came in.
            client: who sent it.
            streamed: it came by a lossy lane beside the reliable one, and is dropped when it is older than a command
                already taken.

        Returns:
            What became of it. For counters and recordings: it must not be sent to the client.
        """
        with self.lock:
            received_us = self.clock.realtime_us()
            return self.report(client, packet, self._judge(packet, client, received_us, streamed), received_us)

    def submit(
        self, command: Command, client: Client, payload: bytes, kind: str, notes: tuple[Note, ...] = ()
    ) -> Verdict:
        """Take a command that a lane has read and checked by rules of its own.

        Control, mode machine, counters and recording are those of `receive`; the two dialects' rules do not apply.

        Args:
            command: what the firmware is to do.
            client: who sent it.
            payload: what the client sent, for the recording.
            kind: what it was, in a word, for counters and recording.
            notes: what the lane changed in it.

        Returns:
            What became of it.
        """
        with self.lock:
            try:
                self._claim(client, exempt=isinstance(command, Damp))
                verdict = Verdict(kind, None, (*notes, *self._command(command)))
            except Dropped as dropped:
                verdict = Verdict(kind, dropped.reason)
            return self.report(client, payload, verdict)

    def report(self, client: Client, payload: bytes, verdict: Verdict, received_us: int | None = None) -> Verdict:
        """Count a verdict and tell the listeners. For lanes that refuse, or answer, without asking the firmware.

        Args:
            client: who sent it.
            payload: what was sent.
            verdict: what became of it.
            received_us: edge wall clock; None for now.

        Returns:
            The verdict.
        """
        with self.lock:
            received_us = self.clock.realtime_us() if received_us is None else received_us
            self.tally.add(verdict, client.name)
            at = received_us
            self._listeners.tell(lambda listener: listener.on_command(at, client, payload, verdict))
            return verdict

    def _judge(self, packet: bytes, client: Client, received_us: int, streamed: bool) -> Verdict:
        parsed: Parsed | None = None
        try:
            parsed = parse(packet, client.dialects)
            decoded = decode(parsed, self.firmware.linkage, client, self.firmware.snapshot.epoch)
            if streamed and self._order.is_stale(client, parsed.sequence):
                raise Dropped(DropReason.STALE)
            self._claim(client, exempt=isinstance(decoded.command, Damp))
            self._gate(decoded.command, parsed.dialect)
            notes = (*decoded.notes, *self._command(decoded.command))
        except Dropped as dropped:
            if parsed is None:
                return Verdict("", dropped.reason)
            return Verdict(parsed.kind, dropped.reason, dialect=parsed.dialect)
        self._order.take(client, parsed.dialect, parsed.sequence)
        self._taken = (parsed.sequence, received_us)
        return Verdict(parsed.kind, None, notes, parsed.dialect)

    def _command(self, command: Command) -> list[Note]:
        """Hand a command to the firmware; what there is to say of it when it was taken."""
        receipt = self.firmware.command(command)
        if receipt.outcome is not Outcome.TAKEN:
            raise Dropped(DROPPED_BY_FIRMWARE[receipt.outcome])
        if isinstance(command, Damp):
            self._arming.disarm()
        notes = [Note.COMMAND_CLAMPED] if receipt.clamped else []
        if isinstance(command, Stand) and self.firmware.alerts.latched:
            notes.append(Note.LATCHED)
        if isinstance(command, Stand) and self.firmware.e_stopped:
            notes.append(Note.E_STOPPED)
        return notes

    def claim(self, client: Client) -> bool:
        """Ask for control on behalf of a client whose stream the firmware takes without a command.

        Returns:
            Whether it is in control. While the emergency stop is pressed that says nothing: nobody gains control.
        """
        with self.lock:
            try:
                self._claim(client, exempt=False)
            except Dropped:
                return False
            return True

    def _claim(self, client: Client, exempt: bool) -> None:
        """One controller at a time; DAMP is exempt, and takes no control away."""
        if (exempt and client != self.control.holder) or self.firmware.e_stopped:
            return  # while the emergency stop is pressed the firmware refuses what it must; nobody gains control
        granted, change = self.control.claim(client, self.clock.now_us())
        if change is not None:
            self._emit_handover(change)
        if not granted:
            raise Dropped(DropReason.NOT_IN_CONTROL)

    def _gate(self, command: Command, dialect: Dialect) -> None:
        """What a dialect refuses although the mode machine would take it."""
        rules = RULES[dialect]
        state = self.firmware.state
        if state is State.DAMP and isinstance(command, Trajectory) and not rules.trajectory_from_damp:
            raise Dropped(DropReason.TRAJECTORY_IN_DAMP)
        leaves_stand = state is State.STAND and isinstance(command, Velocity | Trajectory)
        if leaves_stand and not self._arming.armed(self.clock.now_us(), rules.arming_s):
            raise Dropped(DropReason.NOT_ARMED)

    def leave(self, client: Client) -> None:
        """A client has gone: control is free if it had it and its velocity becomes zero. Its trajectory times out."""
        with self.lock:
            self._order.forget(client)
            change = self.control.leave(client)
            if change is not None:
                self.firmware.stop_walking()
                self._emit_handover(change)

    def e_stop(self, pressed: bool) -> None:
        """Press or release the emergency stop. While it is pressed the robot is in DAMP and stays there."""
        with self.lock:
            self.firmware.e_stop(pressed)
            self._arming.disarm()
            change = self.control.e_stop(pressed)
            if change is not None:
                self._emit_handover(change)
                self.error(Code.E_STOP, "pressed" if pressed else "released")

    # -- telemetry and events ----------------------------------------------------------------------

    def tick(self, state: FirmwareState) -> None:
        """Report the state after a control step: events at once, telemetry and diagnostics when they are due."""
        with self.lock:
            if state.boot != self._boot:
                self._boot = state.boot
                for event in boot_progress(self.firmware):
                    self.emit(event)
            self._listeners.tell(lambda listener: listener.on_tick(state))
            for event in self._watch.events(state):
                self.emit(event)
            now, wall = self.clock.now_us(), self.clock.realtime_us()
            self._arming.update(state, now)
            report = now >= self._telemetry_due_us
            self._send_robot_state(state, wall, report)
            if self._taken is not None:
                sequence, received_us = self._taken
                self._applied = AppliedCommand(sequence, received_us, max(0, wall - received_us))
                self._taken = None
            if report:
                self._telemetry_due_us = _next_due(self._telemetry_due_us, TELEMETRY_PERIOD_US, now)
                self.latest = self._telemetry(state)
                self._listeners.tell(lambda listener: listener.on_telemetry(wall, self.latest))
            if now >= self._diagnostics_due_us:
                self._diagnostics_due_us = _next_due(self._diagnostics_due_us, DIAGNOSTICS_PERIOD_US, now)
                holder = self.control.holder
                self.emit(diagnostics(self.firmware, "" if holder is None else holder.name, self.lanes))

    @property
    def wants_samples(self) -> bool:
        """Whether a listener wants samples of joint control, for which the physics must run at 1 kHz."""
        return any(listener.wants_samples for listener in self._listeners.all)

    def sample(self) -> None:
        """Tell the listeners of the physics step that is just done."""
        with self.lock:
            sample = self.firmware.joint_sample()
            self._listeners.tell(lambda listener: listener.on_sample(sample))

    def _send_robot_state(self, state: FirmwareState, wall: int, report: bool) -> None:
        if not self._listeners.want_robot_state:
            return
        message = robot_state(state, self._order.last_taken(Dialect.IO), alerts=report)
        self.latest_robot_state = message.SerializeToString()
        packet = self.latest_robot_state
        self._listeners.tell(lambda listener: listener.on_robot_state(wall, packet, report))

    def emit(self, event: cloud_pb2.EdgeEvent) -> None:
        """Stamp an event and send it."""
        with self.lock:
            event.timestamp_us = self.clock.realtime_us()
            self._event_sequence = (self._event_sequence + 1) % UINT32
            event.sequence = self._event_sequence
            packet = event.SerializeToString()
            self._listeners.tell(lambda listener: listener.on_event(event.timestamp_us, packet))

    def error(
        self,
        code: Code,
        message: str,
        subsystem: cloud_pb2.Subsystem.ValueType = cloud_pb2.SUBSYSTEM_FIRMWARE,
    ) -> None:
        """Send an `EdgeError` event."""
        self.emit(error(code, message, subsystem))

    def note_video(self, timestamp_us: int) -> None:
        """A video frame was sent at this wall-clock time."""
        with self.lock:
            self._media = replace(self._media, video_us=timestamp_us)

    def note_audio(self, timestamp_us: int) -> None:
        """An audio frame was sent at this wall-clock time."""
        with self.lock:
            self._media = replace(self._media, audio_us=timestamp_us)

    def overload(self, factor: float) -> None:
        """Say that the simulation runs at `factor` times real time only."""
        _log.warning("overload: the simulation runs at %.2f times real time", factor)
        self.error(Code.OVERLOAD, f"{factor:.2f} times real time", cloud_pb2.SUBSYSTEM_FW_LINK)

    def _emit_handover(self, change: Handover) -> None:
        self.emit(handover(change))

    def _telemetry(self, state: FirmwareState) -> bytes:
        self._telemetry_sequence = (self._telemetry_sequence + 1) % UINT32
        age = self.firmware.now_us - state.timestamp_us
        message = telemetry(state, self._telemetry_sequence, self.clock.realtime_us(), age, self._applied, self._media)
        return message.SerializeToString()


def _next_due(due_us: int, period_us: int, now_us: int) -> int:
    """The next multiple of the period; after a long stall, one period from now instead of a burst."""
    following = due_us + period_us
    return following if following > now_us else now_us + period_us
