"""`asimov bench env` and `train`: that the bare physics does the same work, and that results say what they are of."""

from __future__ import annotations

import importlib.util
import json
import platform
import re
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from asimov_gym.cli import main
from asimov_gym.cli.bench_env import NAMES, BenchEnv, FirstStep
from asimov_gym.cli.bench_profiles import ladder
from asimov_gym.cli.bench_subjects import SUBJECTS, RawPhysics
from asimov_gym.cli.machine import Machine
from asimov_gym.envs.walk_batch import WalkBatch
from asimov_gym.physics import PROFILES
from asimov_gym.tasks.walk import WalkConfig

ROOT = Path(__file__).resolve().parents[2]
needs_training = pytest.mark.skipif(
    importlib.util.find_spec("rsl_rl") is None,
    reason="the training extra is not installed: pip install 'asimov-gym[train]'",
)


def test_the_bare_physics_does_the_same_steps() -> None:
    """Randomised robots stepped by the batch, and by `mujoco.rollout` on what was recorded, end in the same state."""
    batch = WalkBatch(WalkConfig(), 6, threads=1, seed=3, kicks=False, autoreset=False)
    raw, rng = RawPhysics(batch, threads=2), np.random.default_rng(0)
    action = rng.normal(size=(6, 23)).astype(np.float32)
    moments = raw.record(3, lambda: batch.step(action))
    assert raw.seconds(moments) > 0.0
    state = batch.physics.state()
    after = raw.rows[:, -1]
    np.testing.assert_allclose(after, np.column_stack([state.time, state.qpos, state.qvel]), rtol=0, atol=1e-12)
    assert np.ptp(state.qpos, axis=0).max() > 1e-3  # the robots differ
    raw.close()
    batch.close()


@pytest.mark.parametrize("name", ["batch", "gym"])
def test_throughput_is_a_share_of_the_bare_physics(name: str) -> None:
    result = BenchEnv(steps=2, repeats=3, threads=1).throughput(name, 4)
    assert (result.environment, result.copies, result.compile_s) == (name, 4, None)
    assert 0.05 < result.share < 1.5 and result.spread >= 0.0
    assert result.steps_per_s > 10
    assert result.peak_memory_mb is None or result.peak_memory_mb > 20


def test_every_environment_has_a_subject() -> None:
    assert set(NAMES) == set(SUBJECTS)


def test_the_whole_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    flags = ["--copies", "3", "--steps", "2", "--repeats", "2", "--threads", "1", "--no-first-step"]
    assert main(["bench", "env", *flags, "--environments", "batch", "--json", str(tmp_path)]) == 0
    assert "bare physics" in capsys.readouterr().out
    (file,) = tmp_path.iterdir()
    assert file.name == f"{Machine.this().name}_env.json"
    result = json.loads(file.read_text(encoding="utf-8"))
    assert result["subject"] == "env" and result["first_step"] == {}
    assert result["settings"] == {"threads": 1, "steps": 2, "repeats": 2, "profile": "training"}
    (row,) = result["throughput"]
    assert row["copies"] == 3 and row["share"] > 0.0


@pytest.mark.slow
def test_a_fresh_process_makes_its_first_step() -> None:
    first = BenchEnv()._first("gym")
    assert isinstance(first, FirstStep) and 0.0 < first.step_s < 60.0 and first.cached_s is None


@pytest.mark.slow
@pytest.mark.skipif(
    importlib.util.find_spec("jax") is None, reason="JAX is not installed: pip install 'asimov-gym[mjx]'"
)
def test_compiled_environments_are_measured_too() -> None:
    result = BenchEnv(steps=2, repeats=2, threads=1).throughput("jax-c", 4)
    assert result.compile_s is not None and result.compile_s > 0.0
    assert 0.0 < result.share < 1.5


@pytest.mark.skipif(
    importlib.util.find_spec("jax") is not None, reason="shows what is said without JAX, and here is JAX"
)
def test_a_missing_engine_is_one_line_with_the_way_out(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "env", "--copies", "2", "--environments", "jax-mjx"]) == 2
    last = capsys.readouterr().err.strip().splitlines()[-1]
    assert "jax-mjx with 2 copies" in last and "asimov-gym[mjx]" in last


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (["env", "--copies", "0"], "--copies must be numbers of at least 1, got [0]"),
        (["env", "--repeats", "0"], "--repeats must be at least 1, got 0"),
        (["env", "--threads", "0"], "--threads must be at least 1, got 0"),
        (["train", "--rounds", "0"], "--rounds must be at least 1, got 0"),
    ],
)
def test_bad_flags_are_one_line_and_2(flags: list[str], words: str, capsys: pytest.CaptureFixture[str]) -> None:
    if flags[0] == "train" and importlib.util.find_spec("rsl_rl") is None:
        pytest.skip("the training extra is not installed: pip install 'asimov-gym[train]'")
    assert main(["bench", *flags]) == 2
    error = capsys.readouterr().err
    assert words in error and error.count("\n") == 1


@needs_training
def test_training_is_measured_in_its_stages(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "train.json"
    flags = ["--preset", "smoke", "--copies", "16", "--rounds", "2", "--threads", "1", "--json", str(file)]
    assert main(["bench", "train", *flags]) == 0
    assert "learning included" in capsys.readouterr().out
    t = json.loads(file.read_text(encoding="utf-8"))["training"]
    assert t["copies"] == 16 and t["samples"] == 16 * 24
    assert 0.0 < t["share"] < 1.0 and t["learn_s"] > 0.0
    assert t["collect_s"] > 0.5 * t["physics_s"]  # noise aside, a part of it


@needs_training
def test_an_unknown_preset_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "train", "--preset", "huge"]) == 2
    assert "preset 'huge' is unknown" in capsys.readouterr().err


def test_the_machine_is_described_without_whose_it_is() -> None:
    machine = Machine.this()
    assert machine.cores >= 1 and machine.cpu and "mujoco" in machine.packages
    assert re.fullmatch(r"[a-z0-9_]+_\d+_cores\w*", machine.name)
    words = json.dumps(vars(machine))
    node = platform.node()
    assert not node or node == "localhost" or node not in words
    assert "/home" not in words and str(ROOT) not in words


@pytest.mark.parametrize("file", sorted((ROOT / "benchmarks").glob("*.json")), ids=lambda file: file.name)
def test_committed_results_name_their_machine(file: Path) -> None:
    result = json.loads(file.read_text(encoding="utf-8"))
    m = result["machine"] | {"gpus": tuple(result["machine"]["gpus"])}
    assert file.name == f"{Machine(**m).name}_{result['subject']}.json"


def test_profiles_lead_from_training_to_evaluation() -> None:
    profiles = list(ladder().values())
    same = {"name": "", "profile": ""}
    assert profiles[0] is PROFILES["training"]
    assert asdict(profiles[-1]) | same == asdict(PROFILES["evaluation"]) | same
    for before, after in pairwise(profiles):
        assert asdict(before) != asdict(after)


def test_the_cost_of_profiles_is_measured_in_turn(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    flags = ["--copies", "2", "--steps", "2", "--rounds", "2", "--threads", "1", "--json", str(tmp_path)]
    assert main(["bench", "profiles", *flags]) == 0
    assert "all bodies collide: evaluation" in capsys.readouterr().out
    (file,) = tmp_path.iterdir()
    rows = json.loads(file.read_text())["profiles"]
    assert len(rows) == len(ladder()) and rows[0]["slower"] == 1.0 and rows[0]["spread"] == 0.0
    assert rows[-1]["slower"] > 1.0 and all(row["steps_per_s"] > 10 for row in rows)
    assert main(["bench", "profiles", "--rounds", "0"]) == 2
    assert "--rounds must be at least 1, got 0" in capsys.readouterr().err
