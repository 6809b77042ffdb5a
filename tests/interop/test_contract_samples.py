"""The code of the published control page, word for word, in one namespace, against a running robot.

The blocks are in tests/data/contract_samples. Two of them are run in two parts, divided at a comment of their own: the
trajectory sample says that its `latest_telemetry` is filled by the reader's handler in between, and the mode sample
builds two commands without sending either.
"""

from __future__ import annotations

import ast
import asyncio
import contextlib
import inspect
import io
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from asimov_gym.edge import DropReason, EdgeListener, SimulatedRobot, compat
from asimov_gym.edge.transports import livekit_visit
from asimov_gym.edge.transports.livekit import LiveKitLane
from asimov_gym.edge.wire import cloud_pb2
from asimov_gym.firmware import State, WallClock
from asimov_gym.policy import default_contract
from tests.livekit_standin import Room, StandInServer
from tests.network_namespace import in_namespace

SAMPLES = Path(__file__).parents[1] / "data" / "contract_samples"
POLICY = Path(__file__).parents[2] / "assets" / "policies" / "asimov_walk.onnx"


def sample(name: str) -> str:
    return (SAMPLES / f"{name}.txt").read_text()


def parts(name: str, comment: str) -> tuple[str, str]:
    """A sample, divided before one of its comments."""
    before, found, after = sample(name).partition(comment)
    assert found and "\n" in before
    return before, comment + after


FIRST_PART, TRAJECTORY = parts("trajectory", "# ... once `latest_telemetry` has been populated")
STAND_UP, EMERGENCY_STOP = parts("mode", "# Emergency stop (damp)")


@pytest.fixture(autouse=True)
def import_path() -> Iterator[None]:
    compat.install()
    yield
    compat.uninstall()


class Page:
    """The reader's program: one namespace, in which the blocks are run."""

    def __init__(self, room: Any) -> None:
        self.namespace: dict[str, Any] = {"room": room}
        self.printed = io.StringIO()
        room.on("data_received", self._on_packet)

    async def run(self, block: str) -> None:
        code = compile(block, "<sample>", "exec", flags=ast.PyCF_ALLOW_TOP_LEVEL_AWAIT)
        outcome = eval(code, self.namespace)
        if inspect.isawaitable(outcome):
            await outcome

    async def publish(self) -> None:
        """Send the command that a block has built and left in `cmd`."""
        packet = self.namespace["cmd"].SerializeToString()
        await self.namespace["room"].local_participant.publish_data(packet, topic="commands", reliable=True)

    def _on_packet(self, packet: Any) -> None:
        if packet.topic == "state":
            self.latest = cloud_pb2.EdgeTelemetry.FromString(packet.data)

    def fill_latest_telemetry(self) -> None:
        self.namespace["latest_telemetry"] = self.latest


class Modes(EdgeListener):
    """The robot's changes of mode."""

    def __init__(self) -> None:
        self.seen: list[str] = []

    def on_event(self, timestamp_us: int, packet: bytes) -> None:
        event = cloud_pb2.EdgeEvent.FromString(packet)
        if event.error.code == "mode_change":
            self.seen.append(event.error.message)


async def until(condition: Callable[[], Any], timeout: float = 10.0) -> None:
    end = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < end, f"it did not happen within {timeout} s"
        await asyncio.sleep(0.01)


async def work_through(
    room: Any, robot: SimulatedRobot, join: Callable[[], object], walked: Callable[[], bool]
) -> None:
    """The page from top to bottom: `room` is joined, `join` brings the robot there."""
    modes, tally = Modes(), robot.edge.tally
    robot.edge.attach(modes)
    page = Page(room)
    with contextlib.redirect_stdout(page.printed):
        await page.run(sample("telemetry"))
        await asyncio.to_thread(join)
        await until(lambda: "Mode: 0, Joints: [" in page.printed.getvalue())

        await page.run(sample("velocity"))  # in DAMP, where it has no effect and gets no answer
        await until(lambda: tally.dropped[DropReason.VELOCITY_IN_DAMP] == 1)
        await page.run(STAND_UP)
        await page.publish()
        await until(lambda: "Mode: 1" in page.printed.getvalue())
        await page.run(sample("velocity"))
        await until(lambda: "Mode: 2" in page.printed.getvalue())
        assert robot.firmware.snapshot.velocity == pytest.approx([0.5, 0.0, 0.0])
        await until(walked)

        await page.run(FIRST_PART)
        page.fill_latest_telemetry()
        await page.run(TRAJECTORY)
        await until(lambda: modes.seen[-1] == "MOVE/TRAJECTORY -> DAMP")  # the sample sends one packet: 200 ms of it
        await page.run(STAND_UP)
        await page.publish()
        await until(lambda: robot.firmware.state is State.STAND)
        await page.run(EMERGENCY_STOP)
        await page.publish()
        await until(lambda: robot.firmware.state is State.DAMP and modes.seen[-1] == "STAND -> DAMP")
    assert modes.seen == [
        "DAMP -> STAND",
        "STAND -> MOVE/POLICY",
        "MOVE/POLICY -> MOVE/TRAJECTORY",
        "MOVE/TRAJECTORY -> DAMP",
        "DAMP -> STAND",
        "STAND -> DAMP",
    ]
    assert tally.dropped == {DropReason.VELOCITY_IN_DAMP: 1}
    assert page.namespace["positions"][15] == 1.2 and len(page.namespace["positions"]) == 25


class StandingPolicy:
    """A network that answers zero: the standing pose."""

    def __init__(self) -> None:
        self.contract = default_contract(command_ranges=((-0.6, 0.8), (-0.4, 0.4), (-0.8, 0.8)))

    def infer(self, observation: np.ndarray) -> np.ndarray:
        return np.zeros((len(observation), 23), dtype=np.float32)


def test_the_samples_run_without_a_server(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(livekit_visit, "LINGER_S", 0.0)
    server = StandInServer()
    server.install(monkeypatch)
    robot = SimulatedRobot(StandingPolicy())
    lane = LiveKitLane(robot.edge, "ws://room:7880", "robot")
    done = threading.Event()

    def live() -> None:
        while not done.wait(0.001):
            robot.advance(0.01)

    async def scene() -> None:
        room = Room(server)
        await room.connect("", "reader", None)
        await work_through(room, robot, lane.start, walked=lambda: True)

    time_passes = threading.Thread(target=live)
    time_passes.start()
    try:
        asyncio.run(scene())
    finally:
        done.set()
        time_passes.join()
        lane.stop()


@in_namespace(timeout=120)
async def test_the_samples_run_in_a_room() -> None:
    """The same through the real client library, and the robot walks: a quarter of a metre with the shipped network."""
    from livekit import rtc

    from asimov_gym.room import RoomThread

    with RoomThread() as server, SimulatedRobot(POLICY, clock=WallClock()) as robot:
        room = rtc.Room()
        await room.connect(server.url, server.token(None, "reader"))
        token = server.token(None, "robot", can_update_own_metadata=True)

        def distance() -> float:
            with robot.edge.lock:
                return float(robot.physics.state().qpos[0][0])

        lane = LiveKitLane(robot.edge, server.url, token)
        try:
            await work_through(room, robot, lane.start, walked=lambda: distance() > 0.25)
        finally:
            lane.stop()
            await room.disconnect()
