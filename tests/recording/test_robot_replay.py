"""Running a recording again in a fresh robot."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import pytest

from asimov_gym.edge import Client, Code, SimulatedRobot, Source, connect
from asimov_gym.edge.wire import cloud_pb2
from asimov_gym.firmware import FirmwareConfig, WallClock
from asimov_gym.policy import default_contract
from asimov_gym.recording import Recorder
from asimov_gym.recording.robot_replay import replay_robot
from tests.recording.rehearsal import messages


def test_a_lockstep_recording_repeats_to_the_bit(recording: Path) -> None:
    replay = replay_robot(recording)
    assert replay.identical and replay.left_out == ()
    assert (replay.commands, replay.frames, replay.seconds) == (5, 32, pytest.approx(3.2))
    assert replay.equal_until == pytest.approx(3.2)


def test_another_seed_shows_in_the_currents_alone(recording: Path) -> None:
    replay = replay_robot(recording, seed=6)
    assert not replay.identical and replay.equal_until == 0.0
    assert [difference.field for difference in replay.differences if difference.at is not None] == ["joint_current"]
    (current,) = (difference for difference in replay.differences if difference.field == "joint_current")
    assert 0.05 < current.largest < 1.0, "the noise of the sensors, 0.1 A"


def test_restart_e_stop_and_leaving_are_repeated(tmp_path: Path) -> None:
    """Also with settings of its own, over two lanes, and a stale command of a stream."""
    robot = SimulatedRobot(config=replace(FirmwareConfig(), stand_ramp_s=0.7, ankle="exact"), gantry="hold", seed=9)
    remote = Client(Source.LIVEKIT, "remote")

    def stand(sequence: int) -> bytes:
        mode = cloud_pb2.ModeCommand(mode=cloud_pb2.MODE_STAND)
        return cloud_pb2.CloudCommand(sequence=sequence, mode=mode).SerializeToString()

    with Recorder(tmp_path / "run.mcap", robot.edge):
        robot.edge.receive(stand(5), remote, streamed=True)
        robot.advance(0.3)
        robot.edge.receive(stand(4), remote, streamed=True)
        robot.advance(0.4)
        robot.edge.e_stop(True)
        robot.advance(0.2)
        with connect(robot, "local") as session:
            session.stand()
            robot.advance(0.1)
            robot.edge.e_stop(False)
            session.stand()
            robot.advance(0.4)
        robot.restart()
        robot.edge.receive(stand(6), remote)
        robot.advance(0.5)
    verdicts = [command.verdict for command in messages(tmp_path / "run.mcap", "/commands")]
    assert verdicts == ["accepted", "STALE", "accepted", "accepted", "accepted"]
    replay = replay_robot(tmp_path / "run.mcap")
    assert replay.identical and replay.left_out == ()
    assert replay.frames == 19


def test_what_the_bench_operator_did_is_named_and_not_repeated(tmp_path: Path) -> None:
    robot = SimulatedRobot()
    with Recorder(tmp_path / "push.mcap", robot.edge), connect(robot, "tester") as session:
        session.stand()
        robot.advance(2.5)
        robot.edge.error(Code.CONSOLE, "push 60 N")
        robot.firmware.faults.push((60.0, 0.0, 0.0), 0.2)
        robot.advance(0.5)
    replay = replay_robot(tmp_path / "push.mcap")
    assert not replay.identical
    assert replay.left_out == ("at 2.500 s console: push 60 N",)
    assert replay.equal_until == pytest.approx(2.5)
    largest = {difference.field: difference.largest for difference in replay.differences}
    assert largest["joint_pos"] > 1e-3


def test_a_real_time_recording_repeats_roughly(tmp_path: Path) -> None:
    robot = SimulatedRobot(clock=WallClock())
    session = connect(robot, "tester")
    with Recorder(tmp_path / "live.mcap", robot.edge), robot:
        time.sleep(0.2)
        session.stand()
        time.sleep(0.9)
    replay = replay_robot(tmp_path / "live.mcap")
    assert any("in real time" in line for line in replay.left_out)
    assert replay.commands == 1 and replay.changed_verdicts == 0 and replay.frames >= 8
    largest = {difference.field: difference.largest for difference in replay.differences}
    assert 0.0 < largest["joint_pos"] < 0.05


def test_the_old_recording_runs_again(old_recording: Path) -> None:
    """Its robot was that of an earlier version: what counts is that its commands mean the same."""
    replay = replay_robot(old_recording)
    assert replay.changed_verdicts == 0 and replay.unmatched == 0
    assert (replay.commands, replay.frames) == (6, 20)
    assert any("does not know its policy by hash" in line for line in replay.left_out)
    largest = {difference.field: difference.largest for difference in replay.differences}
    assert largest["fw_mode"] == 0.0
    assert replay.equal_until >= 0.3


def test_a_recording_that_begins_later_than_its_robot_is_refused(tmp_path: Path) -> None:
    robot = SimulatedRobot()
    robot.advance(0.5)
    with Recorder(tmp_path / "late.mcap", robot.edge):
        robot.advance(0.5)
    with pytest.raises(ValueError, match="begins later than its robot"):
        replay_robot(tmp_path / "late.mcap")


def test_the_policy_must_be_the_recorded_one(recording: Path, tmp_path: Path) -> None:
    onnx = pytest.importorskip("onnx", reason="changing a policy file needs onnx (extra: test)")
    from asimov_gym.assets import asset_path

    model = onnx.load(asset_path("policies", "asimov_walk.onnx"))
    model.doc_string = "another file"
    onnx.save(model, tmp_path / "other.onnx")
    with pytest.raises(ValueError, match=r"made with policy asimov_walk\.onnx \(SHA-256 [0-9a-f]{12}.*--policy"):
        replay_robot(recording, tmp_path / "other.onnx")


def test_a_stand_in_policy_is_handed_over(tmp_path: Path) -> None:
    import numpy as np

    class Still:
        contract = default_contract()

        def infer(self, observation: np.ndarray) -> np.ndarray:
            return np.zeros((len(observation), 23), dtype=np.float32)

    robot = SimulatedRobot(Still())
    with Recorder(tmp_path / "still.mcap", robot.edge), connect(robot, "tester") as session:
        session.stand()
        robot.advance(0.5)
        session.velocity()
        robot.advance(0.5)
    assert replay_robot(tmp_path / "still.mcap", Still()).identical
