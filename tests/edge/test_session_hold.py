"""A session over a lane that forgets velocities: what is said again, and when that ends."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator

import pytest

from asimov_gym.edge.clients import velocity_hold
from asimov_gym.edge.clients.link import LinkReceiver
from asimov_gym.edge.control import Dialect
from asimov_gym.edge.session import Session
from asimov_gym.edge.wire import io_pb2

PERIOD = 0.01
SETTLE = 0.3
DAMP, STAND, MOVE = io_pb2.CONTROL_MODE_DAMP, io_pb2.CONTROL_MODE_STAND, io_pb2.CONTROL_MODE_MOVE


class Lane:
    """A link to nobody that keeps what is sent, and reports what a test says."""

    dialect = Dialect.IO
    address = "nobody"
    facts = None
    carries_events = False
    silence_hint = "Nobody is there."

    def __init__(self, velocity_expires: bool = True) -> None:
        self.velocity_expires = velocity_expires
        self.sent: list[tuple[io_pb2.RobotCommand, bool]] = []
        self.closed = 0
        self.lost = False
        self.receiver: LinkReceiver | None = None
        self._tick = 0

    def open(self, receiver: LinkReceiver) -> None:
        self.receiver = receiver
        self.report(DAMP)

    def send(self, packet: bytes, streamed: bool = False) -> None:
        if self.lost:
            raise ConnectionError("gone")
        self.sent.append((io_pb2.RobotCommand.FromString(packet), streamed))

    def close(self) -> None:
        self.closed += 1

    def report(self, mode: int, tick: int | None = None) -> None:
        self._tick = self._tick + 1 if tick is None else tick
        joints = [0.0] * 25
        assert self.receiver is not None
        self.receiver.on_state(
            io_pb2.RobotState(
                sequence=self._tick,
                timestamp_us=5000 * self._tick,
                current_mode=mode,  # type: ignore[arg-type]
                protocol_version=1,
                joint_pos=joints,
                joint_vel=joints,
                joint_current=joints,
                joint_temp=joints,
            ).SerializeToString()
        )

    @property
    def velocities(self) -> list[float]:
        return [round(command.policy.vx, 3) for command, _ in self.sent if command.HasField("policy")]

    def until(self, condition: Callable[[], bool]) -> None:
        end = time.monotonic() + 5.0
        while not condition():
            assert time.monotonic() < end, f"sent so far: {self.velocities}"
            time.sleep(0.001)

    def is_quiet(self) -> bool:
        """Whether nothing more is sent. Waits for ten periods."""
        time.sleep(2 * PERIOD)
        count = len(self.sent)
        time.sleep(10 * PERIOD)
        return len(self.sent) == count


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(velocity_hold, "PERIOD_S", PERIOD)
    monkeypatch.setattr(velocity_hold, "SETTLE_S", SETTLE)


@pytest.fixture
def lane() -> Lane:
    return Lane()


@pytest.fixture
def session(lane: Lane) -> Iterator[Session]:
    with Session(lane) as session:
        yield session


def test_velocity_is_sent_again_until_the_next_verb(lane, session) -> None:
    session.velocity(0.3)
    lane.until(lambda: len(lane.sent) >= 5)
    session.stand()
    assert lane.is_quiet()
    kinds = [command.WhichOneof("command_data") for command, _ in lane.sent]
    assert kinds[:-1] == ["policy"] * (len(kinds) - 1) and kinds[-1] is None
    assert lane.sent[-1][0].mode == STAND
    assert [command.sequence for command, _ in lane.sent] == list(range(1, len(lane.sent) + 1))
    assert set(lane.velocities) == {0.3}


def test_a_new_velocity_replaces_the_old_one_and_zero_ends_it(lane, session) -> None:
    session.velocity(0.3)
    lane.until(lambda: len(lane.sent) >= 3)
    session.velocity(-0.1)
    lane.until(lambda: lane.velocities.count(-0.1) >= 3)
    session.velocity()
    assert lane.is_quiet()
    assert sorted(lane.velocities, key=[0.3, -0.1, 0.0].index) == lane.velocities
    assert lane.velocities.count(0.0) == 1


def test_only_setpoints_are_streamed(lane, session) -> None:
    session.velocity(0.3)
    session.velocity(0.0)
    session.trajectory([0.0] * 25)
    session.stand()
    session.damp()
    assert [streamed for _, streamed in lane.sent] == [True, False, True, False, False]


@pytest.mark.parametrize("verb", ["stand", "damp", "trajectory"])
def test_every_other_verb_ends_the_hold(lane, session, verb: str) -> None:
    session.velocity(0.3)
    session.trajectory([0.0] * 25) if verb == "trajectory" else getattr(session, verb)()
    assert lane.is_quiet()
    session.close()
    assert lane.velocities.count(0.0) == 0


def test_close_sends_one_zero_for_a_held_velocity(lane) -> None:
    with Session(lane) as session:
        session.velocity(0.3)
        lane.until(lambda: len(lane.sent) >= 3)
    session.close()
    assert lane.is_quiet()
    assert lane.velocities[-1] == 0.0 and lane.velocities.count(0.0) == 1
    assert lane.closed == 1
    with pytest.raises(ConnectionError, match="closed"):
        session.stand()


def test_lanes_that_keep_a_velocity_hear_it_once_and_a_zero_at_the_end() -> None:
    lane = Lane(velocity_expires=False)
    with Session(lane) as session:
        session.velocity(0.3)
        assert lane.is_quiet()
        assert not any(thread.name == "velocity-hold" for thread in threading.enumerate())
    assert lane.velocities == [0.3, 0.0]


@pytest.mark.parametrize("mode", [DAMP, STAND])
def test_the_hold_ends_when_the_robot_does_not_walk(lane, session, mode: int) -> None:
    session.velocity(0.3)
    lane.report(mode)  # the report that was on its way: too early to mean anything
    lane.until(lambda: len(lane.sent) >= 3)
    lane.report(MOVE)
    time.sleep(SETTLE)
    lane.report(MOVE)
    assert not lane.is_quiet()
    lane.report(mode)  # somebody else's command
    assert lane.is_quiet()
    session.close()
    # A zero now would put a robot that stands back into MOVE.
    assert 0.0 not in lane.velocities


def test_the_hold_ends_when_the_firmware_restarts(lane, session) -> None:
    lane.report(MOVE, tick=5000)
    session.velocity(0.3)
    lane.until(lambda: len(lane.sent) >= 3)
    lane.report(DAMP, tick=1)
    assert lane.is_quiet()
    session.velocity(0.2)
    lane.until(lambda: lane.velocities.count(0.2) >= 2)


def test_the_hold_ends_with_one_zero_when_reports_stop(lane, session, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(velocity_hold, "SILENCE_S", 0.1)
    lane.report(MOVE)
    session.velocity(0.3)
    lane.until(lambda: 0.0 in lane.velocities)
    assert lane.is_quiet()
    assert lane.velocities.count(0.0) == 1
    assert session.state.age >= 0.1


def test_a_lane_that_breaks_ends_the_hold_and_says_why(lane, session) -> None:
    session.velocity(0.3)
    lane.lost = True
    lane.receiver.on_lost("the room has closed")
    with pytest.raises(ConnectionError, match="the room has closed"):
        session.stand()
    with pytest.raises(ConnectionError, match="the room has closed"):
        session.state.wait(1.0)
    assert session.state.get().sequence == 1
    session.close()
    assert lane.closed == 1


def test_a_silent_robot_is_no_connection() -> None:
    lane = Lane()
    lane.report = lambda mode: None  # type: ignore[method-assign]
    with pytest.raises(ConnectionError, match=r"no state from nobody within 0.05 s. Nobody is there"):
        Session(lane, timeout=0.05)
    assert lane.closed == 1


def test_a_robot_that_speaks_otherwise_is_no_connection() -> None:
    lane = Lane()
    lane.report = lambda mode: lane.receiver.on_state(b"\xff")  # type: ignore[method-assign]
    with pytest.raises(ConnectionError, match="1 packets came that are no state of this robot"):
        Session(lane, timeout=0.05)
