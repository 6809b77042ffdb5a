from __future__ import annotations

import asyncio
import math
import threading

import numpy as np
import pytest

from asimov_gym.edge import SimulatedRobot, aconnect, connect
from asimov_gym.edge.wire import cloud_pb2
from asimov_gym.firmware import State, StepClock, WallClock
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
    assert codes.count("mode_change") == 3
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

    def slow_step() -> None:
        gate.wait(0.02)
        step()

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
