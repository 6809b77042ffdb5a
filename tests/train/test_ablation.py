"""Studies: every variant trained, judged and written down; stopped anywhere and gone on with exactly."""

from __future__ import annotations

import json
import os
import shutil
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

torch = pytest.importorskip("torch", reason="the training extra is not installed: pip install 'asimov-gym[train]'")
pytest.importorskip("rsl_rl", reason="the training extra is not installed: pip install 'asimov-gym[train]'")

from asimov_gym.assets import asset_path  # noqa: E402
from asimov_gym.evaluation.suite import load_suite  # noqa: E402
from tests.evaluation.made_results import whole_suite  # noqa: E402
from tests.train.interruption import interrupted_killed_and_resumed  # noqa: E402
from tests.train.test_ablation_file import changed, written  # noqa: E402
from train.__main__ import main  # noqa: E402
from train.ablation import load_study  # noqa: E402
from train.ablation_result import AblationResult  # noqa: E402
from train.config import load_preset  # noqa: E402
from train.ppo import Trainer  # noqa: E402
from train.run_folder import RunFolder  # noqa: E402
from train.session import evaluation_place  # noqa: E402

PLAN = changed("[1, 2]", "[1]")
NAMES = ["all_seed1", "quiet_seed1", "loose_seed1", "all_seed5"]


pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(scope="module", autouse=True)
def exports() -> Iterator[None]:
    """The shipped policy in place of each export, which takes longer than these trainings."""

    def copy(path: Path, output: Path | None) -> int:
        shutil.copy(asset_path("policies", "asimov_walk.onnx"), output or path / "policy.onnx")
        return 0

    with pytest.MonkeyPatch.context() as patch:
        for module in ("session", "ablation_run"):
            patch.setattr(f"train.{module}.export_run", copy)
        yield


class Judge:
    """In place of the evaluation, which takes longer than these trainings: made-up results."""

    def __init__(self) -> None:
        self.asked: list[str] = []
        self.stop_at: str | None = None

    def __call__(self, folder: RunFolder, policy: Any, suite: Any) -> tuple[Any, Path]:
        if folder.path.name == self.stop_at:
            self.stop_at = None
            raise KeyboardInterrupt
        self.asked.append(folder.path.name)
        place = evaluation_place(folder, policy, suite)
        place.mkdir(parents=True)
        return whole_suite(place), place


@pytest.fixture
def judge(monkeypatch: pytest.MonkeyPatch) -> Judge:
    made = Judge()
    monkeypatch.setattr("train.ablation_run.evaluate_run", made)
    return made


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a study that ran without a stop."""
    root = tmp_path_factory.mktemp("whole")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("train.ablation_run.evaluate_run", Judge())
        command = [
            "ablation",
            written(root, PLAN),
            "--runs",
            str(root / "runs"),
            "--keep",
            str(root / "kept" / "trio.json"),
        ]
        assert main(command) == 0
    return root / "runs" / "trio"


@pytest.fixture
def ran(whole: Path, tmp_path: Path) -> Path:
    """A copy of it, in `runs` of a test's own folder."""
    return Path(shutil.copytree(whole, tmp_path / "runs" / "trio"))


def test_every_variant_is_trained_with_every_seed_and_written_down(whole: Path) -> None:
    assert sorted(path.name for path in whole.iterdir() if path.is_dir()) == sorted(NAMES)
    assert [RunFolder.open(whole / name).config().seed for name in NAMES] == [1, 1, 1, 5]
    result = AblationResult.load(whole / "ablation.json")
    kept = whole.parent.parent / "kept" / "trio.json"
    assert kept.read_text() == (whole / "ablation.json").read_text()
    assert {one.name: [run.seed for run in one.trainings] for one in result.variants} == {
        "all": [1, 5],
        "quiet": [1],
        "loose": [1],
    }
    assert (result.finished, result.planned, result.failures, result.after) == (4, 4, {}, ())
    assert (result.suite, result.suite_hash) == ("smoke", load_suite("smoke").hash)
    assert result.settings["walk"]["noise"]["gyro"] == 0.05 and result.study["samples"] == 256
    assert {"asimov-gym", "mujoco", "torch"} <= set(result.versions)
    quiet = result.variants[1]
    assert quiet.changes == {"walk.noise.gyro": [0.05, 0.0]}
    (training,) = quiet.trainings
    assert training.samples == 256 and training.seconds > 0.0
    assert training.commit == RunFolder(whole / "quiet_seed1").origin()["commit"]
    assert training.policy_hash and training.curve["samples"] == (128.0, 256.0)
    assert set(training.curve) == {"samples", "episode_length_s", "falls_per_min", "velocity_error_m_s"}


def test_no_path_of_the_machine_is_in_the_file(whole: Path) -> None:
    assert str(whole.parent) not in (whole / "ablation.json").read_text()


def test_figures_follow_from_the_suites_result(whole: Path, tmp_path: Path) -> None:
    from train.ablation_figures import FIGURES

    data = json.loads((whole / "ablation.json").read_text())
    figures = data["variants"][0]["trainings"][0]["figures"]
    made = whole_suite(tmp_path)
    grid = [t for t in made.trials if t.config == "grid"]
    up = sum(t.survived for t in grid)
    assert figures["survival_grid"] == {
        "value": pytest.approx(up / len(grid), rel=1e-4),
        "count": up,
        "whole": len(grid),
    }
    errors = [t.metrics["velocity_error_m_s"] for t in grid if t.metrics["velocity_error_m_s"] is not None]
    assert figures["velocity_error"]["value"] == pytest.approx(sum(errors) / len(errors), rel=1e-4)
    assert figures["velocity_error"]["count"] == len(errors)
    for tier, name in (("reasonable", "must_pass_pushes"), ("beyond", "stretch_pushes")):
        outcomes = [push.outcome for t in made.trials for push in t.events if push.tier == tier]
        assert (figures[name]["count"], figures[name]["whole"]) == (outcomes.count("passed"), len(outcomes)) != (0, 0)
    assert figures["samples_to_stay_up"] == {"value": None, "count": 0, "whole": 1}  # two rounds are not ten
    assert list(figures) == [name for name in FIGURES if name in figures]


def test_what_is_finished_is_neither_trained_nor_judged_again(
    ran: Path, judge: Judge, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(Trainer, "iterate", lambda self: pytest.fail("a finished training was trained"))
    before = json.loads((ran / "ablation.json").read_text())
    (ran / "ablation.json").unlink()
    (ran / "loose_seed1" / "policy.onnx").unlink()  # as if it was killed before the export
    shutil.rmtree(ran / "all_seed5" / "evaluation")  # and before it was judged
    assert main(["ablation", written(ran.parent.parent, PLAN), "--runs", str(ran.parent)]) == 0
    assert judge.asked == ["all_seed5"]
    after = json.loads((ran / "ablation.json").read_text())
    assert after["variants"] == before["variants"]
    output = capsys.readouterr().out
    assert output.count("done") == 4 and f"result: {ran / 'ablation.json'}" in output


def test_trainings_in_the_kept_file_stay_and_are_not_done_again(
    whole: Path, tmp_path: Path, judge: Judge, capsys: pytest.CaptureFixture[str]
) -> None:
    """Also where their runs are gone."""
    kept, text = tmp_path / "trio.json", (whole / "ablation.json").read_text()
    before = json.loads(text)
    left = dict(before, variants=[one for one in before["variants"] if one["name"] != "quiet"])
    kept.write_text(json.dumps(left))
    command = ["ablation", written(tmp_path, PLAN), "--runs", str(tmp_path / "runs"), "--keep", str(kept)]
    assert main(command) == 0
    assert judge.asked == ["quiet_seed1"]
    after = json.loads(kept.read_text())
    assert [one["name"] for one in after["variants"]] == ["all", "quiet", "loose"]
    others = [one for one in after["variants"] if one["name"] != "quiet"]
    assert others == left["variants"]
    assert capsys.readouterr().out.count(f"in {kept}") == 2 * 3  # before the training, and at the end
    shutil.rmtree(tmp_path / "runs")
    assert main(command) == 0
    assert judge.asked == ["quiet_seed1"] and json.loads(kept.read_text()) == after
    assert f"result: {kept}" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("samples: 256", "samples: 384", "the base's settings"),
        ("gyro: 0", "gyro: 0.01", "variant quiet"),
        ("base_seeds: [5]", "base_seeds: [6]", "all_seed5"),
        ("suite: smoke", "suite: quick", "suite smoke"),
    ],
)
def test_a_kept_file_of_another_study_is_not_written_over(
    old: str, new: str, words: str, whole: Path, tmp_path: Path, judge: Judge, capsys: pytest.CaptureFixture[str]
) -> None:
    kept, text = tmp_path / "trio.json", (whole / "ablation.json").read_text()
    kept.write_text(text)
    assert old in PLAN
    study = written(tmp_path, PLAN.replace(old, new))
    assert main(["ablation", study, "--runs", str(tmp_path / "runs"), "--keep", str(kept)]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "has trainings of another study, it differs in" in said and words in said
    assert kept.read_text() == text and judge.asked == []


class Killed(BaseException):
    """Nothing catches it, and nothing is saved: as `kill -9`."""


def ctrl_c() -> None:
    os.kill(os.getpid(), signal.SIGINT)


def kill() -> None:
    raise Killed


@pytest.mark.parametrize(("rounds", "how"), [(2, ctrl_c), (3, kill)])
def test_a_stopped_study_goes_on_to_the_same_networks(
    rounds: int,
    how: Callable[[], None],
    whole: Path,
    tmp_path: Path,
    judge: Judge,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    study, runs = written(tmp_path, PLAN.replace("learner: {", "checkpoint_s: 1.0e-6, learner: {")), tmp_path / "runs"
    command = ["ablation", study, "--runs", str(runs), "--only", "all", "quiet"]
    left, iterate = [rounds], Trainer.iterate

    def counted(trainer: Trainer) -> dict[str, float]:
        if left[0] == 0:
            how()
        left[0] -= 1
        return iterate(trainer)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Trainer, "iterate", counted)
        if how is kill:
            with pytest.raises(Killed):
                main(command)
        else:
            assert main(command) == 0
            words = f"stopped; continue with:  python -m train ablation {study} --runs {runs} --only all quiet"
            assert words in capsys.readouterr().out
    assert judge.asked == NAMES[: rounds // 2]
    assert main(command) == 0
    assert judge.asked == [name for name in NAMES if "loose" not in name]
    for name in judge.asked:
        ours, theirs = (RunFolder.open(root / name).load_checkpoint() for root in (runs / "trio", whole))
        for key, value in theirs["learner"]["actor_state_dict"].items():
            assert torch.equal(ours["learner"]["actor_state_dict"][key], value), f"{name} {key}"
    result = AblationResult.load(runs / "trio" / "ablation.json")
    assert [one.name for one in result.variants] == ["all", "quiet"] and (result.finished, result.planned) == (3, 4)


def test_ctrl_c_while_judging_says_how_to_go_on(ran: Path, judge: Judge, capsys: Any) -> None:
    judge.stop_at = "quiet_seed1"
    shutil.rmtree(ran / "quiet_seed1" / "evaluation")
    command = ["ablation", written(ran.parent.parent, PLAN), "--runs", str(ran.parent), "--only", "quiet"]
    assert main(command) == 130
    words = f"stopped; continue with:  python -m train ablation {command[1]} --runs {ran.parent} --only quiet"
    assert words in capsys.readouterr().out
    assert main(command) == 0 and judge.asked == ["quiet_seed1"]
    assert AblationResult.load(ran / "ablation.json").finished == 4  # those of variants not asked for stay


def test_a_training_that_breaks_does_not_end_the_study(
    tmp_path: Path, judge: Judge, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    iterate = Trainer.iterate

    def broken(trainer: Trainer) -> dict[str, float]:
        if trainer.config.learner.clip == 0.9:
            raise ValueError("the weights are\nnot finite")
        return iterate(trainer)

    monkeypatch.setattr(Trainer, "iterate", broken)
    one_seed = PLAN.replace("[5]", "[]")
    command = ["ablation", written(tmp_path, one_seed), "--runs", str(tmp_path / "runs")]
    assert main(command) == 1
    assert "loose_seed1 broke: the weights are not finite" in capsys.readouterr().out
    result = AblationResult.load(tmp_path / "runs" / "trio" / "ablation.json")
    assert result.failures == {"loose_seed1": "the weights are not finite"}
    assert [one.name for one in result.variants] == ["all", "quiet"]
    monkeypatch.setattr(Trainer, "iterate", iterate)
    assert main(command) == 0
    result = AblationResult.load(tmp_path / "runs" / "trio" / "ablation.json")
    assert (result.failures, result.finished) == ({}, 3)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("samples: 256", "samples: 384", "all_seed1 was trained with samples = 256, the study now says 384"),
        ("{clip: 0.9}", "{clip: 0.8}", "loose_seed1 was trained with learner.clip = 0.9, the study now says 0.8"),
    ],
)
def test_a_changed_study_is_refused(old: str, new: str, words: str, ran: Path, capsys: Any) -> None:
    assert main(["ablation", written(ran.parent.parent, PLAN.replace(old, new)), "--runs", str(ran.parent)]) == 2
    said = capsys.readouterr().err
    assert words in said and "undo the change, or train anew with another --runs" in said and said.count("\n") == 1


def test_another_scale_is_a_changed_study(ran: Path, capsys: Any) -> None:
    assert main(["ablation", written(ran.parent.parent, PLAN), "--runs", str(ran.parent), "--scale", "0.5"]) == 2
    assert "trained with samples = 256, the study now says 128" in capsys.readouterr().err


def test_all_begin_with_the_networks_of_a_run(whole: Path, tmp_path: Path, judge: Judge, capsys: Any) -> None:
    text = PLAN.replace("[5]", "[]") + "warm_start: true\n"
    parent = tmp_path / "parent"
    shutil.copytree(whole / "all_seed5", parent)
    command = ["ablation", written(tmp_path, text), "--runs", str(tmp_path / "runs")]
    assert main(command) == 2
    assert "begins with the networks of a run: name it with --warm-start RUN" in capsys.readouterr().err
    assert main([*command, "--warm-start", str(tmp_path / "nowhere")]) == 2
    assert "nowhere is not a training run" in capsys.readouterr().err
    assert main([*command, "--warm-start", str(parent)]) == 0
    result = AblationResult.load(tmp_path / "runs" / "trio" / "ablation.json")
    assert [dict(stage) for stage in result.after] == RunFolder(parent).history()
    for name in ("all_seed1", "quiet_seed1", "loose_seed1"):
        assert RunFolder(tmp_path / "runs" / "trio" / name).origin()["after"] == RunFolder(parent).history()
    assert main([*command, "--warm-start", str(tmp_path / "runs" / "trio" / "quiet_seed1")]) == 2
    assert "all_seed1 was not trained after what is in" in capsys.readouterr().err


def test_a_run_whose_networks_do_not_fit_is_refused(whole: Path, tmp_path: Path, capsys: Any) -> None:
    text = PLAN.replace("[32, 16]", "[16, 16]") + "warm_start: true\n"
    command = ["ablation", written(tmp_path, text), "--runs", str(tmp_path / "runs")]
    assert main([*command, "--warm-start", str(whole / "all_seed1")]) == 2
    assert "study trio: learner.hidden must be (32, 16) as in" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["cake"], "ablation 'cake' is unknown; known ablations: ingredients, recovery, smoke, or a .yaml file"),
        (["nowhere.yaml"], "no ablation file at nowhere.yaml"),
        (["smoke", "--scale", "0"], "scale must lie in [1e-06, 1000], got 0.0"),
        (["smoke", "--only", "cake"], "--only must name variants of smoke: all, sensor_noise, got 'cake'"),
        (["smoke", "--warm-start", "x"], "study smoke begins with new networks: --warm-start is not for it"),
    ],
)
def test_bad_commands_say_what_is_allowed(arguments: list[str], words: str, tmp_path: Path, capsys: Any) -> None:
    assert main(["ablation", *arguments, "--runs", str(tmp_path / "runs")]) == 2
    said = capsys.readouterr().err
    assert words in said and said.count("\n") == 1
    assert not (tmp_path / "runs").exists()


def test_an_unknown_suite_and_several_processes_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["ablation", written(tmp_path, PLAN.replace("suite: smoke", "suite: easy"))]) == 2
    assert "suite 'easy' is unknown; known suites: " in capsys.readouterr().err
    monkeypatch.setenv("WORLD_SIZE", "4")
    assert main(["ablation", written(tmp_path, PLAN), "--runs", str(tmp_path)]) == 2
    assert "a study trains in one process, got 4" in capsys.readouterr().err


# -- for real --------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_smoke_is_interrupted_killed_resumed_and_judged(tmp_path: Path) -> None:
    first, second = tmp_path / "smoke" / "all_seed1", tmp_path / "smoke" / "sensor_noise_seed1"
    judging = lambda: list(second.glob("evaluation/*/trials.jsonl"))  # noqa: E731
    interrupted_killed_and_resumed(["ablation", "smoke", "--runs", str(tmp_path)], first, judging)
    result = AblationResult.load(tmp_path / "smoke" / "ablation.json")
    assert [(one.name, [run.samples for run in one.trainings]) for one in result.variants] == [
        ("all", [7680]),
        ("sensor_noise", [7680]),
    ]
    for variant in result.variants:
        figures = variant.figures
        assert figures["survival_grid"].whole == 6 and figures["must_pass_pushes"].whole == 1
        assert figures["rated_torque"].mean not in (None, 0.0) and figures["largest_push"].mean is not None
    study = load_study("smoke")
    assert study.config(study.base).walk == load_preset("smoke").walk
