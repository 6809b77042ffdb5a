"""The exported policy as the mean of the weights of the last rounds."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="the training extra is not installed: pip install 'asimov-gym[train]'")
pytest.importorskip("rsl_rl", reason="the training extra is not installed: pip install 'asimov-gym[train]'")

from asimov_gym.policy import load_policy  # noqa: E402
from asimov_gym.robot.observation import observation_layout  # noqa: E402
from tests.train.jax_settings import quick_to_compile, why_absent  # noqa: E402
from train.__main__ import main  # noqa: E402
from train.averaging import WeightAverage, averaged  # noqa: E402
from train.config import LearnerConfig  # noqa: E402
from train.learner import load_actor  # noqa: E402
from train.run_folder import RunFolder  # noqa: E402
from train.weights import NetworkWeights  # noqa: E402

ROUNDS, KEPT = 6, 3
FLAGS = ["--copies", "8", "--threads", "1", "--learner.steps", "8", "--learner.hidden", "32", "16", "--physics", "c"]
FLAGS += ["--samples", str(ROUNDS * 64), "--checkpoint-s", "1e-6", "--keep-checkpoints", "9"]
FLAGS += ["--learner.averaged-rounds", str(KEPT)]
LAYOUT = observation_layout("asimov-80")


def _constant(value: float) -> NetworkWeights:
    """Weights that are the same number everywhere."""
    array = np.full(2, value, dtype=np.float32)
    return NetworkWeights(((array[None], array[:1]),), array, array, int(value), array)


def _numbers(weights: NetworkWeights) -> np.ndarray:
    assert weights.log_std is not None
    flat = [array.ravel() for layer in weights.layers for array in layer]
    return np.concatenate([*flat, weights.mean, weights.variance, weights.log_std])


def test_it_is_the_plain_mean_at_first_and_forgets_later() -> None:
    average = WeightAverage(3)
    means = []
    for value in (1.0, 2.0, 3.0, 10.0):
        average.add(_constant(value))
        assert average.weights is not None
        numbers = _numbers(average.weights)
        assert np.ptp(numbers) == 0.0
        means.append(float(numbers[0]))
    assert means == pytest.approx([1.0, 1.5, 2.0, 2.0 + 8.0 / 3.0])
    assert average.weights is not None and average.weights.samples == 10


def test_one_round_is_that_round() -> None:
    average = WeightAverage(1)
    for value in (1.0, 5.0):
        average.add(_constant(value))
    assert average.weights is not None and (_numbers(average.weights) == 5.0).all()


def test_no_rounds_at_all_are_refused() -> None:
    with pytest.raises(ValueError, match=r"learner\.averaged_rounds must be at least 1, got 0"):
        LearnerConfig(averaged_rounds=0)


def _expected(run: RunFolder, library: str) -> np.ndarray:
    """The mean of the weights in the checkpoints of all rounds, worked out by itself."""
    mean = np.zeros(0)
    paths = run.checkpoints()
    assert len(paths) == ROUNDS
    for number, path in enumerate(paths, start=1):
        learned = torch.load(path, weights_only=False)["learner"]
        brax = library == "brax"
        weights = NetworkWeights.from_brax(learned, "actor") if brax else None
        weights = weights or NetworkWeights.from_torch(learned["actor_state_dict"])
        share = 1.0 / min(number, KEPT)
        mean = share * _numbers(weights) + (1.0 - share) * (mean if number > 1 else 0.0)
    return mean


@pytest.mark.parametrize("library", ["rsl_rl", "brax"])
def test_a_run_exports_the_mean_and_goes_on_with_it(library: str, tmp_path: Path) -> None:
    settings = iter(())
    if library == "brax":
        if (absent := why_absent()) is not None:
            pytest.skip(absent)
        settings = quick_to_compile(tmp_path / "cache")
        next(settings)
    assert main(["ppo", "--preset", "smoke", "--learner", library, "--runs", str(tmp_path / "a"), *FLAGS]) == 0
    (path,) = (tmp_path / "a").iterdir()
    run = RunFolder.open(path)
    mean = averaged(run.load_checkpoint()["average"])
    assert mean is not None
    np.testing.assert_allclose(_numbers(mean), _expected(run, library), rtol=1e-4, atol=1e-6)

    rows = np.random.default_rng(0).standard_normal((50, LAYOUT.width)).astype(np.float32)
    actor = load_actor(run.config().learner, LAYOUT, mean.to_torch())
    answer = load_policy(path / "policy.onnx").infer(rows)
    with torch.no_grad():
        wanted = actor._symmetric()(torch.from_numpy(rows)).numpy()
    np.testing.assert_allclose(answer, wanted, atol=1e-5)

    parts = RunFolder(shutil.copytree(path, tmp_path / "parts"))
    for late in parts.checkpoints()[ROUNDS // 2 :]:
        late.unlink()
    assert main(["resume", str(parts.path)]) == 0
    again = averaged(parts.load_checkpoint()["average"])
    assert again is not None
    np.testing.assert_array_equal(_numbers(again), _numbers(mean))
    next(settings, None)


def test_without_averaging_nothing_is_kept_and_older_checkpoints_still_load(tmp_path: Path) -> None:
    flags = [*FLAGS[:-2], "--learner", "rsl_rl"]
    assert main(["ppo", "--preset", "smoke", "--runs", str(tmp_path), *flags]) == 0
    (path,) = tmp_path.iterdir()
    run = RunFolder.open(path)
    newest = run.checkpoints()[-1]
    state = run.load_checkpoint()
    assert state["average"] is None
    del state["average"]  # as written before there was one
    torch.save(state, newest)
    assert main(["export", str(path), "--output", str(tmp_path / "again.onnx")]) == 0
    rows = np.random.default_rng(0).standard_normal((5, LAYOUT.width)).astype(np.float32)
    first, second = load_policy(path / "policy.onnx"), load_policy(tmp_path / "again.onnx")
    np.testing.assert_array_equal(first.infer(rows), second.infer(rows))
