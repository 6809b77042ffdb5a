"""The Brax learner: it trains, exports and resumes as rsl-rl does, on the same networks."""

from __future__ import annotations

import itertools
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.train.jax_settings import quick_to_compile, why_absent

if (absent := why_absent()) is not None:
    pytest.skip(absent, allow_module_level=True)

import asimov_gym.physics.functional  # noqa: F401  (first: it prepares JAX before anything starts it)

# isort: split
import jax
import jax.numpy as jnp
import torch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from asimov_gym.policy import default_contract, load_policy
from asimov_gym.robot.mirror import mirror_policy
from asimov_gym.robot.observation import observation_layout
from asimov_gym.tasks.walk import WalkTask
from train import brax_networks
from train.__main__ import main
from train.brax_learner import BraxPpo
from train.config import LearnerConfig, PpoConfig
from train.devices import Devices
from train.export import export_onnx
from train.learner import load_actor
from train.ppo import Trainer
from train.replication import device_put_replicated, restore_device_put_replicated
from train.run_folder import RunFolder
from train.weights import NetworkWeights

COPIES, STEPS, ROUNDS = 8, 8, 6
FLAGS = ["--copies", str(COPIES), "--threads", "1", "--learner.steps", str(STEPS), "--learner.hidden", "32", "16"]
FLAGS += ["--samples", str(ROUNDS * COPIES * STEPS), "--checkpoint-s", "1e-6", "--keep-checkpoints", "9"]
LAYOUT = observation_layout("asimov-80")
TASK = WalkTask()


@pytest.fixture(scope="module", autouse=True)
def settings(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    yield from quick_to_compile(tmp_path_factory.mktemp("cache"))


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    """A whole run with a checkpoint after each of its rounds."""
    root = tmp_path_factory.mktemp("runs")
    assert main(["ppo", "--preset", "smoke", "--learner", "brax", "--physics", "c", "--runs", str(root), *FLAGS]) == 0
    (path,) = root.iterdir()
    return RunFolder.open(path)


def _networks(config: LearnerConfig, seed: int = 0) -> tuple[Any, Any, Any]:
    """Networks with random weights and a normaliser that has seen something."""
    ppo = brax_networks.make_networks(config, LAYOUT.mirror, TASK.privileged_mirror)
    rng = np.random.default_rng(seed)

    def stirred(tree: Any) -> Any:
        return jax.tree.map(lambda a: jnp.asarray(a + 0.1 * rng.standard_normal(a.shape), jnp.float32), tree)

    actor = stirred(ppo.policy_network.init(jax.random.PRNGKey(0)))
    critic = stirred(ppo.value_network.init(jax.random.PRNGKey(1)))
    widths = {"state": LAYOUT.width, "privileged_state": TASK.privileged_width}
    mean = {name: jnp.asarray(rng.standard_normal(n), jnp.float32) for name, n in widths.items()}
    std = {name: jnp.asarray(rng.uniform(0.1, 2.0, n), jnp.float32) for name, n in widths.items()}
    return ppo, (actor, critic), brax_networks.NestedMeanStd(mean=mean, std=std)


def test_a_run_leaves_a_policy_that_answers_as_the_trained_network(run: RunFolder) -> None:
    policy = load_policy(run.path / "policy.onnx")
    assert dict(policy.contract.training or {})["samples"] == ROUNDS * COPIES * STEPS
    trained = brax_networks.load_actor(run.config().learner, LAYOUT, run.load_checkpoint()["learner"]["networks"])
    rows = np.random.default_rng(0).standard_normal((1000, LAYOUT.width)).astype(np.float32)
    assert np.abs(trained(rows)).max() > 1e-3
    np.testing.assert_allclose(policy.infer(rows), trained(rows), atol=1e-5)  # the bound of every export
    np.testing.assert_allclose(trained(LAYOUT.mirror(rows)), mirror_policy(trained(rows)), atol=1e-6)
    assert (run.config().library, run.config().physics) == ("brax", "c")


def test_curves_have_the_names_of_those_of_rsl_rl(run: RunFolder, tmp_path: Path) -> None:
    assert (
        main(["ppo", "--preset", "smoke", "--learner", "rsl_rl", "--physics", "c", "--runs", str(tmp_path), *FLAGS])
        == 0
    )
    names = []
    for path in (run.path, *tmp_path.iterdir()):
        events = EventAccumulator(str(path / "curves"))
        events.Reload()
        names.append(set(events.Tags()["scalars"]))
        assert len(events.Scalars("loss/value")) == ROUNDS
    assert names[0] == names[1] and len(names[0]) > 30


def test_a_resumed_run_equals_the_uninterrupted_one_bit_for_bit(run: RunFolder, tmp_path: Path) -> None:
    parts = RunFolder(shutil.copytree(run.path, tmp_path / "parts"))
    for late in parts.checkpoints()[ROUNDS // 2 :]:
        late.unlink()
    assert parts.load_checkpoint()["progress"]["samples"] == ROUNDS // 2 * COPIES * STEPS
    assert main(["resume", str(parts.path)]) == 0
    straight, resumed = run.load_checkpoint(), parts.load_checkpoint()
    assert straight["progress"]["iteration"] == resumed["progress"]["iteration"] == ROUNDS
    assert len(straight["ranks"]) == 1
    for ours, theirs in (
        (straight["learner"]["networks"], resumed["learner"]["networks"]),
        (straight["learner"]["optimiser"], resumed["learner"]["optimiser"]),
        (straight["ranks"][0]["state"], resumed["ranks"][0]["state"]),
    ):
        assert list(ours) == list(theirs) and len(ours) > 5
        for name, value in ours.items():
            assert value.dtype == theirs[name].dtype
            np.testing.assert_array_equal(theirs[name], value, err_msg=name)
    assert any("learning_rate" in name for name in straight["learner"]["optimiser"])
    assert "info.key" in straight["ranks"][0]["state"]


def test_a_checkpoint_of_other_settings_is_refused(run: RunFolder, tmp_path: Path, capsys: Any) -> None:
    other = RunFolder(shutil.copytree(run.path, tmp_path / "other"))
    text = (other.path / "config.yaml").read_text()
    (other.path / "config.yaml").write_text(text.replace("  - 32\n  - 16", "  - 16\n  - 16"))
    assert other.config().learner.hidden == (16, 16)
    assert main(["resume", str(other.path)]) == 2
    assert (
        "the checkpoint does not fit these settings: actor.hidden_0.bias must have shape (16,)"
        in capsys.readouterr().err
    )


@pytest.mark.parametrize("symmetry", ["network", "handed", "samples", "none"])
def test_actor_and_critic_are_symmetric_exactly_where_that_is_asked(symmetry: str) -> None:
    ppo, (actor, critic), normaliser = _networks(LearnerConfig(hidden=(32, 16), symmetry=symmetry))
    rng = np.random.default_rng(1)
    obs = {
        "state": rng.standard_normal((20, LAYOUT.width)).astype(np.float32),
        "privileged_state": rng.standard_normal((20, TASK.privileged_width)).astype(np.float32),
    }
    mirrored = {
        "state": LAYOUT.mirror(obs["state"]),
        "privileged_state": TASK.privileged_mirror(obs["privileged_state"]),
    }
    (mean, std), value = (
        ppo.policy_network.apply(normaliser, actor, obs),
        ppo.value_network.apply(normaliser, critic, obs),
    )
    again, _ = ppo.policy_network.apply(normaliser, actor, mirrored)
    worth = ppo.value_network.apply(normaliser, critic, mirrored)
    assert mean.shape == std.shape == (20, 23) and value.shape == (20,) and np.abs(mean).max() > 0.1
    off = np.abs(np.asarray(again) - mirror_policy(np.asarray(mean))).max(), np.abs(worth - value).max()
    if symmetry == "network":
        assert max(off) < 1e-6  # rounding of sums of order 1 in float32
        np.testing.assert_array_equal(std[:, mirror_policy.indices], std)
    else:  # a handed one is symmetric where the clock runs: see the test of weights
        assert min(off) > 0.01


@pytest.mark.parametrize("symmetry", ["network", "handed", "none"])
def test_weights_mean_the_same_in_both_learners(symmetry: str, tmp_path: Path) -> None:
    config = LearnerConfig(hidden=(32, 16), symmetry=symmetry)
    actor = load_actor(config, LAYOUT, _torch_weights(config))
    carried = NetworkWeights.from_torch(actor.state_dict())
    trained = brax_networks.load_actor(config, LAYOUT, carried.to_brax("actor"))
    report = export_onnx(actor, default_contract(), tmp_path / "p.onnx", trained=trained)
    assert report.difference < 1e-5
    back = NetworkWeights.from_brax({"networks": carried.to_brax("actor")}, "actor").to_torch()
    assert sorted(back) == sorted(actor.state_dict())
    for name, value in actor.state_dict().items():
        torch.testing.assert_close(back[name], value, rtol=1e-6, atol=0.0)  # the deviation is a root taken twice


def _torch_weights(config: LearnerConfig) -> dict[str, Any]:
    """Random weights as rsl-rl keeps them."""
    torch.manual_seed(0)
    rng, sizes = np.random.default_rng(0), (LAYOUT.width, *config.hidden, 23)
    layers = [
        ((0.2 * rng.standard_normal((b, a))).astype(np.float32), rng.standard_normal(b).astype(np.float32))
        for a, b in itertools.pairwise(sizes)
    ]
    mean, variance = rng.standard_normal(LAYOUT.width), rng.uniform(0.1, 2.0, LAYOUT.width)
    log_std = rng.standard_normal(23).astype(np.float32)
    return NetworkWeights(
        tuple(layers), mean.astype(np.float32), variance.astype(np.float32), 5_000_000_000, log_std
    ).to_torch()


def test_copies_that_cannot_be_divided_are_refused() -> None:
    from asimov_gym.envs.functional import FunctionalWalk

    env = FunctionalWalk(physics="c", threads=1, curriculum=True)
    with pytest.raises(ValueError, match=r"copies must be a multiple of learner\.minibatches × devices = 4 × 1"):
        BraxPpo(env, LearnerConfig(), Devices.all(), 6, 0)


@pytest.mark.parametrize("present", [True, False])
def test_what_newer_jax_lacks_is_given_back(present: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    kept = object()
    if present:
        monkeypatch.setattr(jax, "device_put_replicated", kept, raising=False)
    else:
        monkeypatch.delattr(jax, "device_put_replicated", raising=False)
    restore_device_put_replicated()
    try:
        assert jax.device_put_replicated is (kept if present else device_put_replicated)  # type: ignore[attr-defined]
    finally:
        if not present:
            del jax.device_put_replicated  # type: ignore[attr-defined]
    tree = device_put_replicated({"a": np.arange(3.0), "b": 2}, jax.local_devices())
    assert tree["a"].shape == (jax.local_device_count(), 3) and tree["b"].shape == (jax.local_device_count(),)
    np.testing.assert_array_equal(tree["a"][0], np.arange(3.0))
    assert jax.pmap(lambda t: t["a"].sum() * t["b"])(tree)[0] == 6.0


@pytest.mark.slow
@pytest.mark.parametrize("symmetry", ["samples", "none"])
def test_the_other_symmetries_train_and_export(symmetry: str, tmp_path: Path) -> None:
    flags = [*FLAGS, "--learner.symmetry", symmetry]
    assert (
        main(["ppo", "--preset", "smoke", "--learner", "brax", "--physics", "c", "--runs", str(tmp_path), *flags]) == 0
    )
    (path,) = tmp_path.iterdir()
    assert load_policy(path / "policy.onnx").infer(np.zeros((1, LAYOUT.width), np.float32)).shape == (1, 23)


@pytest.mark.slow
@pytest.mark.parametrize("learner", ["brax", "rsl_rl"])
def test_a_warm_start_takes_the_networks_of_either_learner(learner: str, run: RunFolder, tmp_path: Path) -> None:
    """The first actor of the warm-started run answers as the last one of the run before."""
    from train.brax_ppo import BraxTrainer

    config = run.config()
    trained = brax_networks.load_actor(config.learner, LAYOUT, run.load_checkpoint()["learner"]["networks"])
    rows = np.random.default_rng(0).standard_normal((50, LAYOUT.width)).astype(np.float32)
    if learner == "rsl_rl":
        trainer = Trainer(
            PpoConfig(library=learner, physics="c", copies=COPIES, threads=1, learner=config.learner),
            RunFolder(tmp_path),
        )
        trainer.warm_start(run)
        actor = load_actor(config.learner, LAYOUT, trainer.learned()["actor_state_dict"])
        report = export_onnx(actor, default_contract(), tmp_path / "p.onnx", trained=trained)
        assert report.difference < 1e-5
        folder = RunFolder.create(tmp_path, "rsl", trainer.config)
        trainer.folder = folder
        trainer.save()
    else:
        folder = run
    again = BraxTrainer(config, RunFolder(tmp_path))
    again.warm_start(folder)
    answer = brax_networks.load_actor(config.learner, LAYOUT, again.learned()["networks"])
    np.testing.assert_allclose(answer(rows), trained(rows), atol=1e-6)
    assert again.iterate()["loss/value"] > 0.0


@pytest.mark.slow
def test_the_training_loop_of_brax_itself_runs_on_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    """With what it lacks on newer JAX given back."""
    from brax.training.agents.ppo import train as ppo

    from asimov_gym.envs.functional import FunctionalWalk

    monkeypatch.setattr(jax, "device_put_replicated", device_put_replicated, raising=False)
    env = FunctionalWalk(physics="c", threads=1)
    figures: list[Any] = []
    _, (normaliser, *_), _ = ppo.train(
        env,  # type: ignore[arg-type]
        num_timesteps=64,
        num_envs=8,
        episode_length=1000,
        unroll_length=4,
        batch_size=8,
        num_minibatches=1,
        num_updates_per_batch=1,
        num_evals=1,
        normalize_observations=True,
        run_evals=False,
        wrap_env_fn=lambda env, **_: env,
        progress_fn=lambda step, metrics: figures.append((step, metrics)),
    )
    assert int(normaliser.count) == 64 and figures[-1][0] == 64
    assert np.isfinite(figures[-1][1]["training/total_loss"])


@pytest.mark.slow
def test_both_learners_resume_exactly_on_mjx(tmp_path: Path) -> None:
    from train.brax_ppo import BraxTrainer

    learner = LearnerConfig(steps=4, hidden=(16,), minibatches=2, epochs=2)
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    for kind in (BraxTrainer, Trainer):
        library = "brax" if kind is BraxTrainer else "rsl_rl"
        config = PpoConfig(library=library, physics="mjx", copies=4, threads=1, learner=learner)
        whole = kind(config, RunFolder.create(tmp_path, library, config))
        whole.iterate()
        whole.save()
        figures = whole.iterate()
        again = kind(config, whole.folder)
        again.resume()
        repeated = again.iterate()
        for name, value in figures.items():
            assert name.startswith("speed/") or repeated[name] == value, name
        assert _equal(whole.own(), again.own()) and _equal(whole.learned(), again.learned())
    torch.set_num_threads(before)


def _equal(ours: Any, theirs: Any) -> bool:
    """Whether two trees of dictionaries, lists and arrays are the same bit for bit."""
    if isinstance(ours, dict):
        return list(ours) == list(theirs) and all(_equal(value, theirs[name]) for name, value in ours.items())
    if isinstance(ours, list | tuple):
        return len(ours) == len(theirs) and all(map(_equal, ours, theirs))
    if isinstance(ours, np.ndarray):
        return ours.dtype == theirs.dtype and np.array_equal(ours, theirs)
    return bool((ours == theirs).all()) if hasattr(ours, "all") else ours == theirs
