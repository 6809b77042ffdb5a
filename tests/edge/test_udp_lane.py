"""The UDP lane, seen from a socket: what goes in, what comes out, and what cannot stall it."""

from __future__ import annotations

import errno
import itertools
import logging
import socket
import time
from collections.abc import Callable, Iterator

import pytest

from asimov_gym.edge import DropReason, SimulatedRobot
from asimov_gym.edge.transports import TransportError
from asimov_gym.edge.transports import udp as module
from asimov_gym.edge.transports.udp import UdpLane
from asimov_gym.edge.wire import cloud_pb2, io_pb2

DAMP, STAND, MOVE = io_pb2.CONTROL_MODE_DAMP, io_pb2.CONTROL_MODE_STAND, io_pb2.CONTROL_MODE_MOVE


class Peer:
    """A client without a session: one socket for commands, one for state."""

    def __init__(self) -> None:
        self.commands = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.states = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.states.bind(("127.0.0.1", 0))
        self.states.setblocking(False)
        self.commands.settimeout(0.05)

    @property
    def state_port(self) -> int:
        return self.states.getsockname()[1]

    def frames(self) -> list[io_pb2.RobotState]:
        """What has come since the last call."""
        found = []
        try:
            while True:
                found.append(io_pb2.RobotState.FromString(self.states.recv(65535)))
        except BlockingIOError:
            return found

    def close(self) -> None:
        self.commands.close()
        self.states.close()


@pytest.fixture
def peer() -> Iterator[Peer]:
    peer = Peer()
    yield peer
    peer.close()


@pytest.fixture
def lane(robot: SimulatedRobot, peer: Peer) -> Iterator[UdpLane]:
    with UdpLane(robot.edge, control_port=0, state_port=peer.state_port) as lane:
        yield lane


def until(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + 5.0
    while not condition():
        assert time.monotonic() < end, "it did not happen within 5 s"
        time.sleep(0.002)


def command(**fields: object) -> bytes:
    return io_pb2.RobotCommand(**({"protocol_version": 1} | fields)).SerializeToString()  # type: ignore[arg-type]


def send(peer: Peer, lane: UdpLane, robot: SimulatedRobot, packet: bytes, sender: socket.socket | None = None) -> None:
    """Send a datagram and wait until the edge has judged it."""
    tally = robot.edge.tally

    def judged() -> int:
        return tally.accepted.total() + tally.dropped.total()

    before = judged()
    (sender or peer.commands).sendto(packet, ("127.0.0.1", lane.control_port))
    until(lambda: judged() == before + 1)


def test_state_goes_out_with_every_control_step(robot, peer, lane) -> None:
    robot.advance(0.2)
    frames = peer.frames()
    assert len(frames) == 40 == lane.states.sent
    assert [one.sequence for one in frames] == list(range(frames[0].sequence, frames[0].sequence + 40))
    assert {b.timestamp_us - a.timestamp_us for a, b in itertools.pairwise(frames)} == {5000}
    assert all(len(one.joint_pos) == 25 and len(one.projected_gravity) == 3 for one in frames)
    assert {one.protocol_version for one in frames} == {1}


@pytest.mark.parametrize("rate", [5, 8, 10, 25, 40, 50, 100])
def test_slower_lanes_carry_the_alerts_in_every_frame(make_robot, peer, rate: int) -> None:
    robot = make_robot()
    with UdpLane(robot.edge, control_port=0, state_port=peer.state_port, state_hz=rate):
        send_alert(robot)
        robot.advance(0.4)
        peer.frames()
        count = 0
        for _ in range(5):
            robot.advance(0.2)
            frames = peer.frames()
            count += len(frames)
            for one in frames:
                assert [alert.id for alert in one.active_alerts] == [17]
                assert one.protocol_version == 1 and len(one.joint_pos) == 25
        assert count == rate


def send_alert(robot: SimulatedRobot) -> None:
    """Heat a motor beyond the warning."""
    robot.firmware.faults.heat("L_Knee", 65.0)


def test_commands_drive_the_robot_and_get_no_answer(robot, peer, lane) -> None:
    send(peer, lane, robot, command(mode=STAND, sequence=1))
    robot.advance(0.1)
    frames = peer.frames()
    assert frames[-1].current_mode == STAND and frames[-1].last_cmd_sequence == 1
    for _ in range(4):
        robot.advance(0.15)
    send(peer, lane, robot, command(mode=MOVE, policy=io_pb2.VelocityCommand(), sequence=2))
    peer.frames()
    robot.advance(0.1)
    assert peer.frames()[-1].current_mode == MOVE
    send(peer, lane, robot, command(mode=DAMP, sequence=3))
    robot.advance(0.1)
    assert peer.frames()[-1].current_mode == DAMP
    with pytest.raises(TimeoutError):
        peer.commands.recv(100)
    assert robot.edge.control.holder.name == f"udp 127.0.0.1:{peer.commands.getsockname()[1]}"


def test_bad_datagrams_are_counted_and_change_nothing(robot, peer, lane) -> None:
    nan = float("nan")
    for packet, reason in (
        (b"\xff\xff", DropReason.MALFORMED),
        (b"", DropReason.WRONG_VERSION),
        (command(mode=STAND, protocol_version=2), DropReason.WRONG_VERSION),
        (command(mode=MOVE, policy=io_pb2.VelocityCommand(vx=nan)), DropReason.VELOCITY_NOT_FINITE),
        (command(mode=MOVE, all_trajectory=io_pb2.AllTrajectory(positions=[0] * 24)), DropReason.TRAJECTORY_LENGTH),
        (command(mode=MOVE), DropReason.UNKNOWN_MODE),
        (command(mode=STAND) + b"\x00" * 20_000, DropReason.TOO_LARGE),
        (b"\x00" * 60_000, DropReason.TOO_LARGE),
    ):
        before = robot.edge.tally.dropped[reason]
        send(peer, lane, robot, packet)
        assert robot.edge.tally.dropped[reason] == before + 1
    robot.advance(0.05)
    assert peer.frames()[-1].current_mode == DAMP
    assert robot.edge.tally.accepted.total() == 0


def test_a_defect_above_the_lane_costs_one_packet(robot, peer, lane, monkeypatch, caplog) -> None:
    with monkeypatch.context() as broken:
        broken.setattr(robot.edge, "receive", lambda packet, client: 1 / 0)
        peer.commands.sendto(command(mode=STAND), ("127.0.0.1", lane.control_port))
        until(lambda: "ZeroDivisionError" in caplog.text)
    send(peer, lane, robot, command(mode=STAND))
    assert robot.edge.tally.accepted == {"mode": 1}


def test_packets_of_the_other_dialect_are_dropped(robot, peer, lane) -> None:
    stand = cloud_pb2.CloudCommand(mode=cloud_pb2.ModeCommand(mode=cloud_pb2.MODE_STAND), sequence=1)
    send(peer, lane, robot, stand.SerializeToString())
    assert robot.edge.tally.dropped == {DropReason.WRONG_VERSION: 1}


def test_one_sender_is_in_control_and_damp_is_everybodys(robot, peer, lane) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        send(peer, lane, robot, command(mode=STAND))
        send(peer, lane, robot, command(mode=STAND), sender=other)
        assert robot.edge.tally.dropped == {DropReason.NOT_IN_CONTROL: 1}
        send(peer, lane, robot, command(mode=DAMP), sender=other)
        robot.advance(0.05)
        assert peer.frames()[-1].current_mode == DAMP
        # Control passes by silence.
        for _ in range(11):
            robot.advance(0.2)
        send(peer, lane, robot, command(mode=STAND), sender=other)
        assert robot.edge.control.holder.name.endswith(f":{other.getsockname()[1]}")


def test_senders_remembered_are_bounded(robot, peer, lane, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MAX_SENDERS", 3)
    send(peer, lane, robot, command(mode=STAND))
    holder = robot.edge.control.holder
    others = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(3)]
    for other in others[:2]:
        send(peer, lane, robot, command(mode=DAMP), sender=other)
    assert robot.edge.control.holder == holder
    send(peer, lane, robot, command(mode=DAMP), sender=others[2])
    until(lambda: robot.edge.control.holder is None)
    assert len(lane._senders) == 3
    for other in others:
        other.close()


def test_nobody_listening_is_counted_and_harmless(robot) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as reserved:
        reserved.bind(("127.0.0.1", 0))
        port = reserved.getsockname()[1]
    with UdpLane(robot.edge, control_port=0, state_port=port) as lane:
        robot.advance(1.0)
    assert lane.states.refused > 0
    assert lane.states.refused + lane.states.sent == 200


@pytest.mark.parametrize(
    ("problem", "counter"),
    [
        (BlockingIOError(errno.EAGAIN, "full"), "blocked"),
        (OSError(errno.ENETUNREACH, "no route"), "failed"),
        (OSError(errno.ENOBUFS, "no buffers"), "failed"),
    ],
)
def test_a_socket_that_cannot_send_costs_frames_only(robot, lane, problem: OSError, counter: str) -> None:
    class Stuck:
        def send(self, packet: bytes) -> int:
            raise problem

        def close(self) -> None:
            pass

    lane._state.close()
    lane._state = Stuck()
    robot.advance(0.1)
    assert getattr(lane.states, counter) == 20 and lane.states.sent == 0


def test_stop_leaves_and_frees_the_port(robot, peer) -> None:
    lane = UdpLane(robot.edge, control_port=0, state_port=peer.state_port)
    lane.start()
    port = lane.control_port
    lane.start()
    assert lane.connect_line == f"udp://127.0.0.1:{port}, state to 127.0.0.1:{peer.state_port}"
    send(peer, lane, robot, command(mode=STAND))
    assert robot.edge.control.holder is not None
    lane.stop()
    lane.stop()
    assert robot.edge.control.holder is None
    robot.advance(0.1)
    assert peer.frames() == []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as again:
        again.bind(("127.0.0.1", port))
    lane.start()
    robot.advance(0.1)
    assert len(peer.frames()) == 20
    lane.stop()


def test_what_cannot_be_opened_is_named_with_its_flag(robot, lane) -> None:
    with pytest.raises(TransportError, match=rf"port {lane.control_port} of 127\.0\.0\.1.*--udp-control-port"):
        UdpLane(robot.edge, control_port=lane.control_port).start()
    with pytest.raises(TransportError, match="--udp-control-port must be from 0 to 65535, got 65536"):
        UdpLane(robot.edge, control_port=65536)
    with pytest.raises(TransportError, match="--udp-state-port must be from 1 to 65535, got 0"):
        UdpLane(robot.edge, state_port=0)
    with pytest.raises(TransportError, match="state_hz must be a divisor of 200 from 5 to 200, got 3"):
        UdpLane(robot.edge, state_hz=3)
    with pytest.raises(TransportError, match=r"state_hz .* got 60"):
        UdpLane(robot.edge, state_hz=60)
    with pytest.raises(TransportError, match=r"--listen 192\.0\.2\.300"):
        UdpLane(robot.edge, control_port=0, listen="192.0.2.300").start()
    with pytest.raises(TransportError, match="--udp-state-host"):
        UdpLane(robot.edge, control_port=0, state_host="256.1.1.1").start()


def test_listening_beyond_loopback_is_warned_about(robot, peer, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING), UdpLane(robot.edge, 0, "127.0.0.1", peer.state_port):
        assert caplog.text == ""
    with caplog.at_level(logging.WARNING), UdpLane(robot.edge, 0, "127.0.0.1", peer.state_port, listen="0.0.0.0"):
        assert "nothing on UDP is authenticated" in caplog.text
