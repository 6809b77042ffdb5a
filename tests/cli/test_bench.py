"""`asimov bench robot`: that it measures what it says. The figures themselves are the machine's."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from asimov_gym.assets import asset_path
from asimov_gym.cli import bench_robot, main
from asimov_gym.cli.bench_robot import BenchRobot
from asimov_gym.policy import PolicyRunner, load_policy


@pytest.fixture(scope="module")
def policy() -> PolicyRunner:
    return load_policy(asset_path("policies", "asimov_walk.onnx"))


@pytest.mark.parametrize("around", [False, True], ids=["bare", "with lane and recorder"])
def test_lockstep_is_measured_walking_on_one_core(policy: PolicyRunner, around: bool) -> None:
    cores = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else None
    result = BenchRobot(seconds=1.0, udp=around, record=around).lockstep(policy)
    assert result.walking and result.seconds == pytest.approx(1.0)
    assert result.speed * result.step_us == pytest.approx(5000.0)  # a step is 5 ms: two views of one measurement
    assert 0.0 < result.cpu_us < 1.1 * result.step_us
    assert result.pinned == (cores is not None)
    if cores is not None:
        assert os.sched_getaffinity(0) == cores  # and let go again


def test_real_time_is_measured_against_the_wall_clock(policy: PolicyRunner, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench_robot, "STANDING", 1.0)
    monkeypatch.setattr(bench_robot, "WARM_UP", 0.1)
    result = BenchRobot(seconds=1.0).real_time(policy)
    assert result.walking
    assert 1.0 <= result.seconds < 2.0
    assert result.factor == pytest.approx(result.steps * 0.005 / result.seconds)
    assert 0.0 <= result.p50_ms <= result.p99_ms <= result.max_ms
    assert 0.0 <= result.late_share <= 1.0


def test_a_robot_that_does_not_walk_gives_no_figures(
    policy: PolicyRunner, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(bench_robot, "STANDING", 0.1)
    monkeypatch.setattr(bench_robot, "WARM_UP", 0.1)
    monkeypatch.setattr(bench_robot, "_walks", lambda robot: False)
    assert main(["bench", "robot", "--seconds", "1"]) == 1
    assert "do not count" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("flags", "words"),
    [(["--seconds", "0"], "--seconds must be between 1 and 3600"), (["--policy", "no/such.onnx"], "no/such.onnx")],
)
def test_bad_flags_are_one_line_and_2(flags: list[str], words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "robot", *flags]) == 2
    error = capsys.readouterr().err
    assert words in error and error.count("\n") == 1


def test_bench_alone_lists_its_subjects(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(["bench"])
    assert end.value.code == 2
    assert "robot" in capsys.readouterr().err


@pytest.mark.slow
def test_the_whole_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "bench.json"
    assert main(["bench", "robot", "--seconds", "3", "--udp", "--record", "--json", str(file)]) == 0
    out = capsys.readouterr().out
    assert "lateness p99" in out and "UDP lane and recorder" in out
    figures = json.loads(file.read_text(encoding="utf-8"))
    assert figures["lockstep"]["walking"] and figures["real_time"]["steps"] > 0
