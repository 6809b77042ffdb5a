"""`asimov replay`."""

from __future__ import annotations

from pathlib import Path

import pytest

from asimov_gym.assets import asset_path
from asimov_gym.cli.replay import Replay
from asimov_gym.edge import SimulatedRobot, connect
from asimov_gym.recording import Recorder
from asimov_gym.rendering.backends import headless_backend, install_line

OLD = Path(__file__).parents[1] / "data" / "recording_0_1.mcap"


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("replay") / "run.mcap"
    robot = SimulatedRobot(asset_path("policies", "asimov_walk.onnx"))
    session = connect(robot, "tester")
    with Recorder(path, robot.edge):
        session.velocity(0.3)
        session.stand()
        robot.advance(1.0)
        session.velocity(0.3)
        robot.advance(0.5)
    return path


def test_it_says_what_a_recording_holds(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert Replay(recording).run() == 0
    out = capsys.readouterr().out
    assert f"{recording}: 1.5 s from 2026-01-01 00:00:00.000 UTC" in out
    assert "/commands 3, /state 15" in out
    assert "tester: 1 mode accepted, 1 velocity VELOCITY_IN_DAMP, 1 velocity accepted" in out
    assert "DAMP at 0.00 s, STAND at 0.01 s, MOVE/POLICY at 1.0" in out
    assert "largest gap 0.100 s" in out and "no frame missing" in out
    assert "policy asimov_walk.onnx, seed 0" in out
    assert "--plots DIR" in out


def test_it_lists_events_and_log_lines(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert Replay(recording, events=True).run() == 0
    out = capsys.readouterr().out
    assert "mode_change    STAND -> MOVE/POLICY" in out
    assert "WARNING" in out and "VELOCITY_IN_DAMP" in out
    assert "controller     nobody -> tester (first_command)" in out


def test_it_runs_the_recording_again(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert Replay(recording, robot=True).run() == 0
    assert "all 15 telemetry frames and all verdicts, to the bit" in capsys.readouterr().out


def test_a_run_that_must_repeat_and_does_not_is_exit_code_1(
    recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert Replay(recording, robot=True, seed=1).run() == 1
    assert "differs  joint_current" in capsys.readouterr().out


def test_it_draws_and_writes_a_motion(recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    replay = Replay(recording, plots=tmp_path / "plots", motion=tmp_path / "motion.npz", start=0.2, stop=1.0)
    assert replay.run() == 0
    assert len(list((tmp_path / "plots").glob("*.png"))) == 6
    assert f'motion="{tmp_path}/motion.npz"' in capsys.readouterr().out.replace("\n", "")
    assert (tmp_path / "motion.npz").is_file()


@pytest.mark.slow
def test_it_draws_a_video(recording: Path, tmp_path: Path) -> None:
    if headless_backend() is None:
        pytest.skip(install_line())
    assert Replay(recording, video=tmp_path / "walk.mp4").run() == 0
    assert (tmp_path / "walk.mp4").stat().st_size > 10_000


def test_a_cut_file_is_summed_up_with_one_warning(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(recording.read_bytes()[:-200])
    assert Replay(cut, motion=tmp_path / "m.npz", stop=1.0).run() == 0
    assert "cut off" in capsys.readouterr().out
    assert caplog.text.count("was cut off") == 1


def test_an_old_recording_is_read(capsys: pytest.CaptureFixture[str]) -> None:
    assert Replay(OLD, robot=True).run() == 0
    assert "does not know its policy by hash" in capsys.readouterr().out


@pytest.mark.parametrize("kind", ["missing", "folder", "text", "png"])
def test_what_is_no_recording_is_one_line_and_exit_code_2(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "file.mcap"
    if kind == "folder":
        path.mkdir()
    elif kind != "missing":
        path.write_bytes(b"# words\n" * 40 if kind == "text" else b"\x89PNG\r\n\x1a\n" + bytes(500))
    for flags in ({}, {"robot": True}, {"plots": tmp_path / "plots"}):
        assert Replay(path, **flags).run() == 2
        captured = capsys.readouterr()
        assert captured.out == "" and captured.err.count("\n") == 1 and str(path) in captured.err
    assert not (tmp_path / "plots").exists()


def test_a_part_that_is_not_there_is_exit_code_2(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert Replay(recording, motion=tmp_path / "m.npz", start=5.0).run() == 2
    assert "there is no part from 5.0" in capsys.readouterr().err
