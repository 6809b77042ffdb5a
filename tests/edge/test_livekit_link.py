"""A client's session in a room, against the robot's lane, with a stand-in for the client library between them."""

from __future__ import annotations

import asyncio
import logging
import threading
import time
from collections.abc import Callable, Iterator

import pytest

from asimov_gym.edge import Dialect, Session, SimulatedRobot, connect
from asimov_gym.edge.clients import livekit as module
from asimov_gym.edge.clients import livekit_session
from asimov_gym.edge.clients.livekit import LiveKitLink
from asimov_gym.edge.facts import facts
from asimov_gym.edge.transports import livekit, livekit_visit
from asimov_gym.edge.transports.livekit import LiveKitLane
from asimov_gym.edge.wire import cloud_pb2
from asimov_gym.firmware import State
from asimov_gym.robot.joints import STAND_POSITION
from tests.livekit_standin import Room, StandInServer

URL = "ws://room:7880"


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> StandInServer:
    server = StandInServer()
    server.install(monkeypatch)
    for place, name, value in (
        (livekit, "FIRST_WAIT_S", 0.01),
        (livekit_visit, "SETTLE_S", 0.01),
        (livekit_visit, "LINGER_S", 0.0),
        (livekit_session, "RECONNECT_SETTLE_S", 0.01),
        (livekit_session, "SETTLE_S", 0.02),
        (livekit_session, "LINGER_S", 0.0),
    ):
        monkeypatch.setattr(place, name, value)
    return server


class Running:
    """Advances a lockstep robot in a thread, as long as the test lasts."""

    def __init__(self, robot: SimulatedRobot) -> None:
        self._robot = robot
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        while not self._stop.wait(0.002):
            self._robot.advance(0.02)

    def stop(self) -> None:
        self._stop.set()
        self._thread.join()


@pytest.fixture
def running(robot: SimulatedRobot) -> Iterator[SimulatedRobot]:
    running = Running(robot)
    yield robot
    running.stop()


@pytest.fixture
def serve(running: SimulatedRobot, server: StandInServer) -> Iterator[Callable[..., LiveKitLane]]:
    lanes: list[LiveKitLane] = []

    def start(*dialects: Dialect, identity: str = "robot") -> LiveKitLane:
        lanes.append(LiveKitLane(running.edge, URL, identity, dialects or (Dialect.CLOUD,)))
        lanes[-1].start()
        return lanes[-1]

    yield start
    for lane in lanes:
        lane.stop()


def until(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + 5.0
    while not condition():
        assert time.monotonic() < end, "it did not happen within 5 s"
        time.sleep(0.002)


def drive(robot: SimulatedRobot, session: Session) -> None:
    session.stand()
    until(lambda: session.state.get().fw_mode == cloud_pb2.FW_MODE_STAND)
    now = robot.clock.now_us()
    until(lambda: robot.clock.now_us() - now > 700_000)
    session.velocity(0.2)
    until(lambda: robot.firmware.state is State.POLICY)
    until(lambda: session.state.get().fw_mode == cloud_pb2.FW_MODE_MOVE)
    session.trajectory(STAND_POSITION)
    until(lambda: robot.edge.tally.accepted["trajectory"] == 1)
    session.damp()
    until(lambda: session.state.get().fw_mode == cloud_pb2.FW_MODE_DAMP)


def modes(session: Session) -> list[str]:
    return [event.error.message for event in session.events() if event.error.code == "mode_change"]


def test_all_verbs_in_dialect_cloud(running, serve) -> None:
    serve()
    with connect(URL, token="client") as session:
        assert session.dialect is Dialect.CLOUD
        assert session.facts == facts()
        drive(running, session)
        said: list[str] = []
        until(lambda: bool(said.extend(modes(session)) or said[-1:] == ["MOVE/TRAJECTORY -> DAMP"]))
        assert said[:2] == ["DAMP -> STAND", "STAND -> MOVE/POLICY"]
        assert session.state.get().timestamp_us > 0
    until(lambda: running.edge.control.holder is None)


def test_all_verbs_in_dialect_io_with_setpoints_on_a_track(running, server, serve) -> None:
    serve(Dialect.IO)
    with connect(URL, token="client") as session:
        assert session.dialect is Dialect.IO
        assert session.facts == facts()
        drive(running, session)
        assert session.state.get().timestamp_us == pytest.approx(running.clock.realtime_us(), abs=2_000_000)
        tracks = [track.name for track in server.members["client"].tracks]
        assert tracks == ["commands"]
        assert list(session.events()) == []


def test_setpoints_go_as_packets_where_the_robot_reads_no_track(running, server, serve) -> None:
    serve(Dialect.IO)
    server.members["robot"].local_participant.attributes.clear()
    with connect(URL, token="client") as session:
        drive(running, session)
        assert server.members["client"].tracks == []


def test_with_both_dialects_cloud_is_spoken_unless_io_is_asked_for(running, serve) -> None:
    serve(Dialect.IO, Dialect.CLOUD)
    with connect(URL, token="one") as session:
        assert session.dialect is Dialect.CLOUD
        drive(running, session)
    with connect(URL, token="two", dialect=Dialect.IO) as session:
        assert session.dialect is Dialect.IO
        session.stand()
        until(lambda: session.state.get().fw_mode == cloud_pb2.FW_MODE_STAND)


def test_a_damp_just_before_close_arrives(running, serve) -> None:
    serve()
    with connect(URL, token="client") as session:
        session.stand()
        until(lambda: session.state.get().fw_mode == cloud_pb2.FW_MODE_STAND)
        session.damp()
    until(lambda: running.firmware.state is State.DAMP)
    with pytest.raises(ConnectionError, match="closed"):
        session.stand()
    session.close()
    assert not any(thread.name == "livekit-link" for thread in threading.enumerate())


def test_a_room_without_a_robot_says_so(running, server, serve) -> None:
    with pytest.raises(ConnectionError, match=r"no robot in the room 'robot-sim' at ws://room:7880: .*'telemetry'"):
        connect(URL, token="client", timeout=0.05)
    serve(Dialect.CLOUD)
    with pytest.raises(ConnectionError, match=r"'state' \(dialect io\) was not published within 0.05 s"):
        connect(URL, token="client", dialect=Dialect.IO, timeout=0.05)
    assert list(server.members) == ["robot"]
    assert not any(thread.name == "livekit-link" for thread in threading.enumerate())


def test_an_unreachable_server_is_one_line_without_the_token(server, caplog) -> None:
    secret = "eyJhbGciOiJIUzI1NiJ9.eyJzdWIiOiJyb2JvdCJ9.c2VjcmV0"
    server.down = f"401 Unauthorized {secret}"
    with caplog.at_level(logging.DEBUG), pytest.raises(ConnectionError, match="refuses the token") as raised:
        connect(URL, token=secret)
    link = LiveKitLink(URL, secret)
    for text in (str(raised.value), caplog.text, repr(link), repr(vars(link))):
        assert secret not in text and "\n" not in str(raised.value)


def test_wrong_addresses_are_refused() -> None:
    with pytest.raises(ValueError, match="token is needed"):
        connect(URL)
    with pytest.raises(ValueError, match="token is given by itself"):
        connect("ws://room?access_token=x", token="client")


def test_a_watcher_reads_and_cannot_command(running, server, serve) -> None:
    serve()
    server.watchers.add("client")
    with connect(URL, token="client") as session:
        assert session.facts is None
        session.state.wait()
        with pytest.raises(ConnectionError, match="no canPublishData"):
            session.damp()


def test_an_interrupted_connection_takes_no_commands_and_then_does_again(running, server, serve) -> None:
    serve(Dialect.IO)
    with connect(URL, token="client") as session:
        drive(running, session)
        server.interrupt()
        until(lambda: refused(session))
        server.mend()
        until(lambda: not refused(session))
        session.state.wait(5.0)
        session.stand()
        until(lambda: session.state.get().fw_mode == cloud_pb2.FW_MODE_STAND)


def refused(session: Session) -> bool:
    try:
        session.damp()
    except ConnectionError as problem:
        assert "interrupted" in str(problem)
        return True
    return False


def test_a_client_that_is_sent_away_hears_why(running, server, serve) -> None:
    serve()
    with connect(URL, token="client") as session:
        server.drop(server.members["client"], 2)
        with pytest.raises(ConnectionError, match="is lost: duplicate identity"):
            while True:
                session.state.wait(5.0)
        with pytest.raises(ConnectionError, match="is lost: duplicate identity"):
            session.damp()


def test_a_robot_that_comes_back_is_taken_up_again(running, server, serve) -> None:
    lane = serve()
    with connect(URL, token="client") as session:
        lane.stop()
        time.sleep(0.02)
        serve()
        before = session.state.get().sequence
        until(lambda: session.state.get().sequence > before)
        drive(running, session)


def test_a_named_robot_is_not_mistaken_for_another(running, server, serve) -> None:
    serve()

    async def pose() -> None:
        impostor = Room(server)
        await impostor.connect("", "impostor", None)
        await impostor.local_participant.publish_data_track(name="telemetry")
        link = LiveKitLink(URL, "client", robot="impostor", timeout=1.0)
        session = await asyncio.to_thread(Session, link, 0.05)
        session.close()

    with pytest.raises(ConnectionError, match="reports nothing"):
        asyncio.run(pose())
    session = Session(LiveKitLink(URL, "client", robot="robot"))
    try:
        drive(running, session)
    finally:
        session.close()
    with pytest.raises(ConnectionError, match="no robot 'nobody'"):
        Session(LiveKitLink(URL, "client", robot="nobody", timeout=0.05))


def test_commands_that_the_room_does_not_take_are_refused_in_the_end(running, server, serve, monkeypatch) -> None:
    serve()
    for place in (module, livekit_session):
        monkeypatch.setattr(place, "COMMANDS_WAITING", 5)
    with connect(URL, token="client") as session:
        stuck = asyncio.Event()
        server.members["client"].local_participant.publish_data = lambda *_, **__: stuck.wait()
        with pytest.raises(ConnectionError, match="takes no commands: 5 are waiting"):
            for _ in range(10):
                session.damp()
        monkeypatch.setattr(module, "CLOSE_TIMEOUT_S", 0.2)
        began = time.monotonic()
    assert time.monotonic() - began < 2.0
    assert not any(thread.name == "livekit-link" for thread in threading.enumerate())
