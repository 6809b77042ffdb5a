"""The mean of successive runs as a run of its own."""

from __future__ import annotations

import json
import shutil
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="the training extra is not installed: pip install 'asimov-gym[train]'")
pytest.importorskip("rsl_rl", reason="the training extra is not installed: pip install 'asimov-gym[train]'")

from asimov_gym.evaluation.runner import run_suite  # noqa: E402
from asimov_gym.evaluation.suite import parse_suite  # noqa: E402
from asimov_gym.policy import load_policy  # noqa: E402
from asimov_gym.robot.observation import observation_layout  # noqa: E402
from tests.train.jax_settings import quick_to_compile, why_absent  # noqa: E402
from train.__main__ import main  # noqa: E402
from train.card import write_card  # noqa: E402
from train.learner import load_actor  # noqa: E402
from train.mean_run import average_runs, exported_actor  # noqa: E402
from train.ppo import Trainer  # noqa: E402
from train.run_folder import RunFolder  # noqa: E402
from train.weights import NetworkWeights  # noqa: E402

pytestmark = pytest.mark.usefixtures("one_thread")

FLAGS = ["--samples", "256", "--copies", "16", "--threads", "1", "--learner.steps", "8", "--physics", "c"]
FLAGS += ["--learner.hidden", "32", "16"]


def chain(root: Path, *flags: str) -> list[RunFolder]:
    """Three runs, each warm-started from the one before; the second exports a mean over its rounds."""
    runs: list[RunFolder] = []
    for name in ("first", "second", "third"):
        more = ["--warm-start", str(runs[-1].path)] if runs else []
        more += ["--learner.averaged-rounds", "2"] if name == "second" else []
        assert main(["ppo", "--preset", "smoke", "--runs", str(root), "--name", name, *FLAGS, *flags, *more]) == 0
        runs.append(RunFolder.open(next(root.glob(f"*_{name}"))))
    return runs


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> list[RunFolder]:
    return chain(tmp_path_factory.mktemp("runs"))


@pytest.fixture(scope="module")
def mean(runs: list[RunFolder], tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    """Of the last two runs."""
    root = tmp_path_factory.mktemp("means")
    assert main(["average", str(runs[1].path), str(runs[2].path), "--runs", str(root), "--name", "both"]) == 0
    return RunFolder.open(next(root.glob("*_both")))


def matrices(weights: NetworkWeights) -> list[np.ndarray]:
    return [*(array for layer in weights.layers for array in layer), weights.mean, weights.variance]


def test_it_exports_the_mean_of_what_the_runs_export(runs: list[RunFolder], mean: RunFolder) -> None:
    second, third = (exported_actor(run) for run in runs[1:])
    for ours, a, b in zip(matrices(exported_actor(mean)), matrices(second), matrices(third), strict=True):
        np.testing.assert_allclose(ours, 0.5 * (a + b), rtol=1e-6, atol=1e-7)
    assert any(np.abs(a - b).max() > 1e-4 for a, b in zip(matrices(second), matrices(third), strict=True))
    raw = NetworkWeights.from_torch(runs[1].load_checkpoint()["learner"]["actor_state_dict"])
    assert np.abs(raw.layers[0][0] - second.layers[0][0]).max() > 0.0, "the second run exports a mean itself"
    config, layout = mean.config(), observation_layout("asimov-80")
    actor = load_actor(config.learner, layout, exported_actor(mean).to_torch())
    seen = np.random.default_rng(0).uniform(-1.0, 1.0, (20, 80)).astype(np.float32)
    with torch.no_grad():
        expected = actor.as_onnx(verbose=False)(torch.from_numpy(seen)).numpy()
    np.testing.assert_allclose(load_policy(mean.path / "policy.onnx").infer(seen), expected, atol=1e-5)


def test_file_and_card_say_what_it_is_made_of(runs: list[RunFolder], mean: RunFolder, tmp_path: Path) -> None:
    policy = load_policy(mean.path / "policy.onnx")
    training = policy.contract.training
    assert training is not None and training["mean_of"] == [2, 3] and training["after"] == runs[2].history()
    walk = {"config": "standing", "walks": {"still": [0, 0, 0]}, "duration": 0.5, "repeats": 1}
    result = run_suite(policy, parse_suite({"scenarios": [walk]}, "tiny"))
    write_card(mean, policy, result, tmp_path / "p.md", earlier=runs)
    card = (tmp_path / "p.md").read_text()
    assert "| 3 | `smoke` | 256 |" in card and "| 4 | the mean of stages 2, 3 | – | – | " in card
    rows = np.loadtxt(tmp_path / "p.curves.csv", delimiter=",", skiprows=1)
    assert rows[-1, 0] <= 768 < rows[-1, 0] + 10  # the three runs one behind the other


def test_a_warm_start_begins_with_the_mean(mean: RunFolder, runs: list[RunFolder], tmp_path: Path) -> None:
    config = mean.config()
    trainer = Trainer(config, RunFolder.create(tmp_path, "smoke", config, parent=mean))
    trainer.warm_start(mean)
    for ours, theirs in zip(matrices(trainer.actor_weights()), matrices(exported_actor(mean)), strict=True):
        np.testing.assert_array_equal(ours, theirs)
    critic = runs[2].load_checkpoint()["learner"]["critic_state_dict"]
    assert all(torch.equal(value, critic[name]) for name, value in trainer.learned()["critic_state_dict"].items())
    assert trainer.folder.origin()["after"][-1]["mean_of"] == [2, 3]
    trainer.close()


def test_runs_in_between_may_be_left_out(runs: list[RunFolder], tmp_path: Path) -> None:
    folder = average_runs([runs[0].path, runs[2].path], tmp_path, "ends")
    assert folder.origin()["mean_of"] == [1, 3]
    for ours, a, b in zip(*(matrices(exported_actor(run)) for run in (folder, runs[0], runs[2])), strict=True):
        np.testing.assert_allclose(ours, 0.5 * (a + b), rtol=1e-6, atol=1e-7)


def test_it_cannot_be_resumed(mean: RunFolder, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["resume", str(mean.path)]) == 2
    assert f"is a mean of runs: begin a new run with --warm-start {mean.path}" in capsys.readouterr().err


def test_runs_that_do_not_follow_each_other_are_refused(
    runs: list[RunFolder], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first, second, third = (str(run.path) for run in runs)
    for wrong in ([third, second], [second, first], [first, first]):
        assert main(["average", *wrong, "--runs", str(tmp_path)]) == 2
        words = capsys.readouterr().err
        assert (
            f"{wrong[1]} does not come from the networks that {wrong[0]} ends with" in words and "oldest first" in words
        )
    assert main(["average", first, "--runs", str(tmp_path)]) == 2
    assert "runs must be two or more to have a mean, got 1" in capsys.readouterr().err
    assert main(["average", first, str(tmp_path / "nowhere"), "--runs", str(tmp_path)]) == 2
    assert "nowhere is not a training run" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == [], "nothing was begun"


@pytest.mark.slow
@pytest.mark.skipif(why_absent() is not None, reason=str(why_absent()))
def test_of_brax_networks(tmp_path: Path) -> None:
    with contextmanager(quick_to_compile)(tmp_path / "cache"):
        runs = chain(tmp_path, "--learner", "brax")
        folder = average_runs([run.path for run in runs[1:]], tmp_path, "mean")
        assert main(["export", str(folder.path)]) == 0
    second, third = (exported_actor(run) for run in runs[1:])
    for ours, a, b in zip(matrices(exported_actor(folder)), matrices(second), matrices(third), strict=True):
        np.testing.assert_allclose(ours, 0.5 * (a + b), rtol=1e-6, atol=1e-7)


def test_a_recipe_ends_with_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[Any, ...]] = []
    monkeypatch.setattr("train.recipe_run.write_run_card", lambda *arguments: asked.append(arguments) or 0)
    recipe = tmp_path / "three.yaml"
    stage = "  - {name: %s, preset: smoke, samples: 256}\n"
    recipe.write_text(
        "about: Three tiny stages.\naveraged_stages: 2\n"
        "overrides: {library: rsl_rl, physics: c, copies: 16, threads: 1, learner: {steps: 8, hidden: [32, 16]}}\n"
        "stages:\n" + "".join(stage % name for name in ("one", "two", "three"))
    )
    command = ["recipe", str(recipe), "--runs", str(tmp_path / "runs"), "--suite", "smoke"]
    assert main(command) == 0
    folder = tmp_path / "runs" / "three"
    mean, earlier = folder / "mean_02_03", [folder / name for name in ("01_one", "02_two", "03_three")]
    assert asked == [(mean, mean / "policy.onnx", None, "smoke", earlier)]
    assert json.loads((mean / "origin.json").read_text())["mean_of"] == [2, 3]
    before = (mean / "policy.onnx").read_bytes()
    assert main(command) == 0 and (mean / "policy.onnx").read_bytes() == before
    shutil.rmtree(mean / "checkpoints")  # as if it was killed before it was whole
    assert main(command) == 0 and len(asked) == 3
    assert load_policy(mean / "policy.onnx").contract.training == load_policy_of(before, tmp_path).contract.training


def load_policy_of(content: bytes, folder: Path) -> Any:
    path = folder / "before.onnx"
    path.write_bytes(content)
    return load_policy(path)
