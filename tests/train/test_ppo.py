"""The trainer: it learns, stops cleanly, continues exactly, and refuses what it does not know."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="the training extra is not installed: pip install 'asimov-gym[train]'")
pytest.importorskip("rsl_rl", reason="the training extra is not installed: pip install 'asimov-gym[train]'")

from asimov_gym import presets  # noqa: E402
from asimov_gym.policy import load_policy  # noqa: E402
from asimov_gym.robot.joints import POLICY_JOINT_NAMES  # noqa: E402
from train.__main__ import main  # noqa: E402
from train.config import LearnerConfig, PpoConfig, load_preset, preset_names  # noqa: E402
from train.ppo import Trainer  # noqa: E402
from train.run_folder import RunFolder  # noqa: E402
from train.symmetry import MirrorSamples  # noqa: E402

TINY = PpoConfig(copies=16, samples=16 * 8 * 4, threads=1, learner=LearnerConfig(steps=8, hidden=(32, 16)))
REPOSITORY = Path(__file__).resolve().parents[2]


@pytest.fixture(autouse=True)
def one_thread():
    """Results are the same bit for bit only with one thread."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def _folder(tmp_path: Path, config: PpoConfig = TINY, name: str = "tiny") -> RunFolder:
    return RunFolder.create(tmp_path, name, config)


def _weights(trainer: Trainer) -> dict[str, Any]:
    return {name: value.clone() for name, value in trainer.ppo.get_policy().state_dict().items()}


def test_a_run_leaves_a_policy_curves_and_its_origin(tmp_path: Path) -> None:
    presets.save(TINY, tmp_path / "tiny.yaml")
    flags = ["--samples", "512", "--copies", "16", "--threads", "1", "--learner.steps", "8"]
    assert main(["ppo", "--preset", "smoke", "--runs", str(tmp_path / "runs"), *flags]) == 0
    (path,) = (tmp_path / "runs").iterdir()
    config = RunFolder.open(path).config()
    assert (config.samples, config.copies, config.learner.steps) == (512, 16, 8)
    policy = load_policy(path / "policy.onnx")
    assert policy(np.zeros((2, 80), dtype=np.float32)).shape == (2, len(POLICY_JOINT_NAMES))
    training = dict(policy.contract.training or {})
    assert training.pop("seconds") >= 0
    assert training == {"preset": "smoke", "samples": 512, "after": None}
    assert policy.contract.model_sha256 == RunFolder.open(path).origin()["model_sha256"]
    assert list((path / "curves").glob("events.*"))
    assert main(["export", str(path), "-o", str(tmp_path / "again.onnx")]) == 0
    again = load_policy(tmp_path / "again.onnx")
    sample = np.random.default_rng(0).standard_normal((5, 80)).astype(np.float32)
    np.testing.assert_array_equal(again(sample), policy(sample))


def test_a_resumed_run_equals_the_uninterrupted_one(tmp_path: Path) -> None:
    whole = Trainer(TINY, _folder(tmp_path, name="whole"))
    for _ in range(4):
        whole.iterate()
    first = Trainer(TINY, _folder(tmp_path, name="parts"))
    for _ in range(2):
        first.iterate()
    first.save()
    second = Trainer(TINY, first.folder)
    second.resume()
    assert second.progress.samples == first.progress.samples
    for _ in range(2):
        second.iterate()
    for name, value in _weights(whole).items():
        assert torch.equal(value, _weights(second)[name]), name
    assert torch.equal(whole.observations["actor"], second.observations["actor"])


def test_the_same_seed_gives_the_same_run_and_another_seed_another(tmp_path: Path) -> None:
    results = []
    for seed, name in ((1, "a"), (1, "b"), (2, "c")):
        config = PpoConfig(copies=16, samples=256, threads=1, seed=seed, learner=TINY.learner)
        trainer = Trainer(config, _folder(tmp_path, config, name))
        trainer.iterate()
        results.append(_weights(trainer)["mlp.0.weight"])
    assert torch.equal(results[0], results[1])
    assert not torch.equal(results[0], results[2])


def test_learning_changes_the_policy_towards_its_advantages(tmp_path: Path) -> None:
    """After an update on one fixed batch, actions with positive advantage are likelier than before."""
    config = PpoConfig(copies=64, samples=10_000, threads=1, learner=LearnerConfig(steps=8, symmetry="none"))
    trainer = Trainer(config, _folder(tmp_path, config))
    ppo, kept = trainer.ppo, {}
    update = ppo.update

    def spy() -> dict[str, float]:
        storage = ppo.storage
        kept["views"] = storage.observations.flatten(0, 1).clone()
        kept["actions"] = storage.actions.flatten(0, 1).clone()
        kept["before"] = storage.actions_log_prob.flatten().clone()
        kept["advantage"] = storage.advantages.flatten().clone()
        return update()

    ppo.update = spy  # type: ignore[method-assign]
    trainer.iterate()
    with torch.no_grad():
        ppo.actor(kept["views"], stochastic_output=True)
        gain = ppo.actor.get_output_log_prob(kept["actions"]).flatten() - kept["before"]
    good = kept["advantage"] > 0
    assert gain[good].mean() > gain[~good].mean()


def test_mirrored_samples_are_mirror_images_and_do_not_count_as_a_step(tmp_path: Path) -> None:
    trainer = Trainer(TINY, _folder(tmp_path))
    trainer.mirror = None
    ppo, task, seen = trainer.ppo, trainer.batch.task, {}

    def stop() -> dict[str, float]:
        storage = ppo.storage
        seen["views"], seen["actions"] = storage.observations["actor"].clone(), storage.actions.clone()
        seen["likelihood"] = storage.actions_log_prob.clone()
        MirrorSamples(task.layout.mirror, task.privileged_mirror)(ppo)
        with torch.no_grad():
            ppo.actor(storage.observations.flatten(0, 1), stochastic_output=True)
            old = tuple(p.flatten(0, 1) for p in storage.distribution_params or ())
            seen["kl"] = ppo.actor.get_kl_divergence(old, ppo.actor.output_distribution_params)
        seen["after"] = storage.observations["actor"].clone(), storage.actions.clone(), storage.actions_log_prob.clone()
        storage.clear()
        return {}

    ppo.update = stop  # type: ignore[method-assign]
    trainer.iterate()
    views, actions, likelihood = seen["after"]
    mirrored = torch.from_numpy(np.asarray(task.layout.mirror(seen["views"].numpy()), dtype=np.float32))
    flipped, kept = (views == mirrored).all(-1), (views == seen["views"]).all(-1)
    assert (flipped | kept).all()
    assert 0.3 < flipped.float().mean() < 0.7
    assert torch.equal((actions != seen["actions"]).any(-1), flipped)
    assert torch.equal(likelihood, seen["likelihood"])
    assert seen["kl"].abs().max() < 1e-5


def test_ctrl_c_saves_and_leaves_cleanly(tmp_path: Path) -> None:
    command = [
        sys.executable,
        "-m",
        "train",
        "ppo",
        "--preset",
        "smoke",
        "--runs",
        str(tmp_path),
        "--samples",
        "100000000",
    ]
    command += ["--copies", "16", "--threads", "1"]
    process = subprocess.Popen(
        command,
        cwd=REPOSITORY,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env=os.environ | {"OMP_NUM_THREADS": "1"},
    )
    try:
        deadline = time.monotonic() + 120
        while not list(tmp_path.glob("*/curves/events.*")):
            assert process.poll() is None and time.monotonic() < deadline
            time.sleep(0.2)
        time.sleep(1.0)
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate(timeout=120)
    finally:
        process.kill()
    assert process.returncode == 0, output
    assert "continue with:" in output and "python -m train resume" in output
    (path,) = tmp_path.iterdir()
    assert RunFolder.open(path).load_checkpoint()["progress"]["samples"] > 0


def test_only_the_newest_checkpoints_are_kept(tmp_path: Path) -> None:
    folder = _folder(tmp_path)
    for samples in (10, 20, 30, 1000):
        folder.save_checkpoint(samples, {"n": samples}, keep=2)
    assert [path.name for path in folder.checkpoints()] == ["checkpoint_000000000030.pt", "checkpoint_000000001000.pt"]
    assert folder.load_checkpoint() == {"n": 1000}
    assert not list(folder.path.rglob("*.partial"))


def test_presets_are_complete_and_valid() -> None:
    assert {"laptop", "smoke"} <= set(preset_names())
    for name in preset_names():
        assert isinstance(load_preset(name), PpoConfig)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["ppo", "--preset", "huge"], f"preset 'huge' is unknown; known presets: {', '.join(preset_names())}"),
        (["resume", "nowhere"], "nowhere is not a training run"),
        (["fly"], "unknown command 'fly'; known commands: ppo, recipe, ablation, resume, average, calibrate, export,"),
        (["ppo", "--preset", "smoke", "--copies", "2"], "copies must be at least"),
    ],
)
def test_bad_commands_say_what_is_allowed(arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]) -> None:
    try:
        code = main(arguments)
    except SystemExit as left:  # flags are checked by their parser
        code = left.code
    assert code == 2
    assert words in capsys.readouterr().err


def test_unknown_yaml_keys_are_refused(tmp_path: Path) -> None:
    (tmp_path / "p.yaml").write_text("samples: 10\nwalk: {command: {vz: [0, 1]}}\n")
    with pytest.raises(ValueError, match=r"p.yaml: unknown keys \['vz'\] in walk.command; known keys: vx, vy"):
        presets.load(PpoConfig, tmp_path / "p.yaml")


def test_without_the_extra_the_command_names_it() -> None:
    code = (
        "import sys\n"
        "class Missing:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name.split('.')[0] == 'torch':\n"
        "            raise ModuleNotFoundError(\"No module named 'torch'\", name='torch')\n"
        "sys.meta_path.insert(0, Missing())\n"
        "from train.__main__ import main\n"
        "sys.exit(main(['ppo', '--preset', 'smoke']))\n"
    )
    result = subprocess.run([sys.executable, "-c", code], cwd=REPOSITORY, capture_output=True, text=True)
    assert result.returncode == 2
    assert "asimov-gym[train]" in result.stderr


def test_origin_names_the_model(tmp_path: Path) -> None:
    origin = _folder(tmp_path).origin()
    assert origin["preset"] == "tiny" and len(origin["model_sha256"] or "") == 64
    assert json.loads(json.dumps(origin)) == origin


@pytest.mark.slow
def test_smoke_preset_learns_in_two_minutes(tmp_path: Path) -> None:
    """The whole smoke run, and the robot stands longer at its end than at its start."""
    began = time.monotonic()
    assert main(["ppo", "--preset", "smoke", "--runs", str(tmp_path)]) == 0
    assert time.monotonic() - began < 120
    (path,) = tmp_path.iterdir()
    assert (path / "policy.onnx").is_file()


def test_a_run_that_does_not_fit_into_memory_says_so(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(*arguments: Any, **more: Any) -> int:
        raise RuntimeError("RESOURCE_EXHAUSTED: Out of memory allocating 68719476736 bytes.\nlong story")

    monkeypatch.setattr("train.session.start_run", full)
    assert main(["ppo", "--preset", "smoke"]) == 1
    assert capsys.readouterr().err == (
        "error: the run does not fit into memory, use fewer --copies "
        "(RESOURCE_EXHAUSTED: Out of memory allocating 68719476736 bytes.)\n"
    )
