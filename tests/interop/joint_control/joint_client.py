"""The vendor's own Python client of joint control, against a simulated robot in this process."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from importlib import import_module
from typing import Any

import grpc
import numpy as np
from bosdyn.client.processors import AddRequestHeader
from bosdyn.client.robot_command import RobotCommandClient, RobotCommandStreamingClient
from bosdyn.client.robot_state import RobotStateClient, RobotStateStreamingClient
from bosdyn.client.time_sync import TimeSyncClient, TimeSyncEndpoint
from google.protobuf.timestamp_pb2 import Timestamp

from asimov_gym.edge import SimulatedRobot
from asimov_gym.edge.transports.joint_control.vendor import basic_command_pb2, robot_command_pb2
from asimov_gym.robot.joints import KD, KP, STAND_POSITION, joint_index

ELBOW = joint_index("left_elbow_joint")
"""The joint that the tests move."""
PATIENCE_S = 10.0
"""For anything that another thread does."""
FullBody: Any = import_module("bosdyn.api.full_body_command_pb2").FullBodyCommand.Request
UpdateRequest = robot_command_pb2.JointControlStreamRequest
StreamStatus = robot_command_pb2.JointControlStreamResponse


def full_body(**fields: Any) -> Any:
    """A RobotCommand for the whole body, such as `stop_request=...`."""
    return robot_command_pb2.RobotCommand(full_body_command=FullBody(**fields))


ACTIVATE = full_body(joint_request=basic_command_pb2.JointCommand.Request())
STOP = full_body(stop_request=basic_command_pb2.StopCommand.Request())
FREEZE = full_body(freeze_request=basic_command_pb2.FreezeCommand.Request())
POWER_OFF = full_body(safe_power_off_request=basic_command_pb2.SafePowerOffCommand.Request())


def timestamp(microseconds: int) -> Timestamp:
    return Timestamp(seconds=microseconds // 1_000_000, nanos=1000 * (microseconds % 1_000_000))


def update(end_us: int, key: int = 0, gains: bool = True, position: np.ndarray = STAND_POSITION, **fields: Any) -> Any:
    """An update that is right in everything, ready to be spoiled."""
    request = UpdateRequest()
    command = request.joint_command
    command.end_time.CopyFrom(timestamp(end_us))
    command.position.extend(position.tolist())
    command.velocity.extend([0.0] * 25)
    command.load.extend([0.0] * 25)
    command.user_command_key = key
    if gains:
        command.gains.k_q_p.extend(KP.tolist())
        command.gains.k_qd_p.extend(KD.tolist())
    for name, value in fields.items():
        field = getattr(command, name)
        if hasattr(field, "value"):
            field.value = value
        else:
            field.FromMicroseconds(value)
    return request


class Clients:
    """The five clients on one plain channel, as a program without the library's robot object uses them."""

    def __init__(self, port: int) -> None:
        self.channel = grpc.insecure_channel(f"127.0.0.1:{port}")
        self.time_sync = self._made(TimeSyncClient())
        self.endpoint = TimeSyncEndpoint(self.time_sync)
        self.command = self._made(RobotCommandClient())
        self.command._timesync_endpoint = self.endpoint  # the robot object would set it
        self.state = self._made(RobotStateClient())
        self.states = self._made(RobotStateStreamingClient())
        self.updates = self._made(RobotCommandStreamingClient())

    def _made(self, client: Any) -> Any:
        client.channel = self.channel
        client.request_processors.append(AddRequestHeader(lambda: "tester"))
        return client

    def synchronize(self) -> None:
        assert self.endpoint.establish_timesync(10, break_on_success=True)

    def close(self) -> None:
        self.channel.close()


class OpenStream:
    """A stream of updates in a thread: the library's call blocks until the stream is over."""

    def __init__(self, clients: Clients) -> None:
        self.response: Any = None
        self.error: grpc.RpcError | None = None
        self._queue: queue.Queue[Any] = queue.Queue()
        self._thread = threading.Thread(target=self._run, args=(clients,), daemon=True)
        self._thread.start()

    def _run(self, clients: Clients) -> None:
        try:
            self.response = clients.updates.send_joint_control_commands(iter(self._queue.get, None))
        except grpc.RpcError as error:
            self.error = error

    def send(self, request: Any) -> None:
        self._queue.put(request)

    def finish(self) -> Any:
        """Close it from this side; the robot's answer."""
        self._queue.put(None)
        return self.answer()

    def answer(self) -> Any:
        """The robot's answer; waits for it."""
        self._thread.join(PATIENCE_S)
        assert not self._thread.is_alive(), "the stream goes on"
        assert self.error is None, self.error
        return self.response


class StateReader:
    """Reads states in a thread."""

    def __init__(self, clients: Clients) -> None:
        self.messages: list[Any] = []
        self._call = clients.states.get_robot_state_stream()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        with suppress(grpc.RpcError):  # cancelled
            for message in self._call:
                self.messages.append(message)

    def stop(self) -> None:
        self._call.cancel()
        self._thread.join(PATIENCE_S)


def eventually(condition: Callable[[], Any], what: str) -> None:
    """Wait, in real time, for what another thread does."""
    end = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end, f"not within {PATIENCE_S} s: {what}"
        time.sleep(0.002)


class Pilot:
    """A run in lockstep."""

    def __init__(self, robot: SimulatedRobot, clients: Clients) -> None:
        self.robot, self.clients = robot, clients

    def now(self, ahead_s: float = 0.0) -> int:
        return self.robot.clock.realtime_us() + round(ahead_s * 1e6)

    def update(self, ahead_s: float = 1.0, **fields: Any) -> Any:
        return update(self.now(ahead_s), **fields)

    def open(self, **fields: Any) -> OpenStream:
        """A stream with one update that has arrived."""
        stream = OpenStream(self.clients)
        self.send(stream, **fields)
        return stream

    def send(self, stream: OpenStream, **fields: Any) -> None:
        taken = self.robot.edge.tally.accepted
        before = taken["joint_command"]
        stream.send(self.update(**fields))
        eventually(lambda: taken["joint_command"] > before, "the update arrives")

    def begin(self, **fields: Any) -> OpenStream:
        """A run under way, in the order of the vendor's examples: the stream first."""
        stream = self.open(**fields)
        self.clients.command.robot_command(ACTIVATE)
        self.robot.advance(0.01)
        return stream

    def feedback(self, number: int = 0) -> Any:
        return self.clients.command.robot_command_feedback(number).feedback.full_body_feedback
