"""A client below any session, in a room with a stand-in for the client library, and what it sends and hears."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Coroutine
from typing import Any

from asimov_gym.edge import SimulatedRobot
from asimov_gym.edge.wire import cloud_pb2, io_pb2
from asimov_gym.firmware import State
from tests.livekit_standin import DataTrackFrame, Room, StandInServer


class Member:
    """A client below any session, in the event loop of the test."""

    def __init__(self, server: StandInServer, identity: str = "client") -> None:
        self.room = Room(server)
        self.identity = identity
        self.packets: list[tuple[str, bytes]] = []
        self.frames: dict[str, list[DataTrackFrame]] = {}
        self.room.on("data_received", lambda packet: self.packets.append((packet.topic, packet.data)))
        self.room.on("data_track_published", self._on_track)
        self._tasks: list[asyncio.Task[None]] = []

    async def join(self) -> Member:
        await self.room.connect("", self.identity, None)
        await until(lambda: all(track.readers for other in self.room.others() for track in other.tracks))
        return self

    async def send(self, packet: bytes, topic: str = "commands") -> None:
        await self.room.local_participant.publish_data(packet, topic=topic)

    def taken(self, topic: str) -> list[bytes]:
        return [data for name, data in self.packets if name == topic]

    def _on_track(self, track: Any) -> None:
        self._tasks.append(asyncio.create_task(self._read(track)))

    async def _read(self, track: Any) -> None:
        async for frame in track.subscribe():
            self.frames.setdefault(track.info.name, []).append(frame)


async def until(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + 5.0
    while not condition():
        assert time.monotonic() < end, "it did not happen within 5 s"
        await asyncio.sleep(0.002)


def wait_for(condition: Callable[[], bool]) -> None:
    asyncio.run(until(condition))


def meet(scene: Callable[[], Coroutine[Any, Any, None]]) -> None:
    asyncio.run(scene())


def mode(number: cloud_pb2.Mode.ValueType, sequence: int = 1) -> bytes:
    command = cloud_pb2.CloudCommand(sequence=sequence, mode=cloud_pb2.ModeCommand(mode=number))
    return command.SerializeToString()


def velocity(vx: float, sequence: int = 2) -> bytes:
    command = cloud_pb2.CloudCommand(sequence=sequence, velocity=cloud_pb2.VelocityCommand(vx=vx))
    return command.SerializeToString()


def io_command(sequence: int, **fields: object) -> bytes:
    command = io_pb2.RobotCommand(protocol_version=1, sequence=sequence, **fields)  # type: ignore[arg-type]
    return command.SerializeToString()


STAND, DAMP = mode(cloud_pb2.MODE_STAND), mode(cloud_pb2.MODE_DAMP)


async def walk(server: StandInServer, robot: SimulatedRobot) -> Member:
    member = await Member(server).join()
    await member.send(STAND)
    await until(lambda: robot.edge.tally.packets == 1)
    robot.advance(0.1)
    await member.send(velocity(0.3))
    await until(lambda: robot.edge.tally.packets == 2)
    robot.advance(0.1)
    assert robot.firmware.state is State.POLICY
    return member


def codes(member: Member) -> list[str]:
    return [cloud_pb2.EdgeEvent.FromString(packet).error.code for packet in member.taken("system")]


def said(member: Member) -> list[str]:
    events = [cloud_pb2.EdgeEvent.FromString(packet) for packet in member.taken("system")]
    return [event.error.message for event in events if event.error.code == "cloud"]
