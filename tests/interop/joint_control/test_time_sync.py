"""The vendor's client and the robot agree on the time."""

from __future__ import annotations

import pytest

pytest.importorskip("bosdyn", reason="bosdyn-client is not installed: pip install 'asimov-gym[joint-control,test]'")

from bosdyn.client.exceptions import InvalidRequestError

from asimov_gym.edge import SimulatedRobot
from asimov_gym.edge.transports.joint_control import JointControlLane
from asimov_gym.edge.transports.joint_control.vendor import time_sync_pb2
from tests.interop.joint_control.joint_client import Clients


def test_time_sync_finds_the_robots_clock(robot: SimulatedRobot, lane: JointControlLane) -> None:
    clients = Clients(lane.port)
    ready = []
    for _ in range(4):
        clients.endpoint.get_new_estimate()
        ready.append(clients.endpoint.has_established_time_sync)
    assert ready == [False, False, False, True]
    local_ns = 1_700_000_000 * 10**9
    found = clients.endpoint.get_robot_time_converter().robot_timestamp_from_local_secs(local_ns / 1e9)
    skew_s = clients.endpoint.clock_skew.ToNanoseconds() / 1e9
    assert found.ToNanoseconds() / 1e9 == pytest.approx(local_ns / 1e9 + skew_s, abs=1e-6)
    assert abs(skew_s) > 1e6, "the robot lives in its own year here"
    clients.close()


def test_time_sync_of_a_client_that_does_not_stamp_its_requests_never_settles(lane: JointControlLane) -> None:
    clients = Clients(lane.port)
    clients.time_sync.request_processors.clear()
    for _ in range(5):
        clients.endpoint.get_new_estimate()
    assert not clients.endpoint.has_established_time_sync
    clients.close()


def test_a_round_trip_without_an_identifier_is_invalid(clients: Clients) -> None:
    trip = time_sync_pb2.TimeSyncRoundTrip()
    with pytest.raises(InvalidRequestError):
        clients.time_sync.get_time_sync_update(previous_round_trip=trip, clock_identifier="nobody")
