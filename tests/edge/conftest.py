"""A simulated robot in lockstep, with a network that stands."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest

from asimov_gym.edge import Client, Session, SimulatedRobot, Source, Verdict, connect
from asimov_gym.edge.wire import cloud_pb2
from asimov_gym.policy import default_contract


class StandInPolicy:
    """A network that answers zero: the standing pose."""

    def __init__(self) -> None:
        self.contract = default_contract(command_ranges=((-0.6, 0.8), (-0.4, 0.4), (-0.8, 0.8)))

    def infer(self, observation: np.ndarray) -> np.ndarray:
        return np.zeros((len(observation), 23), dtype=np.float32)


class Wire:
    """A client below the session: sends messages and sees the robot's verdicts."""

    def __init__(self, robot: SimulatedRobot) -> None:
        self.robot = robot
        self.client = Client(Source.IN_PROCESS, "wire")

    def send(self, **fields: object) -> Verdict:
        """Send a CloudCommand with these fields."""
        return self.raw(cloud_pb2.CloudCommand(**fields).SerializeToString())  # type: ignore[arg-type]

    def raw(self, packet: bytes) -> Verdict:
        return self.robot.edge.receive(packet, self.client)

    def mode(self, number: int) -> Verdict:
        return self.send(mode=cloud_pb2.ModeCommand(mode=number))  # type: ignore[arg-type]

    def stand(self) -> Verdict:
        return self.mode(cloud_pb2.MODE_STAND)

    def velocity(self, vx: float, vy: float = 0.0, vyaw: float = 0.0) -> Verdict:
        return self.send(velocity=cloud_pb2.VelocityCommand(vx=vx, vy=vy, vyaw=vyaw))

    def segments(self, *segments: cloud_pb2.JointSegment, **fields: object) -> Verdict:
        full = cloud_pb2.FullTrajectory(segments=segments)
        return self.send(trajectory=cloud_pb2.TrajectoryRequest(full=full, **fields))  # type: ignore[arg-type]


@pytest.fixture
def make_robot() -> Callable[..., SimulatedRobot]:
    def make(**arguments: object) -> SimulatedRobot:
        return SimulatedRobot(**({"policy": StandInPolicy()} | arguments))  # type: ignore[arg-type]

    return make


@pytest.fixture
def robot(make_robot: Callable[..., SimulatedRobot]) -> SimulatedRobot:
    return make_robot()


@pytest.fixture
def wire(robot: SimulatedRobot) -> Wire:
    return Wire(robot)


@pytest.fixture
def session(robot: SimulatedRobot) -> Iterator[Session]:
    with connect(robot, "tester") as session:
        yield session
