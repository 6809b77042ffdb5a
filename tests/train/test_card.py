"""A policy's card: written from a run, its policy and an evaluation."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch", reason="the training extra is not installed: pip install 'asimov-gym[train]'")
pytest.importorskip("rsl_rl", reason="the training extra is not installed: pip install 'asimov-gym[train]'")
pytest.importorskip("tensorboard", reason="the training extra is not installed: pip install 'asimov-gym[train]'")

from asimov_gym.evaluation.runner import run_suite
from asimov_gym.evaluation.suite import parse_suite
from asimov_gym.policy import load_policy
from train.__main__ import main
from train.card import averaged_curves, joined_curves, read_curves, save_curves, write_card
from train.ppo import Trainer
from train.run_folder import RunFolder
from train.weights import with_exploration

FLAGS = ["--samples", "256", "--copies", "16", "--threads", "1", "--learner.steps", "8"]


@pytest.fixture(scope="module")
def stages(tmp_path_factory: pytest.TempPathFactory) -> list[RunFolder]:
    """Two runs, the second warm-started from the first."""
    root = tmp_path_factory.mktemp("runs")
    assert main(["ppo", "--preset", "smoke", "--runs", str(root), "--name", "first", *FLAGS]) == 0
    first = RunFolder.open(next(root.glob("*first")))
    more = ["--name", "second", "--warm-start", str(first.path)]
    assert main(["ppo", "--preset", "smoke", "--runs", str(root), *more, *FLAGS]) == 0
    return [first, RunFolder.open(next(root.glob("*second")))]


def test_a_warm_start_begins_with_the_networks_of_the_other_run(stages: list[RunFolder]) -> None:
    first, second = stages
    assert [stage["samples"] for stage in second.history()] == [256, 256]
    assert load_policy(second.path / "policy.onnx").contract.training["after"] == first.history()
    with pytest.raises(FileNotFoundError, match="is not a training run"):
        RunFolder.open(first.path / "nowhere")


def test_a_warm_start_can_explore_more_or_less_than_the_other_run_did(stages: list[RunFolder], tmp_path: Path) -> None:
    first = stages[0]
    config = first.config()
    explored = Trainer(config, first).learned()["actor_state_dict"]["distribution.log_std_param"]
    wide = replace(config, learner=replace(config.learner, warm_std=(1.7, 1.8)))
    trainer = Trainer(wide, RunFolder.create(tmp_path, "smoke", wide))
    trainer.warm_start(first)
    assert float(explored.exp().max()) < 1.6
    assert np.allclose(
        trainer.learned()["actor_state_dict"]["distribution.log_std_param"].exp().numpy(), 1.7, atol=1e-6
    )
    as_brax = {"networks": {"actor.log_std": np.log(np.array([0.2, 2.0], np.float32)), "critic": 1}, "optimiser": 2}
    bounded = with_exploration(as_brax, (1.7, 1.8))
    np.testing.assert_allclose(np.exp(bounded["networks"]["actor.log_std"]), [1.7, 1.8], rtol=1e-6)
    assert bounded["networks"]["critic"] == 1 and bounded["optimiser"] == 2
    assert with_exploration(as_brax, None) == as_brax


def test_curves_of_stages_follow_each_other(stages: list[RunFolder], tmp_path: Path) -> None:
    curves = joined_curves(stages)
    save_curves(averaged_curves(curves), tmp_path / "both.csv")
    longer = joined_curves([tmp_path / "both.csv", stages[1]])
    assert set(longer) == set(curves)
    for name, rows in longer.items():
        alone = read_curves(stages[1])[name]
        np.testing.assert_allclose(rows[-len(alone) :, 1], alone[:, 1])
        assert (np.diff(rows[:, 0]) > 0.0).all() and rows[-1, 0] > curves[name][-1, 0]
    (tmp_path / "none.csv").write_text("a,b\n1,2\n")
    with pytest.raises(ValueError, match=r"none\.csv holds no curves: its first line must be samples"):
        joined_curves([tmp_path / "none.csv"])
    samples = curves["episode/reward"][:, 0]
    assert samples[-1] == 512 and (np.diff(samples) > 0).all()


def test_curves_are_averaged_to_even_rows() -> None:
    many = np.stack([np.arange(1.0, 1001.0), np.tile([1.0, 3.0], 500)], axis=1)
    few = np.array([[1.0, 5.0], [1000.0, 7.0]])
    curves = averaged_curves({"many": many, "few": few}, points=10)
    np.testing.assert_allclose(curves["many"][:, 1], 2.0, atol=0.02)
    between = np.interp(curves["few"][:, 0], *few.T)
    np.testing.assert_allclose(curves["few"][:, 1], [5.0, *between[1:-1], 7.0])
    assert np.array_equal(curves["many"][:, 0], curves["few"][:, 0]) and len(curves["few"]) == 10


def test_card_holds_what_was_measured(stages: list[RunFolder], tmp_path: Path) -> None:
    folder = stages[-1]
    policy = load_policy(folder.path / "policy.onnx")
    walk = {"config": "standing", "walks": {"still": [0, 0, 0]}, "duration": 0.5, "repeats": 2}
    result = run_suite(policy, parse_suite({"scenarios": [walk]}, "tiny"))
    write_card(folder, policy, result, tmp_path / "p.md", "Watch the left knee.", stages[:1])
    card = (tmp_path / "p.md").read_text()
    for words in (
        "2 of 2 trials of 1 scenario run, 2 without a fall",
        f"`asimov eval policy.onnx --suite tiny` (hash `{result.suite_hash}`)",
        "| 1 | `smoke` | 256 |",
        "| 2 | `smoke` | 256 |",
        "Watch the left knee.",
        "1.5 Hz",
    ):
        assert words in card, words
    figures = json.loads((tmp_path / "p.json").read_text())
    assert figures["suite"] == "tiny" and figures["policy_hash"] == policy.sha256
    assert {bar["name"]: bar["verdict"] for bar in figures["bars"]}["standing: steps taken"] in ("met", "not measured")
    assert (tmp_path / "p.curves.png").stat().st_size > 10_000
    rows = np.loadtxt(tmp_path / "p.curves.csv", delimiter=",", skiprows=1)
    assert rows.shape[0] == 200 and np.isfinite(rows).all()
