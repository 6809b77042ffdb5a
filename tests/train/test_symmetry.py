"""Symmetric networks are symmetric exactly, also once exported, and the exploration treats both sides alike."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="the training extra is not installed: pip install 'asimov-gym[train]'")
pytest.importorskip("rsl_rl", reason="the training extra is not installed: pip install 'asimov-gym[train]'")

from tensordict import TensorDict  # noqa: E402

from asimov_gym.policy import default_contract, load_policy  # noqa: E402
from asimov_gym.policy.network import read_network  # noqa: E402
from asimov_gym.robot.mirror import mirror_policy  # noqa: E402
from asimov_gym.robot.observation import observation_layout  # noqa: E402
from asimov_gym.tasks.walk import WalkConfig  # noqa: E402
from train.config import LearnerConfig, PpoConfig  # noqa: E402
from train.export import export_onnx  # noqa: E402
from train.learner import load_actor  # noqa: E402
from train.ppo import Trainer  # noqa: E402
from train.run_folder import RunFolder  # noqa: E402

LAYOUT = observation_layout("asimov-80")


@pytest.fixture(scope="module")
def trainer(tmp_path_factory: pytest.TempPathFactory) -> Trainer:
    """A trainer whose networks have learned a little, so that nothing is symmetric by being zero."""
    learner = LearnerConfig(steps=8, hidden=(32, 16), learning_rate=3e-3)
    config = PpoConfig(copies=32, samples=10_000, threads=1, learner=learner)
    trainer = Trainer(config, RunFolder.create(tmp_path_factory.mktemp("runs"), "symmetric", config))
    for _ in range(3):
        trainer.iterate()
    return trainer


def _answer(model: Any, group: str, rows: np.ndarray) -> np.ndarray:
    views = TensorDict({group: torch.from_numpy(rows.astype(np.float32))}, batch_size=[len(rows)])
    with torch.no_grad():
        return model(views).numpy()


def test_actor_answers_the_mirrored_view_with_the_mirrored_action(trainer: Trainer) -> None:
    rows = np.random.default_rng(0).standard_normal((20, LAYOUT.width))
    actor = trainer.ppo.get_policy()
    action = _answer(actor, "actor", rows)
    assert np.abs(action).max() > 1e-3
    np.testing.assert_allclose(_answer(actor, "actor", LAYOUT.mirror(rows)), mirror_policy(action), atol=1e-6)


def test_critic_values_the_mirrored_view_the_same(trainer: Trainer) -> None:
    mirror = trainer.batch.task.privileged_mirror
    rows = np.random.default_rng(1).standard_normal((20, mirror.size))
    value = _answer(trainer.ppo.critic, "critic", rows)
    assert np.ptp(value) > 1e-3
    np.testing.assert_allclose(_answer(trainer.ppo.critic, "critic", mirror(rows)), value, atol=1e-6)


def test_exploration_is_the_same_on_both_sides(trainer: Trainer) -> None:
    std = trainer.ppo.get_policy().output_std.detach().numpy()
    std = std[0] if std.ndim == 2 else std
    np.testing.assert_allclose(std[mirror_policy.indices], std)
    assert np.ptp(std) > 0.0


def test_exported_network_is_symmetric_and_loads_from_a_checkpoint(trainer: Trainer, tmp_path: Path) -> None:
    trainer.save()
    weights = trainer.folder.load_checkpoint()["learner"]["actor_state_dict"]
    actor = load_actor(trainer.config.learner, LAYOUT, weights)
    report = export_onnx(actor, default_contract(), tmp_path / "policy.onnx")
    assert report.difference < 1e-5
    policy = load_policy(tmp_path / "policy.onnx")
    rows = np.random.default_rng(2).standard_normal((20, LAYOUT.width)).astype(np.float32)
    np.testing.assert_allclose(policy.infer(LAYOUT.mirror(rows)), mirror_policy(policy.infer(rows)), atol=1e-5)
    np.testing.assert_allclose(policy.infer(rows), _answer(trainer.ppo.get_policy(), "actor", rows), atol=1e-5)


def _walking(rows: np.ndarray) -> np.ndarray:
    """The rows with clocks that run."""
    phase = np.linspace(0.0, 6.0, len(rows))
    rows[:, LAYOUT.slices["clock"]] = np.stack([np.cos(phase), np.sin(phase)], axis=-1)
    return rows


def _at_rest(rows: np.ndarray) -> np.ndarray:
    rows[:, LAYOUT.slices["clock"]] = 0.0
    return rows


def test_a_handed_robot_has_a_stronger_side_while_it_stands_and_only_then(tmp_path: Path) -> None:
    learner = LearnerConfig(steps=8, hidden=(32, 16), learning_rate=3e-3, symmetry="handed")
    config = PpoConfig(copies=32, samples=10_000, threads=1, learner=learner)
    trainer = Trainer(config, RunFolder.create(tmp_path, "handed", config))
    for _ in range(3):
        trainer.iterate()
    trainer.save()
    weights = trainer.folder.load_checkpoint()["learner"]["actor_state_dict"]
    path = tmp_path / "policy.onnx"
    assert export_onnx(load_actor(learner, LAYOUT, weights), default_contract(), path).difference < 1e-5
    rng = np.random.default_rng(3)
    walking, resting = (make(rng.standard_normal((20, LAYOUT.width))) for make in (_walking, _at_rest))
    for act in (partial(_answer, trainer.ppo.get_policy(), "actor"), load_policy(path).infer, read_network(path).infer):
        straight, mirrored = act(walking.astype(np.float32)), act(LAYOUT.mirror(walking).astype(np.float32))
        np.testing.assert_allclose(mirrored, mirror_policy(straight), atol=1e-5)
        straight, mirrored = act(resting.astype(np.float32)), act(LAYOUT.mirror(resting).astype(np.float32))
        assert np.abs(mirrored - mirror_policy(straight)).max() > 1e-3
    view = trainer.batch.task.privileged_mirror
    for make, equal in ((_walking, True), (_at_rest, False)):
        rows = make(rng.standard_normal((20, view.size)))
        values = (_answer(trainer.ppo.critic, "critic", r) for r in (rows, view(rows)))
        assert np.allclose(*values, atol=1e-6) is equal


def test_a_policy_that_stands_symmetrically_can_go_on_handed(trainer: Trainer, tmp_path: Path) -> None:
    trainer.save()
    learner = replace(trainer.config.learner, symmetry="handed")
    config = replace(trainer.config, learner=learner)
    after = Trainer(config, RunFolder.create(tmp_path, "after", config))
    after.warm_start(trainer.folder)
    rows = _walking(np.random.default_rng(4).standard_normal((20, LAYOUT.width)))
    before = _answer(trainer.ppo.get_policy(), "actor", rows)
    np.testing.assert_allclose(_answer(after.ppo.get_policy(), "actor", rows), before, atol=1e-6)


def test_a_hand_needs_a_clock() -> None:
    with pytest.raises(ValueError, match=r"learner\.symmetry handed needs a layout with a clock.*'asimov-78'"):
        PpoConfig(walk=WalkConfig(layout="asimov-78"), learner=LearnerConfig(symmetry="handed"))


@pytest.mark.parametrize("symmetry", ["samples", "none"])
def test_the_other_settings_train_and_export_too(symmetry: str, tmp_path: Path) -> None:
    config = PpoConfig(
        copies=16, samples=256, threads=1, learner=LearnerConfig(steps=8, hidden=(16,), symmetry=symmetry)
    )
    trainer = Trainer(config, RunFolder.create(tmp_path, symmetry, config))
    trainer.iterate()
    trainer.save()
    weights = trainer.folder.load_checkpoint()["learner"]["actor_state_dict"]
    report = export_onnx(load_actor(config.learner, LAYOUT, weights), default_contract(), tmp_path / "policy.onnx")
    assert report.difference < 1e-5


def test_unknown_symmetry_is_refused() -> None:
    with pytest.raises(ValueError, match=r"learner\.symmetry must be network, handed, samples or none, got 'mirror'"):
        LearnerConfig(symmetry="mirror")
