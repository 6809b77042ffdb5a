"""A client's session with a robot: the same verbs over any lane.

    with connect(robot) as session:                              # a SimulatedRobot in this process
    with connect("udp://127.0.0.1") as session:                  # the UDP lane, simulated or not
    with connect("wss://example.org", token=token) as session:   # a LiveKit room

Commands are never answered, state is the latest sample, events queue in order. Arguments and reports are always the
contract's: joint arrays in firmware order, ankles as motors A and B, EdgeTelemetry; where the lane speaks the other
dialect the session translates.
"""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from types import TracebackType
from typing import Any
from urllib.parse import urlsplit

import numpy as np

from asimov_gym.edge.clients.channels import CommandChannel, StateChannel, SystemChannel
from asimov_gym.edge.clients.commands import WRITERS, CommandMessage
from asimov_gym.edge.clients.in_process import InProcessLink
from asimov_gym.edge.clients.link import Link
from asimov_gym.edge.clients.reports import Arrival, ReportReader
from asimov_gym.edge.clients.udp import CONTROL_PORT, FACTS_PORT, STATE_PORT, UdpLink
from asimov_gym.edge.clients.velocity_hold import VelocityHold
from asimov_gym.edge.control import Client, Dialect, Source
from asimov_gym.edge.robot import SimulatedRobot
from asimov_gym.edge.telemetry import UINT32
from asimov_gym.edge.wire import cloud_pb2
from asimov_gym.robot.joints import JOINT_NAMES

_numbers = itertools.count(1)


def _wall_clock_us() -> int:
    return time.time_ns() // 1000


class Session:
    """A connected client. Made by `connect`; to be closed, or used as a context manager.

    The verbs check their arguments and raise; `commands.send` sends anything. Each verb returns the command's sequence
    number, which telemetry echoes in `applied_cmd.seq` once the robot has taken it. All methods may be called from any
    thread.

    Args:
        link: not yet opened.
        timeout: s; how long to wait for the first sample once the link is open.
        now_us: clock that stamps the commands, microseconds.

    Raises:
        ConnectionError: the robot was not reached, or gives no state.
    """

    def __init__(self, link: Link, timeout: float = 5.0, now_us: Callable[[], int] = _wall_clock_us) -> None:
        self._link = link
        self._now_us = now_us
        self._sequence = 0
        self._closed = False
        self._sending = threading.Condition()
        self.commands = CommandChannel(link.send)
        self.state = StateChannel()
        self.system = SystemChannel()
        self._hold = VelocityHold(self._send_velocity, self._sending, lambda: self.state.age, link.velocity_expires)
        self._reader: ReportReader | None = None
        try:
            link.open(self)
            self._await_state(timeout)
        except BaseException:
            link.close()
            raise
        self._writer = WRITERS[link.dialect]

    def _await_state(self, timeout: float) -> None:
        if self.state.wait_first(timeout):
            return
        if self.state.lost is not None:
            raise ConnectionError(self.state.lost)
        foreign = self.state.arrivals[Arrival.MALFORMED]
        hint = f"{foreign} packets came that are no state of this robot" if foreign else self._link.silence_hint
        raise ConnectionError(f"no state from {self._link.address} within {timeout:g} s. {hint}")

    @property
    def facts(self) -> Mapping[str, Any] | None:
        """What the robot says of itself, such as `robot_model`; a simulated one has the key `simulator`."""
        return self._link.facts

    @property
    def dialect(self) -> Dialect:
        """What is spoken underneath."""
        return self._link.dialect

    # -- verbs -------------------------------------------------------------------------------------

    def stand(self) -> int:
        """Take the standing pose, over about 2 s."""
        return self._send(self._writer.stand())

    def damp(self) -> int:
        """Go limp: the software stop. Works for every client at any time."""
        return self._send(self._writer.damp())

    def velocity(self, vx: float = 0.0, vy: float = 0.0, vyaw: float = 0.0) -> int:
        """Walk until told otherwise. Has no effect in DAMP.

        Over UDP, where the robot forgets a velocity after 2 s, the session sends it again every 0.1 s until the next
        verb or `close`; it stops doing so when the robot reports another mode than MOVE 1 s after the verb, restarts,
        or falls silent. Over UDP the robot also takes velocities only 0.5 s after it was upright in STAND.

        Args:
            vx: m/s, forward; clamped by the robot to ±2, over UDP and dialect `io` to ±0.4.
            vy: m/s, to the left; clamped to ±1, or ±0.4.
            vyaw: rad/s, counter-clockwise; clamped to ±2, or ±0.8.

        Raises:
            ValueError: a value is not finite.
        """
        for name, value in (("vx", vx), ("vy", vy), ("vyaw", vyaw)):
            if not np.isfinite(value):
                raise ValueError(f"{name} must be a finite number, got {value!r}")
        with self._sending:
            sequence = self._send_velocity(vx, vy, vyaw)
            self._hold.hold((vx, vy, vyaw))
            return sequence

    def trajectory(
        self,
        positions: Sequence[float] | np.ndarray,
        kp: Sequence[float] | np.ndarray | None = None,
        kd: Sequence[float] | np.ndarray | None = None,
    ) -> int:
        """Drive every motor to a position at once. The stream is the caller's: send again within 200 ms (over UDP and
        dialect `io` within 2 s), or the robot goes to DAMP.

        Args:
            positions: rad, 25, firmware order; the ankle entries are the motors A and B, as telemetry reports them.
                Dialect `io` limits an ankle to ±0.35 rad of pitch and ±0.1 rad of roll.
            kp: position gains at the motors, 25 from 0 to 500; None for the defaults.
            kd: damping gains at the motors, 25 from 0 to 5; None for the defaults. Dialect `io` takes kp and kd only
                together.

        Raises:
            ValueError: a wrong length, a value that is not finite, or a gain alone where both are needed.
        """
        message = self._writer.trajectory(
            _checked("positions", positions),
            None if kp is None else _checked("kp", kp),
            None if kd is None else _checked("kd", kd),
        )
        return self._send(message, streamed=True)

    def _send(self, command: CommandMessage, streamed: bool = False) -> int:
        with self._sending:
            sequence = self._stamp_and_send(command, streamed)
            self._hold.release()
            return sequence

    def _send_velocity(self, vx: float, vy: float, vyaw: float) -> int:
        with self._sending:
            return self._stamp_and_send(self._writer.velocity(vx, vy, vyaw), streamed=bool(vx or vy or vyaw))

    def _stamp_and_send(self, command: CommandMessage, streamed: bool) -> int:
        command.sequence = (self._sequence + 1) % UINT32
        command.timestamp_us = self._now_us()
        self.commands.send(command.SerializeToString(), streamed)
        self._sequence = command.sequence
        return self._sequence

    # -- events ------------------------------------------------------------------------------------

    def events(self, timeout: float = 0.0) -> Iterator[cloud_pb2.EdgeEvent]:
        """Events in order, until none comes within `timeout` seconds.

        With the default it yields what is there and ends. UDP has no lane for events: there it yields nothing.
        """
        if not self._link.carries_events:
            return
        while (event := self.system.next(timeout)) is not None:
            yield event

    @property
    def has_events(self) -> bool:
        """Whether the lane carries events at all."""
        return self._link.carries_events

    # -- life --------------------------------------------------------------------------------------

    def close(self) -> None:
        """Leave; idempotent. A velocity in force becomes zero and the robot stays in MOVE; a trajectory times out."""
        with self._sending:
            if self._closed:
                return
            self._closed = True
            if self._hold.active:
                with suppress(ConnectionError):  # the lane is gone: the robot has its own time-outs
                    self._send_velocity(0.0, 0.0, 0.0)
            self._hold.close()
            self.commands.close()
        self._link.close()

    def __enter__(self) -> Session:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    # -- LinkReceiver ------------------------------------------------------------------------------

    def on_state(self, packet: bytes, edge_timestamp_us: int = 0) -> None:
        """To the state channel, if it is a sample and newer than the last one."""
        if self._reader is None:
            self._reader = ReportReader(self._link.dialect)
        sample, arrival = self._reader.read(packet, edge_timestamp_us)
        self.state.arrivals[arrival] += 1
        if sample is not None:
            self._hold.watch(sample, arrival)
            self.state.put(sample)

    def on_event(self, packet: bytes) -> None:
        """To the system channel."""
        self.system.put(packet)

    def on_lost(self, reason: str) -> None:
        """Verbs and waits raise ConnectionError from now on."""
        self.commands.close(reason)
        self.state.lose(reason)


def connect(
    target: SimulatedRobot | str,
    name: str | None = None,
    source: Source | None = None,
    *,
    dialect: Dialect | None = None,
    token: str | None = None,
    robot_identity: str | None = None,
    state_port: int | None = None,
    facts_port: int | None = None,
    timeout: float = 5.0,
) -> Session:
    """Connect to a robot; use as a context manager or `close` it.

    Args:
        target: a `SimulatedRobot` in this process, running (`WallClock`) or advanced by the caller (`StepClock`);
            `udp://HOST` or `udp://HOST:CONTROL_PORT` (8850); or the `ws://` or `wss://` address of a LiveKit server.
        name: in process only: of the client, in events and recordings; a number is made up when None.
        source: in process only: rank in the order of control, by default `Source.IN_PROCESS`.
        dialect: in process, by default `cloud`; in a room, by default what the robot publishes. UDP is always `io`.
        token: in a room only, and needed there: what admits to it.
        robot_identity: in a room only: the robot's, where others share the room; by default whoever publishes a robot's
            reports is taken for one.
        state_port: UDP only: where the robot sends its state on this machine; 8851 when None.
        facts_port: UDP only: TCP port of the robot's facts; 3000 when None.
        timeout: s; for each of reaching the robot and its first state.

    Raises:
        ConnectionError: the robot was not reached, is not a supported one, or gives no state; the message says which.
        ValueError: a target of no known form, or an argument that does not belong to it.
        ImportError: a room without the package for it.
    """
    if isinstance(target, SimulatedRobot):
        _refuse("a robot in this process", token=token, robot_identity=robot_identity)
        _refuse("a robot in this process", state_port=state_port, facts_port=facts_port)
        client = Client(
            source if source is not None else Source.IN_PROCESS,
            name or f"session-{next(_numbers)}",
            (dialect or Dialect.CLOUD,),
        )
        return Session(InProcessLink(target, client), timeout, target.clock.realtime_us)
    try:
        parts = urlsplit(target)
        port = parts.port
    except ValueError as problem:
        raise ValueError(f"target {target!r}: {problem}") from None
    if parts.scheme == "udp":
        _refuse("udp://", name=name, source=source, token=token, robot_identity=robot_identity)
        if dialect is Dialect.CLOUD:
            raise ValueError("dialect must be io on udp://, the only one that the lane carries; got cloud")
        if not parts.hostname or parts.path or parts.query:
            raise ValueError(f"target must be udp://HOST or udp://HOST:CONTROL_PORT, got {target!r}")
        link = UdpLink(
            parts.hostname,
            CONTROL_PORT if port is None else port,
            STATE_PORT if state_port is None else state_port,
            FACTS_PORT if facts_port is None else facts_port,
            timeout=timeout,
        )
        return Session(link, timeout)
    if parts.scheme in ("ws", "wss"):
        _refuse("a room", name=name, source=source, state_port=state_port, facts_port=facts_port)
        if not token:
            raise ValueError("token is needed to join a room: connect(url, token=...)")
        from asimov_gym.edge.clients.livekit import LiveKitLink  # needs an optional package

        return Session(LiveKitLink(target, token, dialect, robot_identity, timeout), timeout)
    raise ValueError(
        f"target must be a SimulatedRobot, udp://HOST[:CONTROL_PORT] or ws[s]://HOST[:PORT], got {target!r}"
    )


def _refuse(lane: str, **arguments: object) -> None:
    for name, value in arguments.items():
        if value is not None:
            raise ValueError(f"{name} does not belong to {lane}")


def wait_until(
    session: Session, mode: cloud_pb2.FirmwareMode.ValueType, timeout: float = 5.0
) -> cloud_pb2.EdgeTelemetry:
    """Wait, in real time, until telemetry reports a mode; returns that sample.

    Raises:
        TimeoutError: it did not within `timeout` seconds.
    """
    end = time.monotonic() + timeout
    sample = session.state.get()
    while sample.fw_mode != mode:
        left = end - time.monotonic()
        if left <= 0.0:
            wanted, present = cloud_pb2.FirmwareMode.Name(mode), cloud_pb2.FirmwareMode.Name(sample.fw_mode)
            raise TimeoutError(f"the robot is still in {present} after {timeout} s, not in {wanted}")
        sample = session.state.wait(left)
    return sample


def _checked(name: str, values: Sequence[float] | np.ndarray) -> np.ndarray:
    array = np.asarray(values, dtype=np.float64)
    if array.shape != (len(JOINT_NAMES),):
        raise ValueError(f"{name} must hold {len(JOINT_NAMES)} values in firmware order, got shape {array.shape}")
    if not np.isfinite(array).all():
        place = int(np.flatnonzero(~np.isfinite(array))[0])
        raise ValueError(f"{name}[{place}] must be a finite number, got {array[place]}")
    return array
