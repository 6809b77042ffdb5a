"""A robot in lockstep and the vendor's clients on its joint-control lane.

Time stands still but for `advance`, so the counts of the tests are exact. Where a test waits, it waits for a message to
cross the loopback. What needs the vendor's package is imported in the fixtures: without it the tests are skipped.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest

from asimov_gym.edge import SimulatedRobot
from asimov_gym.edge.transports.joint_control import JointControlLane

if TYPE_CHECKING:
    from tests.interop.joint_control.joint_client import Clients, Pilot


@pytest.fixture
def robot() -> SimulatedRobot:
    return SimulatedRobot()


@pytest.fixture
def lane(robot: SimulatedRobot) -> Iterator[JointControlLane]:
    with JointControlLane(robot.edge, 0) as lane:
        yield lane


@pytest.fixture
def clients(lane: JointControlLane) -> Iterator[Clients]:
    from tests.interop.joint_control.joint_client import Clients

    clients = Clients(lane.port)
    clients.synchronize()
    yield clients
    clients.close()


@pytest.fixture
def pilot(robot: SimulatedRobot, clients: Clients) -> Pilot:
    from tests.interop.joint_control.joint_client import Pilot

    return Pilot(robot, clients)
