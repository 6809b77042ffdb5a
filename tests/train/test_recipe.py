"""Recipes: stages in order, each from the networks of the one before; stopped anywhere and gone on with exactly."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="the training extra is not installed: pip install 'asimov-gym[train]'")
pytest.importorskip("rsl_rl", reason="the training extra is not installed: pip install 'asimov-gym[train]'")

from tests.train.interruption import REPOSITORY, interrupted_killed_and_resumed  # noqa: E402
from tests.train.jax_settings import why_absent  # noqa: E402
from tests.train.recipe_pair import PAIR, ROUND, changed, written  # noqa: E402
from train.__main__ import main  # noqa: E402
from train.calibration import MustWalk  # noqa: E402
from train.card import read_curves  # noqa: E402
from train.config import load_preset  # noqa: E402
from train.ppo import Trainer  # noqa: E402
from train.run_folder import RunFolder  # noqa: E402

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture
def cards(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Any, ...]]:
    """Calls for a card, in place of the evaluation."""
    asked: list[tuple[Any, ...]] = []

    def note(*arguments: Any) -> int:
        asked.append(arguments)
        return 0

    monkeypatch.setattr("train.recipe_run.write_run_card", note)
    return asked


def networks(path: Path) -> dict[str, Any]:
    """Actor, critic and optimiser of the newest checkpoint, flat."""
    learned = RunFolder.open(path).load_checkpoint()["learner"]
    moments = learned["optimizer_state_dict"]["state"]
    flat = {f"moment.{i}.{name}": value for i, state in moments.items() for name, value in state.items()}
    return flat | learned["actor_state_dict"] | learned["critic_state_dict"]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a recipe that ran without a stop."""
    root = tmp_path_factory.mktemp("whole")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("train.recipe_run.write_run_card", lambda *arguments: 0)
        assert main(["recipe", written(root), "--runs", str(root / "runs"), "--suite", "smoke"]) == 0
    return root / "runs" / "pair"


@pytest.fixture
def ran(whole: Path, tmp_path: Path) -> Path:
    """A copy of it, in `runs` of a test's own folder."""
    return Path(shutil.copytree(whole, tmp_path / "runs" / "pair"))


def test_stages_run_in_order_each_from_the_one_before(whole: Path) -> None:
    first, second = (RunFolder.open(whole / name) for name in ("01_first", "02_second"))
    assert sorted(path.name for path in whole.iterdir()) == ["01_first", "02_second"]
    assert (first.origin()["after"], second.origin()["after"]) == (None, first.history())
    assert [stage["samples"] for stage in second.history()] == [256, 512]
    assert (first.config().seed, second.config().seed) == (1, 2)
    assert (first.config().learner.desired_kl, second.config().learner.desired_kl) == (0.012, 0.02)
    assert second.config().learner.steps == first.config().learner.steps == 8
    assert second.origin()["recipe"].startswith("python -m train recipe ")
    assert (whole / "02_second" / "policy.onnx").is_file()


def test_a_stage_begins_with_the_networks_of_the_one_before(
    whole: Path, ran: Path, cards: list[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    begun: dict[str, Any] = {}
    iterate = Trainer.iterate

    def spy(self: Trainer) -> dict[str, float]:
        if not begun:
            begun.update({name: value.clone() for name, value in self.learned()["actor_state_dict"].items()})
        return iterate(self)

    monkeypatch.setattr(Trainer, "iterate", spy)
    shutil.rmtree(ran / "02_second")
    assert main(["recipe", written(ran.parent.parent), "--runs", str(ran.parent)]) == 0
    before = RunFolder.open(whole / "01_first").load_checkpoint()["learner"]["actor_state_dict"]
    weights = [name for name in before if "weight" in name]
    assert weights and all(torch.equal(begun[name], before[name]) for name in weights)


def test_what_is_finished_is_skipped_and_the_card_is_of_the_last(
    ran: Path, cards: list[Any], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(Trainer, "iterate", lambda self: pytest.fail("a finished stage was trained"))
    (ran / "02_second" / "policy.onnx").unlink()  # as if it was killed before the export
    assert main(["recipe", written(ran.parent.parent), "--runs", str(ran.parent), "--suite", "smoke"]) == 0
    last, policy = ran / "02_second", ran / "02_second" / "policy.onnx"
    assert cards == [(last, policy, None, "smoke", [ran / "01_first"])]
    assert policy.is_file()
    output = capsys.readouterr().out
    assert output.count("done") == 2 and "to come" not in output
    assert f"policy: {policy}" in output


class Stop:
    """Stops the trainer after so many rounds, in its own way."""

    def __init__(self, rounds: int, how: Callable[[], None]) -> None:
        self.rounds, self.how = rounds, how

    def patch(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Into all trainers."""
        iterate = Trainer.iterate

        def counted(trainer: Trainer) -> dict[str, float]:
            if self.rounds == 0:
                self.how()
            self.rounds -= 1
            return iterate(trainer)

        monkeypatch.setattr(Trainer, "iterate", counted)


class Killed(BaseException):
    """Nothing catches it, and nothing is saved: as `kill -9`."""


def ctrl_c() -> None:
    os.kill(os.getpid(), signal.SIGINT)


def kill() -> None:
    raise Killed


@pytest.mark.parametrize(
    ("rounds", "how", "left"),
    [
        (2, kill, [2]),  # after stage 1, whose 2 rounds are over: stage 2 has begun and holds no checkpoint
        (3, ctrl_c, [2, 2]),  # in the second round of stage 2, which is still finished
        (4, kill, [2, 2]),  # in its third
        (0, kill, []),  # before anything was saved
    ],
)
def test_a_stopped_recipe_goes_on_to_the_same_networks(
    rounds: int,
    how: Callable[[], None],
    left: list[int],
    whole: Path,
    tmp_path: Path,
    cards: list[Any],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    recipe, runs = written(tmp_path), tmp_path / "runs"
    command = ["recipe", recipe, "--runs", str(runs)]
    for module in ("session", "recipe_run"):  # it takes longer than this training
        monkeypatch.setattr(f"train.{module}.export_run", lambda path, output: 0)
    with pytest.MonkeyPatch.context() as patch:
        Stop(rounds, how).patch(patch)
        if how is kill:
            with pytest.raises(Killed):
                main(command)
        else:
            assert main(command) == 0
            assert f"stopped; continue with:  python -m train recipe {recipe} --runs {runs}" in capsys.readouterr().out
    assert not cards
    reached = [RunFolder(path).samples() // ROUND for path in sorted((runs / "pair").iterdir())]
    assert [n for n in reached if n] == left
    assert main(command) == 0
    assert len(cards) == 1
    for stage in ("01_first", "02_second"):
        ours, theirs = networks(runs / "pair" / stage), networks(whole / stage)
        assert list(ours) == list(theirs) and len(ours) > 20
        for name, value in theirs.items():
            assert torch.equal(torch.as_tensor(ours[name]), torch.as_tensor(value)), f"{stage} {name}"
        steps = read_curves(RunFolder(runs / "pair" / stage))["episode/reward"][:, 0]
        np.testing.assert_array_equal(steps, np.arange(1, len(steps) + 1) * ROUND)  # none twice


def test_ctrl_c_outside_the_training_says_how_to_go_on(
    ran: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def pressed(*arguments: Any) -> int:
        raise KeyboardInterrupt

    monkeypatch.setattr("train.recipe_run.write_run_card", pressed)
    recipe = written(ran.parent.parent)
    assert main(["recipe", recipe, "--runs", str(ran.parent), "--suite", "vendor"]) == 130
    expected = f"stopped; continue with:  python -m train recipe {recipe} --runs {ran.parent} --suite vendor"
    assert expected in capsys.readouterr().out


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("samples: 256", "samples: 384", "01_first was trained with samples = 256, the recipe now says 384"),
        ("0.02}", "0.03}", "02_second was trained with learner.desired_kl = 0.02, the recipe now says 0.03"),
        ("copies: 16", "copies: 32", "01_first was trained with copies = 16, the recipe now says 32"),
        ("name: first", "name: begin", "01_first is no stage of recipe pair, whose stages are 01_begin, 02_second"),
        ("preset: smoke, samples: 256", "preset: laptop, samples: 256", "01_first was trained with walk."),
    ],
)
def test_a_changed_recipe_is_refused(old: str, new: str, words: str, ran: Path, capsys: Any) -> None:
    before = sorted(path for path in ran.rglob("*"))
    assert main(["recipe", written(ran.parent.parent, changed(old, new)), "--runs", str(ran.parent)]) == 2
    said = capsys.readouterr().err
    assert words in said and "undo the change, or train anew with another --runs" in said and said.count("\n") == 1
    assert sorted(path for path in ran.rglob("*")) == before


def test_a_stage_without_the_one_it_came_from_is_refused(ran: Path, cards: list[Any], capsys: Any) -> None:
    shutil.rmtree(ran / "01_first")
    assert main(["recipe", written(ran.parent.parent), "--runs", str(ran.parent)]) == 2
    assert "02_second was not trained after what is in" in capsys.readouterr().err


def test_another_scale_is_a_changed_recipe(ran: Path, capsys: Any) -> None:
    assert main(["recipe", written(ran.parent.parent), "--runs", str(ran.parent), "--scale", "0.5"]) == 2
    assert "trained with samples = 256, the recipe now says 128" in capsys.readouterr().err


def test_what_somebody_put_there_is_not_deleted(tmp_path: Path, capsys: Any) -> None:
    own = tmp_path / "runs" / "pair" / "01_first" / "notes.txt"
    own.parent.mkdir(parents=True)
    own.write_text("mine")
    assert main(["recipe", written(tmp_path), "--runs", str(tmp_path / "runs")]) == 2
    assert "01_first has no checkpoint but holds notes.txt: move it away" in capsys.readouterr().err
    assert own.read_text() == "mine"


def test_a_result_that_falls_is_judged_without_a_calibration(
    ran: Path, cards: list[Any], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def falls(run: Path) -> None:
        raise MustWalk("with 9 of 10 commands the robot fell")

    monkeypatch.setattr("train.recipe_run.calibrate_run", falls)
    recipe = written(ran.parent.parent, changed("overrides:\n  library", "calibrated: true\noverrides:\n  library"))
    assert main(["recipe", recipe, "--runs", str(ran.parent)]) == 0
    assert "not calibrated: with 9 of 10 commands the robot fell" in capsys.readouterr().out
    assert [card[0] for card in cards] == [ran / "02_second"] and (ran / "02_second" / "policy.onnx").is_file()


def test_stages_may_be_added_behind_those_that_ran(ran: Path, cards: list[Any]) -> None:
    more = PAIR + "  - {name: third, preset: smoke, samples: 128}\n"
    assert main(["recipe", written(ran.parent.parent, more), "--runs", str(ran.parent)]) == 0
    third = RunFolder.open(ran / "03_third")
    assert [stage["samples"] for stage in third.history()] == [256, 512, 128]
    assert cards[0][4] == [ran / "01_first", ran / "02_second"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["cake"], "recipe 'cake' is unknown; known recipes: smoke, walk, walk_gpu, or a .yaml file"),
        (["nowhere.yaml"], "no recipe file at nowhere.yaml"),
        (["walk", "--scale", "0"], "scale must lie in [1e-06, 1000], got 0.0"),
        (["walk", "--scale", "nan"], "scale must lie in [1e-06, 1000], got nan"),
        (["walk", "--suite", "easy"], "suite 'easy' is unknown; known suites: "),
    ],
)
def test_bad_commands_say_what_is_allowed(arguments: list[str], words: str, tmp_path: Path, capsys: Any) -> None:
    assert main(["recipe", *arguments, "--runs", str(tmp_path / "runs")]) == 2
    said = capsys.readouterr().err
    assert words in said and said.count("\n") == 1
    assert not (tmp_path / "runs").exists()


def test_what_this_machine_cannot_do_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("train.recipe_run.why_no_gpu", lambda: "there is no NVIDIA GPU here")
    assert main(["recipe", "walk_gpu", "--runs", str(tmp_path)]) == 2
    assert "recipe walk_gpu is for a GPU, and there is no NVIDIA GPU here" in capsys.readouterr().err
    monkeypatch.setenv("WORLD_SIZE", "4")
    assert main(["recipe", "walk", "--runs", str(tmp_path)]) == 2
    assert "a recipe trains in one process, got 4" in capsys.readouterr().err


# -- for real --------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_smoke_is_interrupted_killed_resumed_and_judged(tmp_path: Path) -> None:
    first, second = tmp_path / "smoke" / "01_stand", tmp_path / "smoke" / "02_settle"
    output = interrupted_killed_and_resumed(
        ["recipe", "smoke", "--runs", str(tmp_path), "--suite", "smoke"],
        first,
        lambda: list(second.glob("checkpoints/*.pt")),
    )
    assert [RunFolder.open(path).samples() for path in (first, second)] == [15360, 15360]
    assert [stage["samples"] for stage in RunFolder.open(second).history()] == [15360, 15360]
    card = (second / "policy.md").read_text()
    assert "| 2 | `smoke` | 15,360 |" in card and "Made by `python -m train recipe smoke" in card
    assert f"policy: {second / 'policy.onnx'}" in output and f"card: {second / 'policy.md'}" in output


@pytest.mark.slow
@pytest.mark.skipif(why_absent() is not None, reason=str(why_absent()))
def test_a_round_of_the_gpu_preset_runs_on_a_cpu(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "train", "ppo", "--preset", "gpu", "--runs", str(tmp_path), "--samples", "32"]
    command += ["--copies", "8", "--learner.steps", "4", "--learner.hidden", "32", "16"]
    environment = os.environ | {"JAX_PLATFORMS": "cpu", "JAX_DISABLE_MOST_OPTIMIZATIONS": "1"}
    done = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    (run,) = tmp_path.iterdir()
    config = RunFolder.open(run).config()
    assert (config.library, config.physics, config.walk) == ("brax", "mjx", load_preset("laptop").walk)
    assert RunFolder.open(run).samples() == 32
    assert (run / "policy.onnx").is_file()
