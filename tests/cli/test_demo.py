"""`asimov demo` end to end: the files it leaves, and an exit code that tells a walk from anything else."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from asimov_gym.assets import asset_path
from asimov_gym.cli import demo, main
from asimov_gym.cli.demo import LINEAR_BOUND, ROUTE, YAW_BOUND, Phase, PhaseResult, Walk
from asimov_gym.cli.tracking import Tracking
from asimov_gym.edge.wire import cloud_pb2
from asimov_gym.recording import COMMANDS, STATE, read_recording
from asimov_gym.rendering.backends import install_line


def motionless_policy(path: Path) -> Path:
    """A network whose every action is zero: the robot stands still whatever it is asked."""
    onnx = pytest.importorskip("onnx", reason="building a network for the test needs onnx (extra: test)")
    from asimov_gym.policy import default_contract

    contract = default_contract()
    width, joints = contract.observation.width, len(contract.joint_names)
    floats = onnx.TensorProto.FLOAT
    graph = onnx.helper.make_graph(
        [onnx.helper.make_node("MatMul", ["obs", "weights"], ["actions"])],
        "motionless",
        [onnx.helper.make_tensor_value_info("obs", floats, ["batch", width])],
        [onnx.helper.make_tensor_value_info("actions", floats, ["batch", joints])],
        [onnx.numpy_helper.from_array(np.zeros((width, joints), dtype=np.float32), "weights")],
    )
    model = onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", 20)], ir_version=10)
    onnx.helper.set_model_props(model, dict(contract.to_metadata()))
    onnx.save(model, path)
    return path


def good_walk() -> Walk:
    """A walk that follows perfectly through a five-second phase and ends in DAMP."""
    walk = Walk(Tracking(interval=0.02, window=0.7), lowest=0.6, largest_tilt=5.0, last_mode=cloud_pb2.FW_MODE_DAMP)
    for _ in range(250):
        walk.tracking.add(np.array([0.5, 0.0, 0.0]), np.array([0.5, 0.0, 0.0]))
    walk.phases.append((Phase("forward", "velocity", 5.0, (0.5, 0.0, 0.0)), 0.0, 5.0))
    return walk


def test_a_good_walk_has_no_failure() -> None:
    assert good_walk().failures() == []


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        ("lowest", 0.2, "the robot fell"),
        ("largest_tilt", 75.0, "the robot fell"),
        ("error_flags", 0x101, "0x101"),
        ("rope_force", 40.0, "gantry carried up to 40 N"),
        ("last_mode", cloud_pb2.FW_MODE_MOVE, "did not end in DAMP"),
    ],
)
def test_what_goes_wrong_is_named(field: str, value: float, words: str) -> None:
    walk = good_walk()
    setattr(walk, field, value)
    (failure,) = walk.failures()
    assert words in failure


def test_bounds_of_following() -> None:
    phase = ROUTE[2]
    assert PhaseResult(phase, 0.0, 5.0, LINEAR_BOUND, YAW_BOUND).followed
    assert not PhaseResult(phase, 0.0, 5.0, LINEAR_BOUND + 1e-3, 0.0).followed
    assert not PhaseResult(phase, 0.0, 5.0, 0.0, YAW_BOUND + 1e-3).followed


def test_missing_policy_is_exit_code_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["demo", "--policy", str(tmp_path / "none.onnx"), "--out", str(tmp_path / "demo")]) == 2
    assert "none.onnx" in capsys.readouterr().out.replace("\n", "")
    assert not (tmp_path / "demo").exists()


def test_robot_that_stands_still_fails_the_demo_but_leaves_its_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """On a machine without a renderer, too: one line says what to install, the rest is made."""
    monkeypatch.setattr(demo, "headless_backend", lambda: None)
    policy = motionless_policy(tmp_path / "motionless.onnx")
    out = tmp_path / "demo"
    out.mkdir()
    (out / "walk.mp4").write_bytes(b"of an earlier run")
    assert main(["demo", "--policy", str(policy), "--out", str(out)]) == 1
    report = capsys.readouterr().out
    assert "forward: error 0.5" in report
    assert "fell" not in report
    assert install_line() in report.replace("\n", " ")
    assert sorted(path.name for path in out.iterdir()) == ["recording.mcap", "velocity.png"]

    entries = list(read_recording(out / "recording.mcap"))
    commands = [entry for entry in entries if entry.topic == COMMANDS]
    assert len(commands) == len(ROUTE)
    frames = [entry for entry in entries if entry.topic == STATE]
    assert len(frames) == pytest.approx(10 * sum(phase.seconds for phase in ROUTE), abs=2)


def test_shipped_policy_walks_the_demo(tmp_path: Path) -> None:
    try:
        asset_path("policies", "asimov_walk.onnx")
    except FileNotFoundError as error:
        pytest.skip(f"no policy is shipped yet: {error}")
    out = tmp_path / "demo"
    assert main(["demo", "--out", str(out), "--no-video"]) == 0
    assert (out / "velocity.png").stat().st_size > 10_000
