"""A run that begins with a policy file: the actor is the file's, and a new critic learns before it moves."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="the training extra is not installed: pip install 'asimov-gym[train]'")
pytest.importorskip("rsl_rl", reason="the training extra is not installed: pip install 'asimov-gym[train]'")

from asimov_gym.assets import asset_path  # noqa: E402
from asimov_gym.policy import load_policy  # noqa: E402
from asimov_gym.policy.runner import PolicyFileError  # noqa: E402
from asimov_gym.robot.observation import observation_layout  # noqa: E402
from tests.train.jax_settings import quick_to_compile, why_absent  # noqa: E402
from train.__main__ import main  # noqa: E402
from train.config import NEW_CRITIC_ROUNDS, LearnerConfig, PpoConfig, load_preset  # noqa: E402
from train.export import realistic_observations  # noqa: E402
from train.learner import load_actor, set_learning_rate  # noqa: E402
from train.loop import CAUTIOUS_RATE  # noqa: E402
from train.policy_file import PolicyFile  # noqa: E402
from train.ppo import Trainer  # noqa: E402
from train.run_folder import RunFolder  # noqa: E402

pytestmark = pytest.mark.usefixtures("one_thread")

COPIES, STEPS, HELD = 16, 8, 2
LEARNER = LearnerConfig(steps=STEPS, hidden=(32, 16), critic_rounds=HELD, warm_std=(0.1, 0.2))
CONFIG = PpoConfig(library="rsl_rl", physics="c", copies=COPIES, samples=999_999, threads=1, learner=LEARNER)
FLAGS = ["--copies", str(COPIES), "--threads", "1", "--learner.steps", str(STEPS), "--physics", "c"]
FLAGS += ["--learner.hidden", "32", "16"]


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory, one_thread: None) -> Path:
    """What a short run exported."""
    root = tmp_path_factory.mktemp("first")
    assert main(["ppo", "--preset", "smoke", "--runs", str(root), "--samples", "512", *FLAGS]) == 0
    (run,) = root.iterdir()
    return run / "policy.onnx"


def _weights(module: Any) -> dict[str, np.ndarray]:
    return {name: value.detach().numpy().copy() for name, value in module.named_parameters()}


def _begun(file: Path, root: Path, name: str) -> Trainer:
    trainer = Trainer(CONFIG, RunFolder.create(root, name, CONFIG, parent=PolicyFile(file)))
    trainer.begin_with(PolicyFile(file).actor(CONFIG))
    return trainer


def test_the_shipped_policy_is_read_as_it_answers() -> None:
    path = asset_path("policies", "asimov_walk.onnx")
    config = load_preset("finish")
    weights = PolicyFile(path).actor(config)
    layout = observation_layout(config.walk.layout)
    actor = load_actor(config.learner, layout, weights.to_torch()).as_onnx(verbose=False)
    observations = realistic_observations(load_policy(path).contract, 300, 3)
    # At rest, where its calibration, which stays behind, changes nothing.
    for name in ("command", "clock"):
        observations[:, layout.slices[name]] = 0.0
    with torch.inference_mode():
        answered = actor(torch.from_numpy(observations)).numpy()
    np.testing.assert_allclose(answered, load_policy(path).infer(observations), rtol=1e-4, atol=1e-4)
    assert weights.samples == sum(stage["samples"] for stage in PolicyFile(path).history()) > 1e8
    assert weights.log_std is not None and config.learner.warm_std is not None
    np.testing.assert_allclose(np.exp(weights.log_std), config.learner.warm_std[1], rtol=1e-5)


def test_the_critic_learns_before_the_actor_does(file: Path, tmp_path: Path) -> None:
    trainer = _begun(file, tmp_path, "held")
    actor, critic = _weights(trainer.ppo.actor), _weights(trainer.ppo.critic)
    losses = [trainer.iterate()["loss/value"] for _ in range(HELD)]
    for name, value in _weights(trainer.ppo.actor).items():
        np.testing.assert_array_equal(value, actor[name], err_msg=name)
    assert all((value != critic[name]).any() for name, value in _weights(trainer.ppo.critic).items())
    assert all(np.isfinite(losses))
    assert trainer.ppo.learning_rate == CONFIG.learner.learning_rate
    before = trainer.progress.iteration
    figures = trainer.iterate()
    assert before == HELD and all((v != actor[name]).any() for name, v in _weights(trainer.ppo.actor).items())
    steps = CONFIG.learner.epochs * CONFIG.learner.minibatches
    assert figures["policy/learning_rate"] <= CAUTIOUS_RATE * 1.5**steps
    moved = max(np.abs(v - actor[name]).max() for name, v in _weights(trainer.ppo.actor).items())
    assert moved < 0.1, "the first update of the actor is a small one"


def test_a_critic_can_learn_at_its_own_rate(file: Path, tmp_path: Path) -> None:
    """The actor's rate adapts, the critic's stays; a run that continues one without goes on, with a new optimiser."""
    own = replace(CONFIG, learner=replace(LEARNER, critic_rounds=0, critic_rate=3e-3))
    trainer = Trainer(own, RunFolder.create(tmp_path, "own", own, parent=PolicyFile(file)))
    trainer.begin_with(PolicyFile(file).actor(own))
    set_learning_rate(trainer.ppo, 0.0)
    trainer.ppo.desired_kl = 1e9  # it stays there
    actor, critic = _weights(trainer.ppo.actor), _weights(trainer.ppo.critic)
    trainer.iterate()
    for name, value in _weights(trainer.ppo.actor).items():
        np.testing.assert_array_equal(value, actor[name], err_msg=name)
    assert all((value != critic[name]).any() for name, value in _weights(trainer.ppo.critic).items())
    assert [group["lr"] for group in trainer.ppo.optimizer.param_groups] == [0.0, 3e-3]
    assert not trainer.ppo.use_clipped_value_loss
    trainer.save()
    again = Trainer(own, trainer.folder)
    again.resume()
    assert [group["lr"] for group in again.ppo.optimizer.param_groups] == [0.0, 3e-3]
    shared = Trainer(CONFIG, RunFolder(tmp_path / "shared"))
    shared.warm_start(trainer.folder)
    assert len(shared.ppo.optimizer.param_groups) == 1 and not shared.ppo.optimizer.state
    for name, value in _weights(trainer.ppo.critic).items():
        np.testing.assert_array_equal(_weights(shared.ppo.critic)[name], value, err_msg=name)
    with pytest.raises(ValueError, match=r"learner\.critic_rate must lie in \[1e-06, 1\], got 2"):
        LearnerConfig(critic_rate=2.0)


def test_a_run_that_is_resumed_goes_on_holding_the_actor(file: Path, tmp_path: Path) -> None:
    whole = _begun(file, tmp_path, "whole")
    for _ in range(HELD + 1):
        whole.iterate()
    parts = _begun(file, tmp_path, "parts")
    for _ in range(HELD + 1):  # a new process for each round
        parts.iterate()
        parts.save()
        parts, folder = Trainer(CONFIG, parts.folder), parts.folder
        parts.resume()
        assert parts.folder is folder
    for name, value in _weights(whole.ppo.actor).items():
        np.testing.assert_array_equal(_weights(parts.ppo.actor)[name], value, err_msg=name)
    assert whole.ppo.learning_rate == parts.ppo.learning_rate


def test_the_command_begins_with_a_file_and_keeps_its_history(
    file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flags = ["--preset", "smoke", "--runs", str(tmp_path), "--samples", "256", "--warm-start", str(file), *FLAGS]
    assert main(["ppo", *flags]) == 0
    assert f"for {NEW_CRITIC_ROUNDS} rounds only the critic learns" in capsys.readouterr().out
    (run,) = tmp_path.iterdir()
    assert RunFolder.open(run).config().learner.critic_rounds == NEW_CRITIC_ROUNDS
    first, second = load_policy(file), load_policy(run / "policy.onnx")
    observations = realistic_observations(first.contract, 50, 1)
    # It was held to the end; the normaliser has seen two more rounds.
    np.testing.assert_allclose(second.infer(observations), first.infer(observations), atol=0.3)
    assert [stage["samples"] for stage in (second.contract.training or {})["after"]] == [512]
    assert [stage["samples"] for stage in PolicyFile(run / "policy.onnx").history()] == [512, 256]


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"learner": replace(LEARNER, hidden=(32, 32))}, r"hidden layers are \(32, 16\) there, and learner.hidden is"),
        ({"learner": replace(LEARNER, symmetry="none")}, "learner.symmetry none answers otherwise than the file"),
        ({"walk": replace(CONFIG.walk, layout="asimov-78")}, "walk.layout is asimov-80 there and asimov-78 in"),
        ({"walk": replace(CONFIG.walk, action_scale=0.5)}, r"walk.action_scale is \{0.25\} there and \{0.5\} in"),
    ],
)
def test_a_file_of_another_kind_is_refused(file: Path, changed: dict[str, object], said: str) -> None:
    with pytest.raises(PolicyFileError, match=said):
        PolicyFile(file).actor(replace(CONFIG, **changed))  # type: ignore[arg-type]


def test_a_network_that_was_not_made_here_is_refused(tmp_path: Path) -> None:
    from asimov_gym.policy import default_contract
    from train.export import export_onnx

    export_onnx(torch.nn.Linear(80, 23), default_contract(), tmp_path / "bare.onnx", samples=10)
    file = PolicyFile(tmp_path / "bare.onnx")
    assert file.history() == []
    with pytest.raises(PolicyFileError, match="is not a normaliser and layers"):
        file.actor(CONFIG)


def test_the_command_says_what_is_wrong(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = tmp_path / "policy.onnx"
    text.write_text("no policy")
    assert main(["ppo", "--preset", "smoke", "--runs", str(tmp_path / "runs"), "--warm-start", str(text)]) == 2
    assert "policy.onnx" in capsys.readouterr().err
    assert not (tmp_path / "runs").exists()
    assert main(["ppo", "--preset", "smoke", "--warm-start", str(tmp_path / "none.onnx")]) == 2
    assert "none.onnx" in capsys.readouterr().err
    with pytest.raises(ValueError, match=r"learner\.critic_rounds must be at least 0, got -1"):
        LearnerConfig(critic_rounds=-1)


@pytest.mark.skipif(why_absent() is not None, reason=str(why_absent()))
def test_brax_holds_the_actor_as_well(file: Path, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    settings = quick_to_compile(tmp_path_factory.mktemp("cache"))
    next(settings)
    from train.brax_ppo import BraxTrainer

    config = replace(CONFIG, library="brax")
    trainer = BraxTrainer(config, RunFolder(tmp_path))
    actor = PolicyFile(file).actor(config)
    trainer.begin_with(actor)
    critic = trainer.learned()["networks"]["critic.hidden_0.kernel"].copy()
    for _ in range(HELD):
        assert np.isfinite(trainer.iterate()["loss/value"])
    now = trainer.actor_weights()
    for (kernel, bias), (matrix, shift) in zip(now.layers, actor.layers, strict=True):
        np.testing.assert_array_equal(kernel, matrix)
        np.testing.assert_array_equal(bias, shift)
    assert (trainer.learned()["networks"]["critic.hidden_0.kernel"] != critic).any()
    figures = trainer.iterate()
    assert (trainer.actor_weights().layers[0][0] != actor.layers[0][0]).any()
    assert figures["policy/learning_rate"] <= CAUTIOUS_RATE * 1.5 ** (
        config.learner.epochs * config.learner.minibatches
    )
    next(settings, None)
