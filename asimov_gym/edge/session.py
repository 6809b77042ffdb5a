"""The in-process session: a client's three channels to a simulated robot, with the robot's verbs on top.

Packets cross the session as bytes, so that a program talks to the robot exactly as over a network: commands are never
answered, state is the latest sample, events queue in order.
"""

from __future__ import annotations

import itertools
import threading
import time
from collections import deque
from collections.abc import Iterator, Sequence
from types import TracebackType

import numpy as np

from asimov_gym.edge.control import Client, Source
from asimov_gym.edge.robot import SimulatedRobot
from asimov_gym.edge.telemetry import UINT32
from asimov_gym.edge.verdict import Verdict
from asimov_gym.edge.wire import cloud_pb2
from asimov_gym.robot.joints import JOINT_NAMES

_numbers = itertools.count(1)


class CommandChannel:
    """Channel `commands`: reliable, in order, to the robot."""

    def __init__(self, robot: SimulatedRobot, client: Client) -> None:
        self._robot = robot
        self._client = client
        self._closed = False

    def send(self, packet: bytes) -> None:
        """Send a packet as it is. What the robot makes of it shows in telemetry and events only.

        Raises:
            ConnectionError: the session is closed.
        """
        if self._closed:
            raise ConnectionError("the session is closed")
        self._robot.edge.receive(packet, self._client)

    def close(self) -> None:
        """Refuse further packets."""
        self._closed = True


class StateChannel:
    """Channel `state`: the robot's latest telemetry, 10 times a second; older samples are lost."""

    def __init__(self, first: bytes) -> None:
        self._packet = first
        self._received = 0
        self._condition = threading.Condition()

    def get(self) -> cloud_pb2.EdgeTelemetry:
        """The latest sample; there is one from the moment of connecting."""
        return cloud_pb2.EdgeTelemetry.FromString(self._packet)

    def wait(self, timeout: float = 1.0) -> cloud_pb2.EdgeTelemetry:
        """The next sample to come.

        Args:
            timeout: s.

        Raises:
            TimeoutError: none came. In lockstep none comes unless another thread advances the robot.
        """
        with self._condition:
            seen = self._received
            if not self._condition.wait_for(lambda: self._received != seen, timeout):
                raise TimeoutError(f"no telemetry within {timeout} s: is the robot started, or advanced?")
            return self.get()

    def put(self, packet: bytes) -> None:
        """Called by the session for each sample."""
        with self._condition:
            self._packet = packet
            self._received += 1
            self._condition.notify_all()


class SystemChannel:
    """Channel `system`: events, reliable and in order, from the moment of connecting."""

    def __init__(self) -> None:
        self._packets: deque[bytes] = deque()
        self._condition = threading.Condition()

    def next(self, timeout: float = 0.0) -> cloud_pb2.EdgeEvent | None:
        """The oldest event not yet taken; None if there is none within `timeout` seconds."""
        with self._condition:
            if not self._condition.wait_for(lambda: bool(self._packets), timeout):
                return None
            return cloud_pb2.EdgeEvent.FromString(self._packets.popleft())

    def put(self, packet: bytes) -> None:
        """Called by the session for each event."""
        with self._condition:
            self._packets.append(packet)
            self._condition.notify_all()


class Session:
    """A connected client. Made by `connect`.

    The verbs check their arguments and raise; `commands.send` sends anything. Each verb returns the command's sequence
    number, which telemetry echoes in `applied_cmd.seq` once the robot has taken it.
    """

    def __init__(self, robot: SimulatedRobot, client: Client) -> None:
        self.client = client
        self.commands = CommandChannel(robot, client)
        self.state = StateChannel(robot.edge.latest)
        self.system = SystemChannel()
        self._robot = robot
        self._sequence = 0
        robot.edge.attach(self)

    # -- verbs -------------------------------------------------------------------------------------

    def stand(self) -> int:
        """Take the standing pose, over about 2 s."""
        return self._send(cloud_pb2.CloudCommand(mode=cloud_pb2.ModeCommand(mode=cloud_pb2.MODE_STAND)))

    def damp(self) -> int:
        """Go limp: the software stop. Works for every client at any time."""
        return self._send(cloud_pb2.CloudCommand(mode=cloud_pb2.ModeCommand(mode=cloud_pb2.MODE_DAMP)))

    def velocity(self, vx: float = 0.0, vy: float = 0.0, vyaw: float = 0.0) -> int:
        """Walk until told otherwise. Has no effect in DAMP.

        Args:
            vx: m/s, forward; clamped by the robot to ±2.
            vy: m/s, to the left; clamped to ±1.
            vyaw: rad/s, counter-clockwise; clamped to ±2.

        Raises:
            ValueError: a value is not finite.
        """
        for name, value in (("vx", vx), ("vy", vy), ("vyaw", vyaw)):
            if not np.isfinite(value):
                raise ValueError(f"{name} must be a finite number, got {value!r}")
        return self._send(cloud_pb2.CloudCommand(velocity=cloud_pb2.VelocityCommand(vx=vx, vy=vy, vyaw=vyaw)))

    def trajectory(
        self,
        positions: Sequence[float] | np.ndarray,
        kp: Sequence[float] | np.ndarray | None = None,
        kd: Sequence[float] | np.ndarray | None = None,
    ) -> int:
        """Drive every motor to a position at once. Send again within 200 ms, or the robot goes to DAMP.

        Args:
            positions: rad, 25, firmware order; the ankle entries are the motors A and B, as telemetry reports them.
            kp: position gains at the motors, 25 from 0 to 500; None for the defaults.
            kd: damping gains at the motors, 25 from 0 to 5; None for the defaults.

        Raises:
            ValueError: a wrong length, or a value that is not finite.
        """
        segment = cloud_pb2.JointSegment(
            positions=_checked("positions", positions),
            kp=[] if kp is None else _checked("kp", kp),
            kd=[] if kd is None else _checked("kd", kd),
        )
        request = cloud_pb2.TrajectoryRequest(full=cloud_pb2.FullTrajectory(segments=[segment]))
        return self._send(cloud_pb2.CloudCommand(trajectory=request))

    def _send(self, command: cloud_pb2.CloudCommand) -> int:
        self._sequence = (self._sequence + 1) % UINT32
        command.sequence = self._sequence
        command.timestamp_us = self._robot.clock.realtime_us()
        self.commands.send(command.SerializeToString())
        return self._sequence

    # -- events ------------------------------------------------------------------------------------

    def events(self, timeout: float = 0.0) -> Iterator[cloud_pb2.EdgeEvent]:
        """Events in order, until none comes within `timeout` seconds.

        With the default it yields what is there and ends.
        """
        while (event := self.system.next(timeout)) is not None:
            yield event

    # -- life --------------------------------------------------------------------------------------

    def close(self) -> None:
        """Leave. A walking robot walks on at its last velocity; a trajectory times out."""
        self.commands.close()
        self._robot.edge.detach(self)
        self._robot.edge.leave(self.client)

    def __enter__(self) -> Session:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    # -- EdgeListener ------------------------------------------------------------------------------

    def on_command(self, received_us: int, client: Client, packet: bytes, verdict: Verdict) -> None:
        """Nothing: the robot answers no command."""

    def on_telemetry(self, timestamp_us: int, packet: bytes) -> None:
        """To the state channel."""
        self.state.put(packet)

    def on_event(self, timestamp_us: int, packet: bytes) -> None:
        """To the system channel."""
        self.system.put(packet)


def connect(robot: SimulatedRobot, name: str | None = None, source: Source = Source.IN_PROCESS) -> Session:
    """Connect to a robot in this process; use as a context manager or `close` it.

    Args:
        robot: running (`WallClock`) or advanced by the caller (`StepClock`).
        name: of the client, in events and recordings; a number is made up when None.
        source: rank in the order of control.
    """
    return Session(robot, Client(source, name or f"session-{next(_numbers)}"))


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


def _checked(name: str, values: Sequence[float] | np.ndarray) -> list[float]:
    array = np.asarray(values, dtype=np.float64)
    if array.shape != (len(JOINT_NAMES),):
        raise ValueError(f"{name} must hold {len(JOINT_NAMES)} values in firmware order, got shape {array.shape}")
    if not np.isfinite(array).all():
        place = int(np.flatnonzero(~np.isfinite(array))[0])
        raise ValueError(f"{name}[{place}] must be a finite number, got {array[place]}")
    return array.tolist()
