"""Sessions over UDP against a simulated robot, in lockstep."""

from __future__ import annotations

import asyncio
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager

import numpy as np
import pytest

from asimov_gym.edge import Session, SimulatedRobot, aconnect, connect
from asimov_gym.edge.clients.udp import UdpLink
from asimov_gym.edge.facts import is_simulated
from asimov_gym.edge.transports.facts_server import FactsServer
from asimov_gym.edge.transports.udp import UdpLane
from asimov_gym.edge.wire import cloud_pb2
from asimov_gym.firmware import State
from asimov_gym.robot import ankle
from asimov_gym.robot.joints import STAND_POSITION


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as reserved:
        reserved.bind(("127.0.0.1", 0))
        return reserved.getsockname()[1]


class Bench:
    """A robot with its UDP lane and facts, advanced by the test whenever it waits for something."""

    def __init__(self, robot: SimulatedRobot, stack: ExitStack) -> None:
        self.robot = robot
        self.state_port = free_port()
        self.lane = stack.enter_context(UdpLane(robot.edge, 0, state_port=self.state_port))
        self.facts = stack.enter_context(FactsServer(0))

    @property
    def target(self) -> str:
        return f"udp://127.0.0.1:{self.lane.control_port}"

    @property
    def options(self) -> dict[str, int]:
        return {"state_port": self.state_port, "facts_port": self.facts.port}

    def connect(self) -> Session:
        """Connect while the robot sends."""
        with self.sending():
            return connect(self.target, **self.options)

    @contextmanager
    def sending(self) -> Iterator[None]:
        """Another thread advances the robot meanwhile."""
        stop = threading.Event()

        def run() -> None:
            while not stop.wait(0.005):
                self.robot.advance(0.005)

        thread = threading.Thread(target=run)
        thread.start()
        try:
            yield
        finally:
            stop.set()
            thread.join()

    def until(self, condition: Callable[[], object]) -> None:
        """Advance until something holds; 10 s of the robot's time at most."""
        for _ in range(1000):
            if condition():
                return
            self.robot.advance(0.01)
            time.sleep(0.001)
        pytest.fail("it did not come about")


@pytest.fixture
def bench(robot: SimulatedRobot) -> Iterator[Bench]:
    with ExitStack() as stack:
        yield Bench(robot, stack)


def test_verbs_and_state_over_udp(bench) -> None:
    with bench.connect() as session:
        assert is_simulated(dict(session.facts))
        firmware = bench.robot.firmware
        session.stand()
        bench.until(lambda: session.state.get().fw_mode == cloud_pb2.FW_MODE_STAND)
        # Too early: the robot takes velocities once it was upright for half a second. The session says it again.
        session.velocity(0.3)
        bench.until(lambda: firmware.snapshot.velocity.any())
        assert firmware.snapshot.velocity[0] == pytest.approx(0.3)
        bench.until(lambda: session.state.get().fw_mode == cloud_pb2.FW_MODE_MOVE)
        target = np.asarray(session.state.get().joint_pos)
        session.trajectory(target)
        bench.until(lambda: firmware.state is State.TRAJECTORY)
        session.damp()
        bench.until(lambda: session.state.get().fw_mode == cloud_pb2.FW_MODE_DAMP)
        assert list(session.events(timeout=0.01)) == []
        assert session.state.get().timestamp_us == 0


def test_a_velocity_outlives_the_robots_timeout_and_ends_with_the_session(bench) -> None:
    firmware = bench.robot.firmware
    with bench.connect() as session:
        session.stand()
        bench.until(lambda: firmware.state is State.STAND)
        session.velocity(0.2)
        bench.until(lambda: firmware.snapshot.velocity.any())
        until = time.monotonic() + 0.5
        while time.monotonic() < until:  # 0.5 s for the sender, 5 s for the robot: it would have stopped after 2 s
            bench.robot.advance(0.05)
            assert firmware.snapshot.velocity[0] == pytest.approx(0.2)
            time.sleep(0.005)
    bench.until(lambda: not firmware.snapshot.velocity.any())
    assert firmware.state is State.POLICY


def test_the_robot_forgets_the_velocity_of_a_client_that_dies(bench) -> None:
    firmware = bench.robot.firmware
    session = bench.connect()
    session.stand()
    bench.until(lambda: firmware.state is State.STAND)
    session.velocity(0.2)
    bench.until(lambda: firmware.snapshot.velocity.any())
    session._link.close()  # as a killed process would: no zero, no farewell
    began = firmware.now_us
    bench.until(lambda: not firmware.snapshot.velocity.any())
    assert 1.5e6 <= firmware.now_us - began <= 2.2e6
    assert firmware.state is State.POLICY
    session.close()


def test_async_session_over_udp(bench) -> None:
    async def drive() -> int:
        async with aconnect(bench.target, **bench.options) as session:
            await session.stand()
            sample = await session.state.wait(2.0)
            while sample.fw_mode != cloud_pb2.FW_MODE_STAND:
                sample = await session.state.wait(2.0)
            assert [event async for event in session.events()] == []
            return sample.applied_cmd.seq

    with bench.sending():
        assert asyncio.run(drive()) == 1


def test_cancelled_connecting_leaves_nothing_open(bench) -> None:
    async def hurry() -> None:
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.1), aconnect(bench.target, **bench.options, timeout=0.4):
                pytest.fail("nothing sends, so nothing can connect")

    asyncio.run(hurry())
    with bench.connect() as session:  # the state port is free again
        assert session.state.get().sequence > 0


def test_without_facts_nothing_is_opened(bench) -> None:
    bench.facts.stop()
    with pytest.raises(ConnectionError, match="no robot answers at http://127"):
        connect(bench.target, **bench.options)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as states:
        states.bind(("127.0.0.1", bench.state_port))


def test_a_robot_that_sends_elsewhere_is_reported(bench) -> None:
    other = free_port()
    with pytest.raises(ConnectionError, match=rf"no state from udp://.* within 0.2 s.*port {other} .*--udp-state-host"):
        connect(bench.target, state_port=other, facts_port=bench.facts.port, timeout=0.2)


def test_a_second_client_finds_the_state_port_taken(bench) -> None:
    with bench.connect(), pytest.raises(ConnectionError, match=f"UDP port {bench.state_port}.*Another client"):
        connect(bench.target, **bench.options)


def test_state_from_strangers_is_ignored(bench) -> None:
    with bench.connect() as session:
        before = session.state.get().sequence
        link = session._link
        assert isinstance(link, UdpLink)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            try:
                stranger.bind(("127.0.0.2", 0))
            except OSError:
                pytest.skip("this machine has one loopback address only")
            stranger.sendto(bench.robot.edge.latest_robot_state, ("127.0.0.1", bench.state_port))
        end = time.monotonic() + 2.0
        while link.strangers == 0 and time.monotonic() < end:
            time.sleep(0.005)
        assert link.strangers == 1
        assert session.state.get().sequence == before


def test_ports_are_checked() -> None:
    with pytest.raises(ValueError, match="state_port must be from 1 to 65535, got 0"):
        UdpLink("127.0.0.1", state_port=0)


def test_standing_pose_held_over_udp_stays_where_it_is(bench) -> None:
    """Joint targets straight from the contract's pose: the ankles' motors arrive where they were sent."""
    firmware = bench.robot.firmware
    motors = ankle.to_motor_position(np.asarray(STAND_POSITION))
    with bench.connect() as session:
        session.stand()
        bench.until(lambda: firmware.state is State.STAND)
        for _ in range(120):
            bench.robot.advance(0.02)
        for _ in range(50):
            session.trajectory(motors)
            bench.robot.advance(0.02)
            time.sleep(0.001)
        bench.until(lambda: session.state.get().fw_mode == cloud_pb2.FW_MODE_MOVE)
        assert np.abs(np.asarray(session.state.get().joint_pos) - motors).max() < 0.15
