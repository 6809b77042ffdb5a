"""States and updates at their rates, by the wall clock."""

from __future__ import annotations

import time

import numpy as np
import pytest

pytest.importorskip("bosdyn", reason="bosdyn-client is not installed: pip install 'asimov-gym[joint-control,test]'")

from bosdyn.client.robot_command import RobotCommandBuilder

from asimov_gym.edge import EdgeListener, SimulatedRobot
from asimov_gym.edge.transports.joint_control import JointControlLane
from asimov_gym.edge.wire import cloud_pb2
from asimov_gym.firmware import WallClock
from asimov_gym.robot.joints import STAND_POSITION
from tests.interop.joint_control.joint_client import (
    ACTIVATE,
    ELBOW,
    Clients,
    OpenStream,
    StateReader,
    StreamStatus,
    update,
)


class Overloads(EdgeListener):
    """How often the robot said that it cannot keep up."""

    def __init__(self) -> None:
        self.count = 0

    def on_event(self, timestamp_us: int, packet: bytes) -> None:
        self.count += cloud_pb2.EdgeEvent.FromString(packet).error.code == "overload"


@pytest.mark.slow
def test_in_real_time_states_keep_their_rate_and_a_sinusoid_is_tracked() -> None:
    with SimulatedRobot(clock=WallClock()) as robot, JointControlLane(robot.edge, 0) as lane:
        overloads = Overloads()
        robot.edge.attach(overloads)
        clients = Clients(lane.port)
        clients.synchronize()
        clients.command.robot_command(RobotCommandBuilder.synchro_stand_command())
        time.sleep(2.5)
        reader = StateReader(clients)
        stream = OpenStream(clients)
        converter = clients.endpoint.get_robot_time_converter()
        start = time.time()
        for key in range(1, 1000):
            phase = 2.0 * np.pi * 0.5 * (time.time() - start)
            position, velocity = STAND_POSITION.copy(), np.zeros(25)
            position[ELBOW] += 0.3 * np.sin(phase)
            velocity[ELBOW] = 0.3 * np.pi * np.cos(phase)
            end_us = converter.robot_timestamp_from_local_secs(time.time() + 0.5).ToMicroseconds()
            request = update(end_us, key, gains=key == 1, position=position, extrapolation_duration=5_000)
            request.joint_command.velocity[:] = velocity.tolist()
            stream.send(request)
            if key == 3:
                clients.command.robot_command(ACTIVATE)
            time.sleep(max(0.0, start + key / 333.0 - time.time()))
        answer = stream.finish()
        assert answer.status == StreamStatus.STATUS_OK, answer.message
        reader.stop()
        clients.close()
    stamps = np.array([message.joint_states.acquisition_timestamp.ToMicroseconds() for message in reader.messages])
    assert (np.diff(stamps) > 0).all()
    rate = 1e6 * (len(stamps) - 1) / (stamps[-1] - stamps[0])
    # A machine that is busy with other things cannot keep the rate, and then the robot must have said so.
    assert 300.0 < rate < 340.0 or overloads.count
    elbow = np.array([message.joint_states.position[ELBOW] for message in reader.messages])
    assert np.ptp(elbow[len(elbow) // 2 :]) == pytest.approx(0.6, abs=0.12)
    keys = [message.last_command.user_command_key for message in reader.messages]
    assert keys == sorted(keys)
    assert len(set(keys)) > 500, "most updates are the last one when some state is made"
