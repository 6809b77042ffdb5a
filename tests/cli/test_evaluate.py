"""`asimov eval`: suites, run folders, comparisons and exit codes, with tiny suites."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml

from asimov_gym.assets import asset_path
from asimov_gym.cli import main
from asimov_gym.evaluation.results import SuiteResult
from asimov_gym.evaluation.runner import SuiteRun

POLICY = str(asset_path("policies", "asimov_walk.onnx"))


@pytest.fixture
def tiny(tmp_path: Path) -> str:
    path = tmp_path / "tiny.yaml"
    walk = {"config": "standing", "walks": {"still": [0, 0, 0]}, "duration": 1.0}
    path.write_text(yaml.safe_dump({"repeats": 1, "scenarios": [walk]}))
    return str(path)


def test_a_run_leaves_its_report(tiny: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "run"
    assert main(["eval", POLICY, "--suite", tiny, "--out", str(out), "--threads", "1"]) == 0
    said = capsys.readouterr().out
    assert "1 without a fall" in said and str(out / "report.html") in said.replace("\n", "")
    result = SuiteResult.load(out)
    assert result.complete and result.policy_name == "asimov_walk.onnx" and len(result.policy_hash) == 64
    assert result.machine["cores"] >= 1 and "packages" not in result.machine
    # A second run must not write over it; continued, there is nothing left to do.
    assert main(["eval", POLICY, "--suite", tiny, "--out", str(out)]) == 2
    assert "holds a run already" in capsys.readouterr().err
    assert main(["eval", POLICY, "--suite", tiny, "--out", str(out), "--resume"]) == 0
    assert SuiteResult.load(out).trials == result.trials


def test_a_stopped_run_says_how_to_go_on(
    tiny: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "run"

    def stop(self: SuiteRun, progress: object) -> SuiteResult:
        raise KeyboardInterrupt

    monkeypatch.setattr(SuiteRun, "execute", stop)
    assert main(["eval", POLICY, "--suite", tiny, "--out", str(out), "--repeats", "3"]) == 130
    said = capsys.readouterr().out.replace("\n", "")
    assert f"asimov eval {POLICY} --suite {tiny} --repeats 3 --out {out} --resume" in said
    assert not SuiteResult.load(out).complete
    monkeypatch.undo()
    again = ["eval", POLICY, "--suite", tiny, "--repeats", "3", "--out", str(out), "--resume"]
    assert main(again) == 0 and len(SuiteResult.load(out).trials) == 3


def test_missed_bars_fail_where_that_is_asked(tmp_path: Path) -> None:
    path = tmp_path / "push.yaml"
    knock = {"rows": ["push_standing/pelvis_front"], "repeats": 1}
    path.write_text(yaml.safe_dump({"scenarios": [knock]}))
    policy = _statue(tmp_path)
    flags = ["eval", policy, "--suite", str(path), "--out"]
    assert main([*flags, str(tmp_path / "a")]) == 0
    assert main([*flags, str(tmp_path / "b"), "--require-pass"]) == 1


def test_two_policies_side_by_side(tiny: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "both"
    assert main(["eval", "--compare", POLICY, POLICY, "--suite", tiny, "--out", str(out)]) == 0
    assert (out / "first" / "report.html").is_file() and (out / "second" / "result.json").is_file()
    data = json.loads((out / "compare.json").read_text())
    assert data["pairs"] == 1
    capsys.readouterr()
    folders = ["--compare", str(out / "first"), str(out / "second")]
    assert main(["eval", *folders, "--out", str(tmp_path / "again")]) == 0


def test_rows_of_a_file(tmp_path: Path) -> None:
    row = {
        "name": "mine",
        "duration": 0.5,
        "commands": [{"t": 0, "vx": 0.3, "vy": 0, "wz": 0}],
        "events": [],
    }
    path = tmp_path / "mine.json"
    path.write_text(json.dumps(row))
    assert main(["eval", POLICY, "--rows", str(path), "--repeats", "2", "--out", str(tmp_path / "run")]) == 0
    assert [t.scenario for t in SuiteResult.load(tmp_path / "run").trials] == ["locomotion/mine"] * 2


def test_suites_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["eval", "--suites"]) == 0
    said = capsys.readouterr().out
    for name in ("smoke", "quick", "standard", "full", "vendor"):
        assert f"{name} " in said
    assert "robot-hours and" in said and " 0 robot" not in said and " 0.0 robot" not in said


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (["--suite", "quack"], "suite 'quack' is unknown; known suites: commands, full"),
        (["--rows", "nowhere.json"], "no file of benchmark rows at nowhere.json"),
        (["nowhere.onnx", "--suite", "smoke"], "no policy file at nowhere.onnx"),
        (["--resume"], "--resume needs --out"),
        (["--repeats", "0"], r"--repeats must lie in [1, 10000], got 0"),
        (["--threads", "0"], "--threads must be at least 1, got 0"),
        ([POLICY, "--compare", "a", "b"], "--compare names both policies"),
        (["--compare", "nowhere", "nowhere2"], "no suite result at nowhere"),
    ],
)
def test_bad_input_is_said_before_anything_runs(
    flags: list[str], message: str, capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["eval", *flags]) == 2
    assert message in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def _statue(folder: Path) -> str:
    """A policy file whose network always asks for the standing pose."""
    onnx = pytest.importorskip("onnx", reason="making a policy file needs onnx: pip install 'asimov-gym[train]'")
    model = onnx.load(POLICY)
    for tensor in model.graph.initializer:
        zeros = onnx.numpy_helper.from_array(0.0 * onnx.numpy_helper.to_array(tensor), tensor.name)
        if "bias" in tensor.name or "weight" in tensor.name:
            tensor.CopyFrom(zeros)
    path = folder / "statue.onnx"
    onnx.save(model, path)
    return str(path)
