"""Mutated datagrams on the UDP lane's socket: none is lost from the counters, the state goes on, memory stays flat."""

from __future__ import annotations

import socket
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack

import pytest

from asimov_gym.edge import Client, DropReason, EdgeListener, SimulatedRobot, Verdict
from asimov_gym.edge.transports.udp import MAX_SENDERS, UdpLane
from asimov_gym.edge.wire import io_pb2
from asimov_gym.firmware import State, WallClock
from tests.edge.conftest import StandInPolicy
from tests.edge.test_fuzz import mutations
from tests.footprint import Footprint, eventually

LARGEST_DATAGRAM = 65_507
"""Of UDP over IPv4, bytes of payload."""
IN_FLIGHT = 40
"""Datagrams that may wait in the lane's socket: few enough that the system drops none."""
SENDERS = 100
BURST = 10
"""Datagrams of one sender in a row."""
STEP_EVERY = 250
"""Datagrams between two control steps."""
CALM_EVERY = 2000
"""Datagrams between two calms, in which the robot gets to stand."""


def sound(mode: io_pb2.ControlMode.ValueType, **fields: object) -> bytes:
    """A packet with nothing wrong in it."""
    return io_pb2.RobotCommand(protocol_version=1, mode=mode, **fields).SerializeToString()  # type: ignore[arg-type]


STAND = sound(io_pb2.CONTROL_MODE_STAND)
WALK = sound(io_pb2.CONTROL_MODE_MOVE, policy=io_pb2.VelocityCommand(vx=0.1))
POSE = sound(io_pb2.CONTROL_MODE_MOVE, all_trajectory=io_pb2.AllTrajectory(positions=[0.0] * 25))

FLOOD = """
import socket, sys, time
from tests.edge.test_fuzz import mutations
packets = list(mutations(2000, seed=5))
end, sent = time.monotonic() + float(sys.argv[2]), 0
with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
    while time.monotonic() < end:
        for packet in packets:
            sender.sendto(packet, ("127.0.0.1", int(sys.argv[1])))
        sent += len(packets)
print(sent)
"""


class Ledger(EdgeListener):
    """Verdicts by sender, and the same counted by reason."""

    def __init__(self) -> None:
        self.senders: Counter[str] = Counter()
        self.verdicts: Counter[str] = Counter()

    def on_command(self, received_us: int, client: Client, packet: bytes, verdict: Verdict) -> None:
        self.senders[client.name] += 1
        self.verdicts[str(verdict)] += 1


@pytest.fixture
def states() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", 0))
        listener.setblocking(False)
        yield listener


def frames(states: socket.socket) -> list[io_pb2.RobotState]:
    """What has come since the last call."""
    found = []
    try:
        while True:
            found.append(io_pb2.RobotState.FromString(states.recv(65_535)))
    except BlockingIOError:
        return found


def datagrams(count: int, seed: int) -> Iterator[bytes]:
    """Mutated packets of both dialects; one in 200 is empty, one in 1,000 as large as a datagram can be."""
    for number, packet in enumerate(mutations(count, seed)):
        if number % 1000 == 500:
            yield (packet + bytes(LARGEST_DATAGRAM))[:LARGEST_DATAGRAM]
        else:
            yield b"" if number % 200 == 100 else packet


class Barrage:
    """A robot in lockstep with a lane, and many sockets that send to it.

    Args:
        stack: closes what is opened.
        states: socket that the state goes to.
    """

    def __init__(self, stack: ExitStack, states: socket.socket) -> None:
        self.robot, self.ledger = SimulatedRobot(StandInPolicy()), Ledger()
        self.lane = stack.enter_context(UdpLane(self.robot.edge, control_port=0, state_port=states.getsockname()[1]))
        self.robot.edge.attach(self.ledger)
        self._senders = [stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(SENDERS)]
        self._states = states
        self.sent = self.steps = 0

    def calm(self) -> None:
        """Fall silent until control is free, then have the robot stand, walk and take a pose, as among so many
        mutations it never would."""
        self.await_judged()
        self.advance(401)
        self.send(STAND)
        self.await_judged()
        self.advance(110)
        self.send(WALK)
        self.send(POSE)

    def send(self, packet: bytes) -> None:
        """One datagram, once there is room for it."""
        self.await_judged(IN_FLIGHT if len(packet) < 4096 else 0)
        # Bursts of one sender, so that each may get control; it is evicted again when its turn is long past.
        sender = self._senders[self.sent // BURST % SENDERS]
        sender.sendto(packet, ("127.0.0.1", self.lane.control_port))
        self.sent += 1

    def await_judged(self, in_flight: int = 0) -> None:
        """Wait until no more than so many datagrams are under way."""
        tally = self.robot.edge.tally
        if self.sent - tally.packets > in_flight:
            eventually(lambda: tally.packets == self.sent, f"{self.sent} datagrams judged")

    def advance(self, steps: int) -> None:
        """Run the robot, whose state must come with every step."""
        for _ in range(steps):
            self.robot.advance(0.005)
            self.steps += 1
            (frame,) = frames(self._states)
            assert frame.sequence == self.steps and len(frame.joint_pos) == 25


def fuzz(count: int, seed: int, states: socket.socket) -> float:
    """Send `count` datagrams from many addresses, and look at everything. Gives the growth of the second half, MiB."""
    middle_mib = 0.0
    before = Footprint.now()
    with ExitStack() as stack:
        barrage = Barrage(stack, states)
        for number, packet in enumerate(datagrams(count, seed)):
            if barrage.sent % CALM_EVERY == 0:
                barrage.calm()
            barrage.send(packet)
            if number % STEP_EVERY == 0:
                barrage.advance(1)
            if number == count // 2:
                middle_mib = Footprint.now().memory_mib
        barrage.await_judged()
        assert len(barrage.lane._senders) == MAX_SENDERS
        assert len(barrage.robot.edge._order._clients) <= MAX_SENDERS
        assert barrage.lane.states.sent == barrage.steps
        growth_mib = Footprint.now().memory_mib - middle_mib
    check(barrage.robot, barrage.ledger, barrage.sent)
    after = Footprint.now()
    assert (after.threads, after.files) == (before.threads, before.files)
    assert barrage.robot.edge.control.holder is None and not barrage.robot.edge._order._clients
    return growth_mib


def check(robot: SimulatedRobot, ledger: Ledger, count: int) -> None:
    """Assert that every datagram is in one counter, and that they were of all kinds."""
    tally = robot.edge.tally
    assert tally.accepted.total() + tally.dropped.total() == ledger.senders.total() == count
    assert ledger.verdicts.pop("accepted") == tally.accepted.total()
    assert ledger.verdicts == {reason.name: number for reason, number in tally.dropped.items()}
    assert len(ledger.senders) == SENDERS
    assert all(tally.accepted[kind] > 0 for kind in ("velocity", "mode", "trajectory"))
    assert tally.dropped[DropReason.TOO_LARGE] >= count // 1000
    assert tally.dropped[DropReason.WRONG_VERSION] >= count // 200
    assert len(tally.dropped) >= 10


def test_thousands_of_mutated_datagrams(states: socket.socket) -> None:
    fuzz(8_000, seed=11, states=states)


@pytest.mark.slow
def test_hundreds_of_thousands_of_mutated_datagrams_in_flat_memory(states: socket.socket) -> None:
    assert fuzz(200_000, seed=12, states=states) < 8.0


@pytest.mark.slow
def test_a_flood_does_not_stop_a_robot_in_real_time(states: socket.socket) -> None:
    """Far more than the lane can take, from a process of its own. The system drops the rest; the robot goes on."""
    robot = SimulatedRobot(StandInPolicy(), clock=WallClock())
    with robot, UdpLane(robot.edge, control_port=0, state_port=states.getsockname()[1]) as lane:
        eventually(lambda: lane.states.sent > 10, "the robot runs")
        ticks = robot.firmware.ticks
        flood = [sys.executable, "-c", FLOOD, str(lane.control_port), "4"]
        done = subprocess.run(flood, capture_output=True, text=True, timeout=60.0)
        assert done.returncode == 0, done.stderr
        assert 10_000 < robot.edge.tally.packets <= int(done.stdout)
        assert robot.firmware.ticks - ticks > 400  # half of real time, on whatever else this machine is doing
        assert robot.running and robot.firmware.snapshot.error_flags == 0
        frames(states)
        eventually(lambda: len(frames(states)) > 0, "the state goes on")
        # Whoever was in control has fallen silent, so control is to be had.
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as late:

            def obeys() -> bool:
                late.sendto(STAND, ("127.0.0.1", lane.control_port))
                return robot.firmware.state is State.STAND

            eventually(obeys, "a client that comes after the flood is obeyed")
