"""Joint poses streamed to `asimov robot --joint-control PORT`, and how long the loop takes, from the echo of the keys.

Written with the vendor's own client classes, as any program for the joint-control interface would be: needs
`pip install 'asimov-gym[joint-control]'`. The two examples beside it say which poses.
"""

# The vendor's message classes are built as they are imported: a type checker does not know their fields.
# pyright: reportAttributeAccessIssue=false, reportCallIssue=false

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import grpc
import matplotlib
import numpy as np
from bosdyn.api.basic_command_pb2 import JointCommand, StopCommand
from bosdyn.api.full_body_command_pb2 import FullBodyCommand
from bosdyn.api.robot_command_pb2 import JointControlStreamRequest, JointControlStreamResponse, RobotCommand
from bosdyn.client.exceptions import Error
from bosdyn.client.processors import AddRequestHeader
from bosdyn.client.robot_command import (
    RobotCommandClient,
    RobotCommandStreamingClient,
    blocking_stand,
)
from bosdyn.client.robot_state import RobotStateStreamingClient
from bosdyn.client.time_sync import TimeSyncClient, TimeSyncEndpoint

from asimov_gym.robot.joints import KD, KP

matplotlib.use("Agg")
import matplotlib.pyplot as plt

UPDATE_HZ = 333.0
HORIZON_S = 0.2
"""End of each update after it was sent: what the robot goes on with when this program dies."""
LAST_S = 0.5
"""End of the last update: time to ask for STAND."""
EXTRAPOLATION_S = 0.005


@dataclass(frozen=True)
class Leg:
    """A stretch of the motion, straight to a pose."""

    pose: np.ndarray
    """rad, (25,)."""
    seconds: float


@dataclass(frozen=True)
class Latency:
    """What the echoes say, one value for each update whose key was seen, ms."""

    to_robot: np.ndarray
    """From sending until the robot had it, by the robot's clock."""
    round_trip: np.ndarray
    """From sending until a state with its key was here."""
    updates: int
    """How many were sent."""


class JointStream:
    """A connection to a robot's joint control.

    Args:
        target: `HOST:PORT` of the lane.

    Raises:
        ConnectionError: nobody answers there.
    """

    def __init__(self, target: str) -> None:
        self._channel = grpc.insecure_channel(target)
        self._time_sync = TimeSyncEndpoint(self._client(TimeSyncClient()))
        self._command: Any = self._client(RobotCommandClient())
        self._command._timesync_endpoint = self._time_sync  # what the library's robot object does with it
        self._updates = self._client(RobotCommandStreamingClient())
        self._states: Any = None
        self._sent: dict[int, float] = {}
        self._seen: dict[int, tuple[float, float]] = {}
        self._first = threading.Event()
        self.state: Any = None
        """The last RobotStateStreamResponse."""
        try:
            self._time_sync.establish_timesync()  # many round trips: the best one tells the skew
        except Error as problem:
            raise ConnectionError(f"no joint control at {target}: {problem}") from None

    def _client(self, client: Any) -> Any:
        client.channel = self._channel
        client.request_processors.append(AddRequestHeader(lambda: "asimov-example"))
        return client

    def close(self) -> None:
        """Leave."""
        if self._states is not None:
            self._states.cancel()
        self._channel.close()

    def stand(self) -> None:
        """Stand up; waits until the robot does."""
        blocking_stand(self._command, timeout_sec=10)

    def measured(self) -> tuple[np.ndarray, np.ndarray]:
        """Position and load of the joints now, rad and N·m, (25,) each. Starts the stream of states.

        Raises:
            TimeoutError: no state comes.
        """
        if self._states is None:
            self._states = self._client(RobotStateStreamingClient()).get_robot_state_stream()
            threading.Thread(target=self._read_states, daemon=True).start()
        if not self._first.wait(5.0):
            raise TimeoutError("no state within 5 s")
        joints = self.state.joint_states
        return np.array(joints.position), np.array(joints.load)

    def _read_states(self) -> None:
        try:
            for state in self._states:
                now, self.state = time.time(), state
                self._first.set()
                key = state.last_command.user_command_key
                if key in self._sent and key not in self._seen:
                    self._seen[key] = (now, state.last_command.received_timestamp.ToNanoseconds() / 1e9)
        except grpc.RpcError:
            return  # cancelled by `close`, or the robot has gone, which the stream of updates tells

    def follow(self, legs: Sequence[Leg], gain: float = 1.0) -> Latency:
        """Go through poses, then stand.

        Args:
            legs: one after the other, from where the robot is.
            gain: factor on the robot's own position gains.

        Raises:
            RuntimeError: the robot ended the stream; the message says why.
        """
        start, load = self.measured()
        answer = self._updates.send_joint_control_commands(self._requests(start, load, legs, gain))
        if answer.status != JointControlStreamResponse.STATUS_OK:
            name = JointControlStreamResponse.Status.Name(answer.status)
            raise RuntimeError(f"the robot ended the stream with {name}: {answer.message}")
        stop = FullBodyCommand.Request(stop_request=StopCommand.Request())
        self._command.robot_command(RobotCommand(full_body_command=stop))
        time.sleep(0.1)  # the last echoes
        return self._latency()

    def _requests(self, start: np.ndarray, load: np.ndarray, legs: Sequence[Leg], gain: float) -> Iterator[Any]:
        key = 0
        pose = start
        began = time.monotonic()
        for leg in legs:
            slope = (leg.pose - pose) / leg.seconds
            until = began + leg.seconds
            while (now := time.monotonic()) < until:
                key += 1
                yield self._request(key, pose + slope * (now - began), slope, load, gain if key == 1 else None)
                if key == 1:
                    threading.Thread(target=self._activate, daemon=True).start()
                time.sleep(max(0.0, now + 1.0 / UPDATE_HZ - time.monotonic()))
            pose, began = leg.pose, until
        yield self._request(key + 1, pose, np.zeros_like(pose), load, None, LAST_S)

    def _activate(self) -> None:
        """Once the first update is out: a run without one would only hold the pose."""
        request = FullBodyCommand.Request(joint_request=JointCommand.Request())
        try:
            self._command.robot_command(RobotCommand(full_body_command=request))
        except Error as problem:
            print(f"the robot refuses joint control: {problem}", file=sys.stderr)

    def _request(
        self,
        key: int,
        position: np.ndarray,
        velocity: np.ndarray,
        load: np.ndarray,
        gain: float | None,
        horizon: float = HORIZON_S,
    ) -> Any:
        request = JointControlStreamRequest()
        update = request.joint_command
        now = time.time()
        update.end_time.CopyFrom(self._time_sync.robot_timestamp_from_local_secs(now + horizon))
        update.extrapolation_duration.FromNanoseconds(round(1e9 * EXTRAPOLATION_S))
        update.position.extend(position.tolist())
        update.velocity.extend(velocity.tolist())
        update.load.extend(load.tolist())
        if gain is not None:
            update.gains.k_q_p.extend((gain * KP).tolist())
            update.gains.k_qd_p.extend(KD.tolist())
        update.user_command_key = key
        self._sent[key] = now
        return request

    def _latency(self) -> Latency:
        skew = self._time_sync.clock_skew.ToNanoseconds() / 1e9
        rows = [(taken - skew - self._sent[key], seen - self._sent[key]) for key, (seen, taken) in self._seen.items()]
        to_robot, round_trip = 1e3 * np.array(rows).reshape(-1, 2).T
        return Latency(to_robot, round_trip, len(self._sent))


def plot_latency(latency: Latency, title: str, path: Path) -> None:
    """Draw the latencies as a histogram."""
    figure, axes = plt.subplots(figsize=(7.0, 4.0), layout="constrained")
    highest = float(np.percentile(latency.round_trip, 99.5)) * 1.2
    bins = np.linspace(0.0, max(highest, 1.0), 80).tolist()
    for name, values in (("until the robot has it", latency.to_robot), ("until its echo is back", latency.round_trip)):
        p50, p99 = np.percentile(values, (50, 99))
        axes.hist(values, bins, alpha=0.6, label=f"{name}: median {p50:.2f} ms, 99 % under {p99:.2f} ms")
    axes.set(xlabel="ms after an update was sent", ylabel="updates", title=title)
    axes.legend()
    axes.grid(alpha=0.3)
    figure.savefig(path, dpi=120)
    plt.close(figure)


def run(target: str, legs_from: Any, title: str, plot: Path, gain: float) -> int:
    """Stand up, stream, stand again, print and draw the latency.

    Args:
        target: `HOST:PORT`.
        legs_from: gives the legs of the motion, from the pose (25,) that it starts in.
        title: of the plot.
        plot: PNG file.
        gain: factor on the robot's own position gains.

    Returns:
        Exit code: 1 when the robot ended the stream, 2 when it was not reached.
    """
    try:
        stream = JointStream(target)
    except ConnectionError as problem:
        print(f"{problem}. Is `asimov robot --joint-control PORT` running?", file=sys.stderr)
        return 2
    try:
        stream.stand()
        latency = stream.follow(legs_from(stream.measured()[0]), gain)
    except (RuntimeError, TimeoutError, Error) as problem:
        print(problem, file=sys.stderr)
        return 1
    finally:
        stream.close()
    for name, values in (("to the robot", latency.to_robot), ("round trip", latency.round_trip)):
        p50, p99 = np.percentile(values, (50, 99))
        print(f"{name:<13} median {p50:6.2f} ms, 99 % under {p99:6.2f} ms, at most {values.max():6.2f} ms")
    print(f"{len(latency.round_trip)} of {latency.updates} updates echoed; histogram in {plot}")
    plot_latency(latency, title, plot)
    return 0
