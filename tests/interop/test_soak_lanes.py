"""Minutes of real time over UDP and a room at once, with clients that come and go and a room that restarts.

The robot and the clients find back into the room, the UDP lane notices nothing, the recording has everything, and
nothing has grown. `ASIMOV_GYM_SOAK_S` sets the length in seconds; by default it is five minutes.
"""

from __future__ import annotations

import asyncio
import logging
import os
import random
import socket
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from asimov_gym.edge import Client, Dialect, EdgeListener, Session, SimulatedRobot, Source, Verdict, connect
from asimov_gym.edge.transports.facts_server import FactsServer
from asimov_gym.edge.transports.livekit import LiveKitLane
from asimov_gym.edge.transports.udp import MAX_SENDERS, UdpLane
from asimov_gym.edge.wire import io_pb2
from asimov_gym.firmware import FirmwareConfig, WallClock
from asimov_gym.firmware.policy_control import InferenceConfig
from asimov_gym.recording import Recorder
from tests.edge.conftest import StandInPolicy
from tests.edge.witness import Witness, check_recording
from tests.footprint import Footprint, eventually, held_bytes
from tests.network_namespace import in_namespace

if TYPE_CHECKING:
    from asimov_gym.room import RoomThread

SOAK_S = float(os.environ.get("ASIMOV_GYM_SOAK_S", "300"))
RESTARTS = 2
AWAY_S = (2.0, 20.0)
"""How long the room is away at each restart: the client library mends the first, of the second everybody joins anew."""
VISIT_S = (4.0, 12.0)
"""How long a client of the room stays."""
BACK_S = 45.0
"""Patience for robot and clients to be back in the room."""
FOREIGN = io_pb2.RobotCommand(protocol_version=9, mode=io_pb2.CONTROL_MODE_STAND).SerializeToString()


class Ledger(EdgeListener):
    """What came in, by lane and verdict."""

    def __init__(self) -> None:
        self.verdicts: Counter[tuple[Source, str]] = Counter()

    def on_command(self, received_us: int, client: Client, packet: bytes, verdict: Verdict) -> None:
        self.verdicts[client.source, str(verdict)] += 1

    def accepted(self, source: Source) -> int:
        return self.verdicts[source, "accepted"]


class Visitor:
    """A client that connects, talks and listens, leaves, and comes again, in a thread of its own.

    Args:
        name: of the thread.
        enter: connects.
        talk: sends one command.
        seed: of what is left to chance.
    """

    def __init__(
        self, name: str, enter: Callable[[], Session], talk: Callable[[Session, random.Random], object], seed: int
    ) -> None:
        self.visits = self.refusals = self.reports = self.events = 0
        self.failure: BaseException | None = None
        self._enter, self._talk, self._dice = enter, talk, random.Random(seed)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name)

    def __enter__(self) -> Visitor:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        if self.failure is not None:
            raise self.failure

    def _run(self) -> None:
        try:
            while not self._stop.is_set():
                try:
                    self._visit()
                except ConnectionError:  # there is no room just now
                    self.refusals += 1
                    self._stop.wait(0.5)
        except BaseException as failure:
            self.failure = failure

    def _visit(self) -> None:
        with self._enter() as session:
            self.visits += 1
            end = time.monotonic() + self._dice.uniform(*VISIT_S)
            while time.monotonic() < end and not self._stop.is_set():
                self._talk(session, self._dice)
                with suppress(TimeoutError):
                    session.state.wait(0.2)
                    self.reports += 1
                self.events += sum(1 for _ in session.events())
                self._stop.wait(0.05)


def talk(session: Session, dice: random.Random) -> None:
    """One verb; no DAMP, which would act for everybody."""
    match dice.randrange(4):
        case 0:
            session.stand()
        case 1:
            session.velocity(dice.uniform(0.0, 0.2))
        case _:
            session.trajectory(list(session.state.get().joint_pos))


class UdpDriver:
    """The one UDP client: talks for eight seconds, is silent for six, so that the room's clients get their turn, and
    looks at every report's age."""

    def __init__(self, session: Session) -> None:
        self.oldest_s = 0.0
        """Age of the oldest report that was ever the latest."""
        self._session, self._dice = session, random.Random(6)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="udp driver")

    def __enter__(self) -> UdpDriver:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()

    def _run(self) -> None:
        began = time.monotonic()
        while not self._stop.wait(0.05):
            self.oldest_s = max(self.oldest_s, self._session.state.age)
            turn = (time.monotonic() - began) % 14.0
            if turn < 7.5:
                talk(self._session, self._dice)
            elif turn < 8.0:
                self._session.stand()  # a velocity in force would be said again for ever
            else:
                self._session.commands.send(b"\xff")


@contextmanager
def recorded(path: Path, robot: SimulatedRobot) -> Iterator[tuple[Recorder, Witness]]:
    """Record a robot, and have a witness hear the same."""
    witness, log = Witness(), logging.getLogger("asimov_gym")
    with robot.edge.lock:
        recorder = Recorder(path, robot.edge, robot_state=True)
        robot.edge.attach(witness)
        log.addHandler(witness)
    with recorder:
        yield recorder, witness
    robot.edge.detach(witness)
    log.removeHandler(witness)


def free_udp_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def passers_by(control_port: int, count: int) -> None:
    """UDP clients that say one thing each, which the robot does not understand, and are gone."""
    for _ in range(count):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
            one.sendto(FOREIGN, ("127.0.0.1", control_port))


def tasks(room: RoomThread) -> int:
    """Tasks of the room server's loop."""
    assert room._loop is not None
    return len(asyncio.all_tasks(room._loop))


@pytest.mark.slow
@in_namespace(timeout=SOAK_S + 240.0)
def test_minutes_over_udp_and_a_room_that_restarts(tmp_path: Path) -> None:
    from asimov_gym.room import RoomThread

    # The time limits that watch over the machine are lenient: what is tested is the lanes, on whatever machine.
    lenient = FirmwareConfig(watchdog_s=20.0, inference=InferenceConfig(timeout_s=20.0, failure_s=20.0))
    robot = SimulatedRobot(StandInPolicy(), WallClock(), "hold", config=lenient)
    warm_up(robot)
    before = Footprint.now()
    report: dict[str, Any] = {}
    with recorded(tmp_path / "soak.mcap", robot) as (recorder, witness):
        with RoomThread() as room, robot:
            soak(robot, room, recorder, report)
        assert recorder.failure == ""
    after = Footprint.now()
    print(before, after, dict(witness.heard.count))
    check_recording(tmp_path / "soak.mcap", witness.heard)
    assert after.threads == before.threads
    assert after.files <= before.files + 2


def warm_up(robot: SimulatedRobot) -> None:
    """Have the client library start what it keeps for as long as the process lives."""
    from asimov_gym.room import RoomThread

    with RoomThread() as room, robot, LiveKitLane(robot.edge, room.url, robot_token(room), tuple(Dialect)):
        for dialect in Dialect:
            connect(room.url, token=room.token(None, "first"), dialect=dialect).close()


def robot_token(room: RoomThread) -> str:
    return room.token(None, "robot", can_update_own_metadata=True)


def soak(robot: SimulatedRobot, room: RoomThread, recorder: Recorder, report: dict[str, Any]) -> None:
    """Everything at once, for `SOAK_S` seconds."""
    state_port, ledger = free_udp_port(), Ledger()
    robot.edge.attach(ledger)
    serial = iter(range(10**9))

    def enter(dialect: Dialect) -> Session:
        token = room.token(None, f"visitor {next(serial) % 30}")
        return connect(room.url, token=token, dialect=dialect)

    with (
        UdpLane(robot.edge, 0, state_port=state_port) as udp,
        FactsServer(0) as facts,
        LiveKitLane(robot.edge, room.url, robot_token(room), tuple(Dialect)) as lane,
        connect(f"udp://127.0.0.1:{udp.control_port}", state_port=state_port, facts_port=facts.port) as session,
        UdpDriver(session) as driver,
        Visitor("visitor cloud", lambda: enter(Dialect.CLOUD), talk, 1) as cloud,
        Visitor("visitor io", lambda: enter(Dialect.IO), talk, 2) as io,
    ):
        stretch_s = max(15.0, SOAK_S / (RESTARTS + 1))
        ages, held, memory = [], [], []
        for number in range(RESTARTS + 1):
            end = time.monotonic() + stretch_s
            accepted = {source: ledger.accepted(source) for source in (Source.UDP, Source.LIVEKIT)}
            while time.monotonic() < end:
                passers_by(udp.control_port, 20)
                time.sleep(1.0)
            for source, count in accepted.items():
                assert ledger.accepted(source) > count + 10, f"no commands of {source.name} in stretch {number}"
            assert robot.running and robot.edge.lanes.cloud_connected
            with robot.edge.lock:
                # Meant to grow are the lateness of five minutes of steps and the index of the recording.
                held.append(held_bytes(robot, without=(robot.lateness_us, recorder)))
            memory.append(Footprint.now().memory_mib)
            if number < RESTARTS:
                ages.append(restart(robot, room, lane, (cloud, io), AWAY_S[number % len(AWAY_S)]))
        report |= {
            "back_s": ages,
            "held": held,
            "memory_mib": memory,
            "udp": (driver.oldest_s, session.state.arrivals, udp.states),
            "visitors": [(one.visits, one.refusals, one.reports, one.events) for one in (cloud, io)],
            "verdicts": {f"{source.name} {verdict}": count for (source, verdict), count in ledger.verdicts.items()},
            "joined": lane.joined,
            "room tasks": tasks(room),
        }
        print(report)
        assert len(robot.edge._order._clients) <= MAX_SENDERS + len(Dialect) + 1
    robot.edge.detach(ledger)
    eventually(lambda: room.server.participants == 0, "everybody has left the room")
    eventually(lambda: tasks(room) <= 3, "the room's tasks have ended")
    assert driver.oldest_s < 2.0
    assert session.state.arrivals.total() > 0.98 * udp.states.sent
    assert held[-1] < held[0] + 50_000
    assert memory[-1] < memory[0] + 30.0


def restart(
    robot: SimulatedRobot, room: RoomThread, lane: LiveKitLane, visitors: tuple[Visitor, ...], away_s: float
) -> float:
    """Close the room for a while. Gives the time until the robot and fresh visitors are back after it opened again."""
    room.stop()
    eventually(lambda: not robot.edge.lanes.cloud_connected, "the robot notices that the room is gone")
    time.sleep(away_s)
    reports = [one.reports for one in visitors]
    room.start()
    began = time.monotonic()
    eventually(lambda: lane.connected, "the robot is back in the room", BACK_S)
    eventually(
        lambda: all(one.reports > before + 5 for one, before in zip(visitors, reports, strict=True)),
        "the clients hear the robot again",
        BACK_S,
    )
    return time.monotonic() - began
