"""Mutated packets of both dialects: no crash, no hang, flat memory, and every packet in exactly one counter."""

from __future__ import annotations

import random
import resource
from collections.abc import Iterator

import pytest

from asimov_gym.edge import Client, Dialect, SimulatedRobot, Source
from asimov_gym.edge.decode import MAX_PACKET_BYTES
from asimov_gym.edge.wire import cloud_pb2, io_pb2
from tests.edge.conftest import StandInPolicy

CLIENTS = (
    Client(Source.IN_PROCESS, "cloud", (Dialect.CLOUD,)),
    Client(Source.IN_PROCESS, "io", (Dialect.IO,)),
    Client(Source.IN_PROCESS, "both", (Dialect.CLOUD, Dialect.IO)),
)


def seeds() -> list[bytes]:
    """Well-formed packets to start from, and reports, which are no commands at all."""
    values = [0.1 * n for n in range(25)]
    segment = cloud_pb2.JointSegment(positions=values, kp=[100.0] * 25, kd=[2.0] * 25, duration=1.0)
    full = cloud_pb2.FullTrajectory(segments=[segment, segment])
    messages = [
        cloud_pb2.CloudCommand(sequence=1, timestamp_us=2**60, velocity=cloud_pb2.VelocityCommand(vx=0.5, vyaw=-1.0)),
        cloud_pb2.CloudCommand(velocity=cloud_pb2.VelocityCommand()),
        cloud_pb2.CloudCommand(sequence=2, mode=cloud_pb2.ModeCommand(mode=cloud_pb2.MODE_DAMP)),
        cloud_pb2.CloudCommand(sequence=3, mode=cloud_pb2.ModeCommand()),
        cloud_pb2.CloudCommand(sequence=4, trajectory=cloud_pb2.TrajectoryRequest(full=full, upper_only=True)),
        cloud_pb2.CloudCommand(trajectory=cloud_pb2.TrajectoryRequest(id="wave")),
        io_pb2.RobotCommand(protocol_version=1, mode=1, sequence=5),
        io_pb2.RobotCommand(protocol_version=1, sequence=6),
        io_pb2.RobotCommand(protocol_version=1, mode=2, policy=io_pb2.VelocityCommand(vx=0.3), sequence=7),
        io_pb2.RobotCommand(protocol_version=1, mode=2, all_trajectory=io_pb2.AllTrajectory(positions=values)),
        io_pb2.RobotCommand(protocol_version=1, eol=io_pb2.EolCommand(action=3, motor_id=2)),
        cloud_pb2.EdgeTelemetry(joint_pos=values, sequence=9, error_flags=5),
        io_pb2.RobotState(joint_pos=values, protocol_version=1),
    ]
    return [message.SerializeToString() for message in messages] + [b""]


def mutations(count: int, seed: int) -> Iterator[bytes]:
    """Packets made of the seeds by flipping, cutting, inserting, doubling and splicing; some far too large."""
    rng = random.Random(seed)
    pool = seeds()
    for _ in range(count):
        packet = bytearray(rng.choice(pool))
        for _ in range(rng.choice((0, 1, 1, 2, 5, 20))):
            kind, place = rng.randrange(6), rng.randrange(len(packet) + 1)
            if kind == 0 and place < len(packet):
                packet[place] ^= 1 << rng.randrange(8)
            elif kind == 1 and place < len(packet):
                packet[place] = rng.randrange(256)
            elif kind == 2:
                del packet[place:]
            elif kind == 3:
                packet[place:place] = rng.randbytes(rng.randrange(1, 9))
            elif kind == 4:
                packet += packet[place:]
            else:
                packet[place:] = rng.choice(pool)
            del packet[4096:]  # doubling grows fast
        if rng.random() < 0.001:
            packet += bytes(MAX_PACKET_BYTES)
        yield bytes(packet)


def fuzz(count: int, seed: int) -> tuple[SimulatedRobot, int]:
    """Feed `count` mutated packets to a robot; its memory's growth over the second half, KiB."""
    robot = SimulatedRobot(StandInPolicy())
    middle = 0
    for number, packet in enumerate(mutations(count, seed)):
        robot.edge.receive(packet, CLIENTS[number % 3])
        if number % 500 == 0:
            robot.advance(0.005)
        if number == count // 2:
            middle = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return robot, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - middle


def check(robot: SimulatedRobot, count: int) -> None:
    tally = robot.edge.tally
    assert tally.packets == count
    assert tally.accepted.total() + tally.dropped.total() == count
    # The mutations must reach every kind of command and most reasons, or they test nothing.
    assert all(tally.accepted[kind] > 0 for kind in ("velocity", "mode", "trajectory"))
    assert len(tally.dropped) >= 12
    robot.advance(0.5)
    assert robot.edge.latest  # and the robot still reports


def test_twenty_thousand_mutated_packets() -> None:
    robot, _ = fuzz(20_000, seed=1)
    check(robot, 20_000)


@pytest.mark.slow
def test_a_million_mutated_packets_in_flat_memory() -> None:
    robot, growth_kib = fuzz(1_000_000, seed=2)
    check(robot, 1_000_000)
    assert growth_kib < 16 * 1024
