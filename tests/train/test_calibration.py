"""Command calibration: it undoes what was measured, keeps the policy's symmetry and rest, and goes into the file."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="the training extra is not installed: pip install 'asimov-gym[train]'")
pytest.importorskip("rsl_rl", reason="the training extra is not installed: pip install 'asimov-gym[train]'")

from asimov_gym.assets import asset_path  # noqa: E402
from asimov_gym.policy import default_contract, load_policy  # noqa: E402
from asimov_gym.robot.mirror import mirror_policy  # noqa: E402
from asimov_gym.robot.observation import observation_layout  # noqa: E402
from tests.train.recipe_pair import PAIR, written  # noqa: E402
from train import calibration, session  # noqa: E402
from train.__main__ import main  # noqa: E402
from train.calibration import LARGEST, Measurement, fit, measure  # noqa: E402
from train.export import realistic_observations  # noqa: E402
from train.mean_run import average_runs  # noqa: E402
from train.policy_file import PolicyFile  # noqa: E402
from train.run_folder import RunFolder  # noqa: E402

pytestmark = pytest.mark.usefixtures("one_thread")

CONTRACT = default_contract()
LAYOUT = observation_layout("asimov-80")
COMMAND = LAYOUT.slices["command"]
MIRROR = np.array([1.0, -1.0, -1.0])
FLAGS = ["--copies", "16", "--threads", "1", "--learner.steps", "8", "--physics", "c", "--learner.hidden", "32", "16"]


def _answered(command: np.ndarray) -> np.ndarray:
    """A robot that falls short, drifts outwards in curves and sidles when it walks sideways, alike on both sides."""
    vx, vy, wz = np.asarray(command, dtype=float).T
    return np.stack([0.92 * vx - 0.02 * wz**2, vy - 0.08 * vx * wz, 0.9 * wz + 0.1 * vy], axis=1)


def _measured(count: int = 256) -> Measurement:
    rng = np.random.default_rng(0)
    low, high = np.array(CONTRACT.command_ranges).T
    command = rng.uniform(low, high, (count, 3)).astype(np.float32)
    return Measurement(command, _answered(command))


@pytest.fixture(scope="module")
def fitted(one_thread: None) -> calibration.Calibration:
    return fit(_measured(), CONTRACT, samples=7)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory, one_thread: None) -> Path:
    root = tmp_path_factory.mktemp("runs")
    assert main(["ppo", "--preset", "smoke", "--runs", str(root), "--samples", "256", *FLAGS]) == 0
    (path,) = root.iterdir()
    return path


@pytest.fixture
def tiny(run: Path, tmp_path: Path) -> Path:
    """A short run of the test's own."""
    return Path(shutil.copytree(run, tmp_path / "tiny"))


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without walking: a tiny run's policy falls."""
    monkeypatch.setattr(session, "measure", lambda infer, contract, progress: _measured())


def test_the_robot_does_what_it_is_asked_for(fitted: calibration.Calibration) -> None:
    module = fitted.module("asimov-80", CONTRACT.standing_threshold)
    low, high = 0.8 * np.array(CONTRACT.command_ranges).T  # what it can reach at all
    wanted = np.random.default_rng(1).uniform(low, high, (200, 3)).astype(np.float32)
    with torch.inference_mode():
        asked = wanted + module.correction(torch.from_numpy(wanted)).numpy()
    before, after = (np.abs(_answered(c) - wanted).mean(axis=0) for c in (wanted, asked))
    assert (after < 0.2 * before).all(), (before, after)
    # What it says of itself is measured on commands that it was not fitted to.
    assert fitted.commands == 256 and fitted.samples == 7
    assert fitted.before[0] > 0.02 and fitted.after[0] < 0.3 * fitted.before[0]
    assert fitted.after[1] < 0.3 * fitted.before[1]


def test_left_and_right_are_alike_rest_is_rest_and_changes_are_bounded(fitted: calibration.Calibration) -> None:
    module = fitted.module("asimov-80", CONTRACT.standing_threshold)
    commands = torch.from_numpy(np.random.default_rng(2).uniform(-3.0, 3.0, (100, 3)).astype(np.float32))
    mirror = torch.tensor(MIRROR, dtype=torch.float32)
    with torch.inference_mode():
        change = module.correction(commands)
        torch.testing.assert_close(module.correction(mirror * commands), mirror * change)
        assert change.abs().max() <= LARGEST
        observations = torch.from_numpy(realistic_observations(CONTRACT, 50, 0))
        changed = module(observations)
        resting = observations[:, COMMAND].norm(dim=1) == 0.0
        assert 2 <= resting.sum() <= 20
        assert torch.equal(changed[resting], observations[resting])
        others = np.setdiff1d(np.arange(LAYOUT.width), np.arange(LAYOUT.width)[COMMAND])
        assert torch.equal(changed[:, others], observations[:, others])
        assert (changed[~resting][:, COMMAND] != observations[~resting][:, COMMAND]).any(dim=1).all()


def test_the_shipped_policy_is_measured_as_it_walks() -> None:
    policy = load_policy(asset_path("policies", "asimov_walk.onnx"))
    told: list[float] = []
    first = measure(policy.infer, policy.contract, commands=8, threads=1, progress=told.append)
    again = measure(policy.infer, policy.contract, commands=8, threads=1)
    np.testing.assert_array_equal(first.velocity, again.velocity)
    assert first.command.shape == first.velocity.shape == (len(first.command), 3) and len(first.command) >= 7
    low, high = 1.1 * np.array(policy.contract.command_ranges).T
    assert (first.command >= low).all() and (first.command <= high).all()
    assert np.abs(first.velocity - first.command).max() < 0.2
    assert np.linalg.norm(first.command[:, :2], axis=1).mean() > 0.2
    assert told == sorted(told) and told[-1] == 1.0


def test_a_policy_that_falls_is_not_calibrated() -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(ValueError, match=r"must walk: with \d of \d commands the robot fell"):
        measure(lambda rows: rng.uniform(-6.0, 6.0, (len(rows), 23)).astype(np.float32), CONTRACT, commands=4)


def test_the_file_asks_its_network_for_what_the_calibration_says(
    tiny: Path, quick: None, capsys: pytest.CaptureFixture[str]
) -> None:
    bare = load_policy(tiny / "policy.onnx")
    assert main(["calibrate", str(tiny)]) == 0
    said = capsys.readouterr().out
    assert "velocity off by" in said and "commands calibrated" in said
    policy, known = load_policy(tiny / "policy.onnx"), session.calibration_of(RunFolder(tiny))
    assert known is not None
    observations = realistic_observations(policy.contract, 100, 5)
    module = known.module("asimov-80", policy.contract.standing_threshold)
    with torch.inference_mode():
        asked = module(torch.from_numpy(observations)).numpy()
    np.testing.assert_allclose(policy.infer(observations), bare.infer(asked), atol=1e-5)
    assert np.abs(policy.infer(observations) - bare.infer(observations)).max() > 1e-4
    mirrored = np.asarray(LAYOUT.mirror(observations), dtype=np.float32)
    np.testing.assert_allclose(policy.infer(mirrored), mirror_policy(policy.infer(observations)), atol=1e-5)
    assert (policy.contract.training or {})["calibration"] == known.note()
    assert "calibration" not in (bare.contract.training or {})
    # Exported again it is the same; a run that begins with it leaves the calibration behind.
    assert main(["export", str(tiny), "-o", str(tiny / "again.onnx")]) == 0
    np.testing.assert_array_equal(load_policy(tiny / "again.onnx").infer(observations), policy.infer(observations))
    weights = PolicyFile(tiny / "policy.onnx").actor(RunFolder(tiny).config())
    state = RunFolder(tiny).load_checkpoint()["learner"]["actor_state_dict"]
    np.testing.assert_array_equal(weights.layers[0][0], state["mlp.0.weight"].numpy())
    assert len(weights.layers) == 3


def test_the_compiled_step_reads_it_too(tiny: Path, quick: None) -> None:
    pytest.importorskip("onnx")
    from asimov_gym.policy.network import read_network

    assert main(["calibrate", str(tiny)]) == 0
    observations = realistic_observations(CONTRACT, 60, 1)
    read = read_network(tiny / "policy.onnx").infer(observations)
    np.testing.assert_allclose(read, load_policy(tiny / "policy.onnx").infer(observations), atol=1e-5)


def test_a_run_that_went_on_is_not_calibrated_any_more(tiny: Path, quick: None) -> None:
    assert main(["calibrate", str(tiny)]) == 0
    folder = RunFolder(tiny)
    state = folder.load_checkpoint()
    state["progress"]["samples"] += 128
    folder.save_checkpoint(state["progress"]["samples"], state, keep=1)
    assert session.calibration_of(folder) is None
    assert main(["export", str(tiny)]) == 0
    assert "calibration" not in (load_policy(tiny / "policy.onnx").contract.training or {})


def test_a_mean_of_runs_is_calibrated_and_a_recipe_calibrates_what_it_makes(
    tiny: Path, quick: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("train.recipe_run.write_run_card", lambda *arguments: 0)
    text = PAIR.replace("overrides:", "calibrated: true\naveraged_stages: 2\noverrides:", 1)
    assert main(["recipe", written(tmp_path, text), "--runs", str(tmp_path / "runs"), "--suite", "smoke"]) == 0
    mean = tmp_path / "runs" / "pair" / "mean_01_02"
    known = session.calibration_of(RunFolder(mean))
    assert known is not None and known.samples == 0
    assert (load_policy(mean / "policy.onnx").contract.training or {})["calibration"] == known.note()
    stages = [tmp_path / "runs" / "pair" / name for name in ("01_first", "02_second")]
    assert not any((stage / session.CALIBRATION_FILE).exists() for stage in stages)
    other = average_runs(stages, tmp_path, "other")
    assert session.calibration_of(other) is None


def test_saved_and_loaded_it_is_the_same(fitted: calibration.Calibration, tmp_path: Path) -> None:
    fitted.save(tmp_path / "calibration.json")
    assert calibration.Calibration.load(tmp_path / "calibration.json") == fitted
    assert replace(fitted, samples=8) != fitted


def test_the_command_says_what_is_missing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["calibrate", str(tmp_path)]) == 2
    assert "is not a training run" in capsys.readouterr().err
