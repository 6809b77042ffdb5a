"""The robot in a room, with a stand-in for the client library; the real one is in test_livekit_room.py."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from asimov_gym.edge import Dialect, SimulatedRobot
from asimov_gym.edge.transports import livekit, livekit_visit
from asimov_gym.edge.transports.livekit import LiveKitLane
from tests.livekit_standin import StandInServer

TOKEN = "robot"
"""The stand-in's tokens are identities."""


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> StandInServer:
    server = StandInServer()
    server.install(monkeypatch)
    monkeypatch.setattr(livekit, "FIRST_WAIT_S", 0.01)
    monkeypatch.setattr(livekit, "LONGEST_WAIT_S", 0.05)
    monkeypatch.setattr(livekit_visit, "SETTLE_S", 0.01)
    monkeypatch.setattr(livekit_visit, "LINGER_S", 0.0)
    return server


@pytest.fixture
def make_lane(robot: SimulatedRobot, server: StandInServer) -> Iterator[Callable[..., LiveKitLane]]:
    lanes: list[LiveKitLane] = []

    def make(*dialects: Dialect, token: str = TOKEN) -> LiveKitLane:
        lanes.append(LiveKitLane(robot.edge, "ws://room:7880", token, dialects or (Dialect.CLOUD,)))
        lanes[-1].start()
        return lanes[-1]

    yield make
    for lane in lanes:
        lane.stop()
