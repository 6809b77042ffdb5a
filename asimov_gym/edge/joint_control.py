"""Joint control at the edge, whatever carries it: runs, streams of joint commands, states at 333 Hz, the fault.

The port counts as one client among the others, below the rooms and above the motion modes, however many programs use
it: leases are not asked for. One stream of joint commands may be open at a time. While anything of it is open, a run, a
stream or somebody who takes states, the physics runs at 1 kHz, so that each state is a new one.

    with JointControlPort(robot.edge) as port:
        stream = port.open_stream()
        stream.update(JointCommand(...))  # the first one with gains; kept until the run begins
        port.begin()
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from types import TracebackType

import numpy as np

from asimov_gym.edge.control import Client, Source
from asimov_gym.edge.edge import Edge
from asimov_gym.edge.events import Code
from asimov_gym.edge.listener import EdgeListener
from asimov_gym.edge.verdict import DropReason, Note, Verdict
from asimov_gym.firmware import (
    MICROSECONDS,
    Command,
    Damp,
    FirmwareState,
    Freeze,
    JointCommand,
    JointSample,
    Refusal,
    RunEnd,
    Stand,
    Stream,
)

_log = logging.getLogger(__name__)

JOINT_CLIENT = Client(Source.JOINT_CONTROL, "joint-control")
"""Who commands through a port, in events and recordings."""
SAMPLES_PER_STATE = 3
"""Physics steps of 1 ms per state: 333 states a second."""

_REFUSED = {
    Refusal.EXPIRED: DropReason.JOINT_EXPIRED,
    Refusal.TOO_DISTANT: DropReason.JOINT_TOO_DISTANT,
    Refusal.NO_GAINS: DropReason.JOINT_NO_GAINS,
}
_RAN_OUT = (RunEnd.EXPIRED, RunEnd.SILENT)
"""Ends that a stream learns of with its next joint command; the others end it at once."""

StateReceiver = Callable[[tuple[JointSample, ...]], None]
"""Gets the samples since the state before; the last one is the state. Called with the edge's lock held: be quick."""


class CommandStream:
    """A stream of joint commands, from `JointControlPort.open_stream`.

    Args:
        port: that it belongs to.
        on_end: called once, with the edge's lock held, when the robot ends a run that this stream had a part in.
    """

    def __init__(self, port: JointControlPort, on_end: Callable[[RunEnd], None]) -> None:
        self._port = port
        self._on_end = on_end
        self._began_us: int | None = None
        self._runs = port.edge.firmware.joints.runs
        self._took_part = False

    def update(self, command: JointCommand, payload: bytes = b"") -> Verdict:
        """Take a joint command.

        Before the run it is kept, for as long as a run would wait for it; after the run, and after that time, it is
        dropped as JOINT_INACTIVE.

        Args:
            command: times are microseconds of the robot's clock (`edge.clock.now_us`).
            payload: what the client sent, for the recording.
        """
        edge, joints = self._port.edge, self._port.edge.firmware.joints
        with edge.lock:
            now_us = edge.clock.now_us()
            if self._began_us is None:
                self._began_us = now_us
            if joints.running:
                self._took_part = True
            reason = self._reason_to_drop(now_us)
            if reason is None:
                refusal = joints.take(command, now_us, edge.clock.realtime_us())
                reason = None if refusal is None else _REFUSED[refusal]
            notes = () if reason is not None else self._notes(command)
            return edge.report(JOINT_CLIENT, payload, Verdict("joint_command", reason, notes))

    def refuse(self, payload: bytes) -> Verdict:
        """Count a joint command that could not be read."""
        return self._port.edge.report(JOINT_CLIENT, payload, Verdict("joint_command", DropReason.JOINT_INVALID))

    def _reason_to_drop(self, now_us: int) -> DropReason | None:
        joints = self._port.edge.firmware.joints
        if joints.running:
            return None if self._port.edge.claim(JOINT_CLIENT) else DropReason.NOT_IN_CONTROL
        assert self._began_us is not None
        waited = now_us - self._began_us >= joints.config.wait_s * MICROSECONDS
        if self._took_part or joints.runs != self._runs or waited:
            return DropReason.JOINT_INACTIVE
        return None

    def _notes(self, command: JointCommand) -> tuple[Note, ...]:
        joints, notes = self._port.edge.firmware.joints, []
        limits, gains = joints.limits, command.gains
        if not joints.running:
            notes.append(Note.JOINT_WAITING)
        if ((command.position < limits.low) | (command.position > limits.high)).any():
            notes.append(Note.POSITION_CLAMPED)
        if (np.abs(command.load) > limits.load(command.position)).any():
            notes.append(Note.LOAD_CLAMPED)
        if gains is not None and gains.within(joints.config.kp_limit, joints.config.kd_limit) is not gains:
            notes.append(Note.GAIN_CLAMPED)
        return tuple(notes)

    def run_ended(self, why: RunEnd) -> None:
        """The port tells of a run that has ended."""
        if self._took_part and why not in _RAN_OUT:
            self._on_end(why)

    def run_lasts(self) -> None:
        """The port tells that a run lasts while this stream is open."""
        self._took_part = True

    def close(self) -> None:
        """The client has ended the stream. A run goes on to the end of its last joint command."""
        self._port.close_stream(self)


class JointControlPort(EdgeListener):
    """Joint control of one robot; use between `attach` and `detach`, or as a context manager.

    Args:
        edge: of a `SimulatedRobot`, in real time or in lockstep.
    """

    def __init__(self, edge: Edge) -> None:
        self.edge = edge
        self._stream: CommandStream | None = None
        self._receivers: list[StateReceiver] = []
        self._samples: list[JointSample] = []
        joints = edge.firmware.joints
        self._seen_runs, self._seen_running, self._seen_fault = joints.runs, joints.running, joints.fault

    @property
    def wants_samples(self) -> bool:  # type: ignore[override]  # constant for most listeners, not for this one
        """Whether joint control is open."""
        return bool(self._receivers) or self._stream is not None or self.edge.firmware.joints.running

    def attach(self) -> None:
        """Take part from now on."""
        self.edge.attach(self)

    def detach(self) -> None:
        """Take part no more: a run ends in DAMP, the stream and those who take states are forgotten."""
        with self.edge.lock:
            if self.edge.firmware.joints.running:
                self.edge.submit(Damp(), JOINT_CLIENT, b"", "joint_power_off")
                self._tell()
            self._stream = None
            self._receivers.clear()
            self.edge.leave(JOINT_CLIENT)
            self.edge.detach(self)

    def __enter__(self) -> JointControlPort:
        self.attach()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.detach()

    # -- commands ----------------------------------------------------------------------------------

    def begin(self, payload: bytes = b"") -> Verdict:
        """Begin a run: the joints follow the stream. From any mode; refused while there is a fault of any kind."""
        return self._submit(Stream(), payload, "joint_start")

    def stand(self, payload: bytes = b"") -> Verdict:
        """Go to STAND."""
        return self._submit(Stand(), payload, "joint_stop")

    def freeze(self, payload: bytes = b"") -> Verdict:
        """Hold every joint where it is."""
        return self._submit(Freeze(), payload, "joint_freeze")

    def power_off(self, payload: bytes = b"") -> Verdict:
        """Go to DAMP, and clear the fault of joint control."""
        with self.edge.lock:
            verdict = self._submit(Damp(), payload, "joint_power_off")
            joints = self.edge.firmware.joints
            if joints.fault is not None:
                joints.clear_fault(joints.fault.number)
                self._tell()
            return verdict

    def clear_fault(self, number: int, payload: bytes = b"") -> Verdict:
        """Clear the fault of joint control; dropped as JOINT_FAULT if there is none of that number."""
        with self.edge.lock:
            cleared = self.edge.firmware.joints.clear_fault(number)
            reason = None if cleared else DropReason.JOINT_FAULT
            verdict = self.edge.report(JOINT_CLIENT, payload, Verdict("joint_clear_fault", reason))
            self._tell()
            return verdict

    def refuse(self, kind: str, reason: DropReason, payload: bytes = b"") -> Verdict:
        """Count a command that the port does not take."""
        return self.edge.report(JOINT_CLIENT, payload, Verdict(kind, reason))

    def _submit(self, command: Command, payload: bytes, kind: str) -> Verdict:
        with self.edge.lock:
            verdict = self.edge.submit(command, JOINT_CLIENT, payload, kind)
            self._tell()
            return verdict

    # -- streams -----------------------------------------------------------------------------------

    def open_stream(self, on_end: Callable[[RunEnd], None] = lambda why: None) -> CommandStream | None:
        """Open the stream of joint commands; None if there is one already.

        Args:
            on_end: called, with the edge's lock held, when the robot ends the run otherwise than by letting the last
                joint command run out.
        """
        with self.edge.lock:
            if self._stream is not None:
                return None
            self._stream = CommandStream(self, on_end)
            if self.edge.firmware.joints.running:
                self._stream.run_lasts()
            return self._stream

    def close_stream(self, stream: CommandStream) -> None:
        """Close it; no effect if it is closed."""
        with self.edge.lock:
            if self._stream is not stream:
                return
            self._stream = None
            joints = self.edge.firmware.joints
            if not joints.running:
                joints.forget_stream()
                self.edge.leave(JOINT_CLIENT)

    def subscribe(self, receiver: StateReceiver) -> None:
        """Hand a receiver every state from now on."""
        with self.edge.lock:
            self._receivers.append(receiver)

    def unsubscribe(self, receiver: StateReceiver) -> None:
        """Stop that; no effect if it was not subscribed."""
        with self.edge.lock:
            self._receivers = [known for known in self._receivers if known != receiver]

    # -- the loop ----------------------------------------------------------------------------------

    def on_sample(self, sample: JointSample) -> None:
        """A physics step is done."""
        self._tell()
        self._samples.append(sample)
        if len(self._samples) >= SAMPLES_PER_STATE:
            samples, self._samples = tuple(self._samples), []
            for receiver in self._receivers:
                receiver(samples)

    def on_tick(self, state: FirmwareState) -> None:
        """A control step is done."""
        self._tell()

    def _tell(self) -> None:
        """Tell stream and clients what has changed with the run and its fault."""
        joints = self.edge.firmware.joints
        if joints.runs != self._seen_runs:
            self._seen_runs, self._seen_running = joints.runs, True
            self._event(f"run {joints.runs} began")
            if self._stream is not None:
                self._stream.run_lasts()
        if joints.fault is not self._seen_fault:
            before, self._seen_fault = self._seen_fault, joints.fault
            self._event(f"fault {before.number} cleared" if joints.fault is None and before else str(joints.fault))
        if self._seen_running and not joints.running:
            self._seen_running = False
            why = joints.ended or RunEnd.RESTARTED
            self._event(f"run {joints.runs} ended: {why.value}")
            if self._stream is None:
                self.edge.leave(JOINT_CLIENT)
            else:
                self._stream.run_ended(why)

    def _event(self, message: str) -> None:
        _log.info("joint control: %s", message)
        self.edge.error(Code.JOINT_CONTROL, message)
