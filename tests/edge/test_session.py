from __future__ import annotations

import asyncio
import math
import threading

import numpy as np
import pytest

from asimov_gym.edge import Client, SimulatedRobot, aconnect, connect
from asimov_gym.edge.control import Dialect
from asimov_gym.edge.decode import decode, parse
from asimov_gym.edge.facts import facts
from asimov_gym.edge.listener import EdgeListener
from asimov_gym.edge.verdict import Verdict
from asimov_gym.edge.wire import cloud_pb2
from asimov_gym.firmware import State, StepClock, Trajectory, WallClock
from asimov_gym.robot import ankle
from asimov_gym.robot.joints import STAND_POSITION


def test_verbs_drive_the_robot_through_all_modes(robot, session) -> None:
    reports = []
    for verb in (
        session.stand,
        lambda: session.velocity(0.3),
        lambda: session.trajectory(STAND_POSITION),
        session.damp,
    ):
        verb()
        robot.advance(0.1)
        reports.append(session.state.get().fw_mode)
    assert reports == [cloud_pb2.FW_MODE_STAND, cloud_pb2.FW_MODE_MOVE, cloud_pb2.FW_MODE_MOVE, cloud_pb2.FW_MODE_DAMP]


def test_sequence_numbers_count_up(session) -> None:
    assert [session.stand(), session.damp(), session.stand()] == [1, 2, 3]


def test_verbs_check_their_arguments(robot, session) -> None:
    with pytest.raises(ValueError, match="vy must be a finite number, got nan"):
        session.velocity(0.1, math.nan)
    with pytest.raises(ValueError, match="positions must hold 25 values"):
        session.trajectory([0.0] * 24)
    with pytest.raises(ValueError, match=r"kp\[3\] must be a finite number"):
        session.trajectory(np.zeros(25), kp=[1.0, 1.0, 1.0, math.inf] + [1.0] * 21)
    assert robot.edge.tally.dropped == {}


def test_closed_session_sends_nothing(robot) -> None:
    session = connect(robot)
    session.close()
    with pytest.raises(ConnectionError):
        session.stand()
    robot.advance(0.2)
    assert session.state.get().sequence == 1


def test_wire_format_page_connects_and_reads_the_state(robot) -> None:
    """The two calls that the published wire-format page names: `connect()` and `session.state.get()`."""
    session = connect(robot)
    robot.advance(0.3)
    state = session.state.get()
    assert state.sequence == 4
    assert state.fw_mode == cloud_pb2.FW_MODE_DAMP
    for name in ("joint_pos", "joint_vel", "joint_current", "joint_temp"):
        assert len(getattr(state, name)) == 25
    assert (len(state.imu_quat), len(state.imu_gyro), len(state.imu_gravity)) == (4, 3, 3)
    state.joint_pos[0] = 9.0  # the caller's own copy
    assert session.state.get().joint_pos[0] != 9.0
    session.close()


def test_leaving_stops_the_walk_and_stays_in_move(robot) -> None:
    with connect(robot) as session:
        session.stand()
        robot.advance(0.6)
        session.velocity(0.3, 0.1, -0.2)
        robot.advance(0.1)
        assert robot.firmware.snapshot.velocity.tolist() == pytest.approx([0.3, 0.1, -0.2])
    robot.advance(0.1)
    assert robot.firmware.snapshot.velocity.tolist() == [0.0, 0.0, 0.0]
    assert robot.firmware.state is State.POLICY
    assert robot.edge.control.holder is None


def test_facts_show_the_simulator(session) -> None:
    assert session.facts == facts()


def test_arguments_that_belong_elsewhere_are_refused(robot) -> None:
    for arguments, complaint in (
        ({"token": "x"}, "token does not belong to a robot in this process"),
        ({"state_port": 1}, "state_port does not belong"),
    ):
        with pytest.raises(ValueError, match=complaint):
            connect(robot, **arguments)
    with pytest.raises(ValueError, match="name does not belong to udp://"):
        connect("udp://127.0.0.1", "me")
    with pytest.raises(ValueError, match="dialect must be io on udp://"):
        connect("udp://127.0.0.1", dialect=Dialect.CLOUD)
    with pytest.raises(ValueError, match="token is needed"):
        connect("ws://127.0.0.1:7880")
    for target in ("127.0.0.1:8850", "http://127.0.0.1", "udp://", "udp://host/path", "udp://host:99999", "room"):
        with pytest.raises(ValueError, match="target"):
            connect(target)


# -- the other dialect, by the same verbs ----------------------------------------------------------


class Packets(EdgeListener):
    """Commands as they arrive."""

    def __init__(self) -> None:
        self.taken: list[tuple[Client, bytes, Verdict]] = []

    def on_command(self, received_us: int, client: Client, packet: bytes, verdict: Verdict) -> None:
        self.taken.append((client, packet, verdict))


def test_verbs_work_in_the_other_dialect(robot) -> None:
    with connect(robot, dialect=Dialect.IO) as session:
        session.stand()
        robot.advance(0.6)
        reports = [session.state.get().fw_mode]
        for verb in (lambda: session.velocity(0.3), lambda: session.trajectory(STAND_POSITION), session.damp):
            verb()
            robot.advance(0.1)
            reports.append(session.state.get().fw_mode)
        assert session.state.get().applied_cmd.seq == 4
        assert [event.error.code for event in session.events()].count("mode_change") == 4
    assert reports == [cloud_pb2.FW_MODE_STAND, cloud_pb2.FW_MODE_MOVE, cloud_pb2.FW_MODE_MOVE, cloud_pb2.FW_MODE_DAMP]
    assert robot.edge.tally.dropped == {}


def test_both_dialects_report_the_same_robot(robot) -> None:
    with connect(robot, "a") as cloud, connect(robot, "b", dialect=Dialect.IO) as io:
        cloud.stand()
        # A pose in which no two joints agree, so that an exchange of any two would show.
        cloud.trajectory(np.asarray(STAND_POSITION) + np.linspace(-0.08, 0.08, 25))
        robot.advance(0.1)
        mine, theirs = cloud.state.get(), io.state.get()
        assert mine.fw_timestamp_us == theirs.fw_timestamp_us
        for name in ("joint_pos", "joint_vel", "joint_current", "joint_temp", "imu_quat", "imu_gyro", "imu_gravity"):
            assert list(getattr(mine, name)) == list(getattr(theirs, name)), name
        assert mine.fw_mode == theirs.fw_mode == cloud_pb2.FW_MODE_MOVE
        assert mine.timestamp_us == theirs.timestamp_us
        for _ in range(3):
            robot.firmware.faults.heat("R_Hip_Yaw", 85.0)
            robot.advance(0.1)
        mine, theirs = cloud.state.get(), io.state.get()
        assert mine.error_flags == theirs.error_flags == 0x9
        assert mine.fw_mode == theirs.fw_mode == cloud_pb2.FW_MODE_DAMP
        assert mine.alert_count == theirs.alert_count > 0
        assert list(mine.active_alerts) == list(theirs.active_alerts)


def test_the_same_joint_targets_in_both_dialects(robot) -> None:
    packets = Packets()
    robot.edge.attach(packets)
    random = np.random.default_rng(4)
    with connect(robot, "a") as cloud, connect(robot, "b", dialect=Dialect.IO) as io:
        for _ in range(20):
            pose = np.asarray(STAND_POSITION) + random.uniform(-0.04, 0.04, 25)
            motors = ankle.to_motor_position(pose)
            kp, kd = random.uniform(1.0, 200.0, 25), random.uniform(0.1, 4.0, 25)
            for session in (cloud, io):
                session.trajectory(motors, kp, kd)
    commands = [
        decode(parse(packet, client.dialects), robot.firmware.linkage, client, 0).command
        for client, packet, _ in packets.taken
    ]
    assert len(commands) == 40
    for mine, theirs in zip(commands[::2], commands[1::2], strict=True):
        assert isinstance(mine, Trajectory) and isinstance(theirs, Trajectory)
        np.testing.assert_allclose(mine.position, theirs.position, atol=1e-6)
        np.testing.assert_allclose(mine.kp, theirs.kp, rtol=1e-5)
        np.testing.assert_allclose(mine.kd, theirs.kd, rtol=1e-5)


def test_a_lone_gain_is_refused_where_the_robot_would_ignore_it(robot) -> None:
    with connect(robot, dialect=Dialect.IO) as session:
        with pytest.raises(ValueError, match=r"kp without kd: .* give both, or leave both out"):
            session.trajectory(STAND_POSITION, kp=np.ones(25))
        with pytest.raises(ValueError, match="kd without kp"):
            session.trajectory(STAND_POSITION, kd=np.ones(25))
        assert session.stand() == 1


def test_a_session_notices_a_restart_in_either_dialect(robot) -> None:
    with connect(robot) as cloud, connect(robot, dialect=Dialect.IO) as io:
        for _ in range(4):
            robot.advance(0.5)
        robot.restart()
        robot.advance(0.3)
        for session in (cloud, io):
            assert session.state.get().fw_timestamp_us <= 300_000
            assert [kind.name for kind, count in session.state.arrivals.items() if count] == ["NEWER", "RESTART"]


def test_waiting_in_lockstep_says_what_to_do(session) -> None:
    with pytest.raises(TimeoutError, match="started, or advanced"):
        session.state.wait(timeout=0.01)


def test_another_thread_can_wait_while_the_robot_advances(robot, session) -> None:
    found: list[cloud_pb2.EdgeTelemetry] = []
    waiter = threading.Thread(target=lambda: found.append(session.state.wait(timeout=5.0)))
    waiter.start()
    while waiter.is_alive():
        robot.advance(0.1)
    assert found[0].sequence > 1


def test_lockstep_refuses_fractions_of_a_step(robot) -> None:
    with pytest.raises(ValueError, match=r"multiple >= 0 of the control step, 0.005 s; got 0.0072"):
        robot.advance(0.0072)
    with pytest.raises(RuntimeError, match="lockstep"):
        robot.start()


def test_missing_policy_file_is_named() -> None:
    with pytest.raises(FileNotFoundError, match=r"no_such_policy\.onnx"):
        SimulatedRobot("no_such_policy.onnx")


def test_async_session(robot) -> None:
    async def drive() -> list[str]:
        async with aconnect(robot, "async") as session:
            await session.stand()
            robot.advance(0.1)
            assert (await session.state.get()).fw_mode == cloud_pb2.FW_MODE_STAND
            await session.velocity(0.2)
            await session.trajectory(STAND_POSITION)
            robot.advance(0.1)
            await session.damp()
            robot.advance(0.1)
            return [event.error.code async for event in session.events(timeout=0.02)]

    codes = asyncio.run(drive())
    assert codes.count("mode_change") == 4  # the velocity's, too, which lasted no control step
    assert robot.edge.control.holder is None


# -- real time -------------------------------------------------------------------------------------


def test_wall_clock_robot_runs_by_itself(make_robot) -> None:
    with make_robot(clock=WallClock()) as robot, connect(robot) as session:
        first = session.state.wait(2.0)
        session.stand()
        later = [session.state.wait(2.0) for _ in range(4)][-1]
        assert later.fw_mode == cloud_pb2.FW_MODE_STAND
        assert later.sequence == first.sequence + 4
        assert 300_000 <= later.fw_timestamp_us - first.fw_timestamp_us <= 600_000
        assert robot.running
        with pytest.raises(RuntimeError, match="real time"):
            robot.advance(0.1)
    assert not robot.running


def test_trajectory_times_out_in_wall_clock_time(make_robot) -> None:
    with make_robot(clock=WallClock()) as robot, connect(robot) as session:
        session.trajectory(STAND_POSITION)
        for _ in range(4):
            sample = session.state.wait(2.0)
        assert sample.fw_mode == cloud_pb2.FW_MODE_DAMP


def test_overload_is_reported(make_robot, monkeypatch: pytest.MonkeyPatch) -> None:
    robot = make_robot(clock=WallClock())
    step, gate = robot._step, threading.Event()

    def slow_step() -> int:
        gate.wait(0.02)
        return step()

    monkeypatch.setattr(robot, "_step", slow_step)
    with connect(robot) as session:
        robot.start()
        found = None
        while found is None or found.error.code != "overload":
            found = session.system.next(timeout=5.0)
            assert found is not None
        robot.stop()
    assert 0.0 < robot.realtime_factor < 0.5
    assert found.error.message.endswith("times real time")


def test_dead_loop_is_reported_by_stop(make_robot, monkeypatch: pytest.MonkeyPatch) -> None:
    robot = make_robot(clock=WallClock())
    monkeypatch.setattr(robot, "_step", lambda: 1 / 0)
    robot.start()
    robot._thread.join()
    with pytest.raises(RuntimeError, match="died") as caught:
        robot.stop()
    assert isinstance(caught.value.__cause__, ZeroDivisionError)


def test_step_clock_is_the_default(robot) -> None:
    assert isinstance(robot.clock, StepClock)
    assert robot.firmware.state is State.DAMP
