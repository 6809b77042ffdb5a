"""Clients that come to a robot in lockstep, say something at every turn, and go."""

from __future__ import annotations

import itertools
import random
from collections.abc import Callable
from typing import Protocol

import numpy as np

from asimov_gym.edge import Client, Dialect, EdgeListener, Session, SimulatedRobot, Source, connect
from asimov_gym.edge.wire import cloud_pb2, io_pb2
from asimov_gym.robot.joints import STAND_POSITION
from tests.edge.test_fuzz import mutations

CROWD = 8
"""Clients that are there at a time, about."""
STAY_TURNS = 2000
"""Turns after which a client goes, at most."""
RANKS = (Source.IN_PROCESS, Source.UDP, Source.LIVEKIT, Source.JOINT_CONTROL, Source.MOTION_MODES)


class Guest(Protocol):
    """A client for a while. Each `speak` sends one packet."""

    def speak(self, may_damp: bool) -> None: ...

    def leave(self) -> None: ...


class Talker:
    """A session, as an application has one. Some of them read what the robot says."""

    def __init__(self, robot: SimulatedRobot, name: str, dice: random.Random) -> None:
        self._dice = dice
        self._reads = dice.random() < 0.5
        dialect = dice.choice((Dialect.CLOUD, Dialect.IO))
        self._session: Session = connect(robot, name, dice.choice(RANKS), dialect=dialect)

    def speak(self, may_damp: bool) -> None:
        session, dice = self._session, self._dice
        if self._reads and dice.random() < 0.02:
            assert len(session.state.get().joint_pos) == 25
            assert all(event.sequence > 0 for event in session.events())
        match dice.randrange(40):
            case 0 if may_damp:
                session.damp()
            case 1 | 2:
                session.stand()
            case number if number < 22:
                session.velocity(dice.uniform(-0.3, 0.5), dice.uniform(-0.2, 0.2), dice.uniform(-0.4, 0.4))
            case _:
                gains = {} if dice.random() < 0.5 else {"kp": np.full(25, 60.0), "kd": np.full(25, 2.0)}
                away = np.array([dice.uniform(-0.15, 0.15) for _ in range(25)])
                session.trajectory(STAND_POSITION + away, **gains)

    def leave(self) -> None:
        self._session.close()


class Babbler:
    """A client below any session, with packets of either dialect of which most are broken."""

    def __init__(self, robot: SimulatedRobot, name: str, dice: random.Random) -> None:
        dialects = dice.choice(((Dialect.CLOUD,), (Dialect.IO,), (Dialect.CLOUD, Dialect.IO)))
        self._client = Client(dice.choice(RANKS), name, dialects)
        self._edge, self._dice = robot.edge, dice
        self._packets = mutations(STAY_TURNS * 200, dice.randrange(2**32))
        self._harmless = itertools.cycle(
            message.SerializeToString()
            for message in (
                cloud_pb2.CloudCommand(sequence=7, velocity=cloud_pb2.VelocityCommand(vx=9.0)),
                io_pb2.RobotCommand(protocol_version=1, sequence=8, mode=2, policy=io_pb2.VelocityCommand(vx=0.1)),
                io_pb2.RobotCommand(protocol_version=3),
            )
        )

    def speak(self, may_damp: bool) -> None:
        packet = next(self._packets if may_damp else self._harmless)
        self._edge.receive(packet, self._client, streamed=self._dice.random() < 0.3)

    def leave(self) -> None:
        self._edge.leave(self._client)


class Onlooker(EdgeListener):
    """Listens beside the clients, as a transport does."""

    def __init__(self, robot: SimulatedRobot, dice: random.Random) -> None:
        self.wants_robot_state = dice.random() < 0.5
        self._edge = robot.edge
        self._edge.attach(self)
        self.latest = b""

    def on_robot_state(self, timestamp_us: int, packet: bytes, report: bool) -> None:
        self.latest = packet

    def leave(self) -> None:
        self._edge.detach(self)


class Crowd:
    """Guests and onlookers that come and go by chance.

    Args:
        robot: in lockstep.
        dice: decides; the same seed gives the same crowd.
    """

    def __init__(self, robot: SimulatedRobot, dice: random.Random) -> None:
        self.came = 0
        self._robot, self._dice = robot, dice
        self._guests: list[tuple[int, Guest]] = []
        self._onlookers: list[tuple[int, Onlooker]] = []
        self._turn = 0

    def speak(self, packets: int, may_damp: bool) -> None:
        """One control step's worth of packets.

        Args:
            packets: how many.
            may_damp: whether one of them may be DAMP, which acts for everybody; else none is.
        """
        self._turn += 1
        for _ in range(packets):
            if not self._guests or (len(self._guests) < CROWD and self._dice.random() < 0.02):
                self._welcome()
            self._dice.choice(self._guests)[1].speak(may_damp)
        self._see_off(lambda until: until <= self._turn)

    def leave(self) -> None:
        """Everybody goes."""
        self._see_off(lambda until: True)

    def _welcome(self) -> None:
        dice, until = self._dice, self._turn + self._dice.randrange(1, STAY_TURNS)
        kind = Talker if dice.random() < 0.6 else Babbler
        # Half of the names are of a few known clients, the others were never heard before.
        name = f"known {dice.randrange(20)}" if dice.random() < 0.5 else f"guest {self.came}"
        self._guests.append((until, kind(self._robot, name, dice)))
        if dice.random() < 0.3:
            self._onlookers.append((until, Onlooker(self._robot, dice)))
        self.came += 1

    def _see_off(self, over: Callable[[int], bool]) -> None:
        for _, leaver in [(until, one) for until, one in (*self._guests, *self._onlookers) if over(until)]:
            leaver.leave()
        self._guests = [(until, one) for until, one in self._guests if not over(until)]
        self._onlookers = [(until, one) for until, one in self._onlookers if not over(until)]
