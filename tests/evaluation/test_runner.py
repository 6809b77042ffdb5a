"""Running suites: packing, stopping and continuing, failed rows, what a result holds."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from asimov_gym.evaluation import runner
from asimov_gym.evaluation.journal import RunFolderError
from asimov_gym.evaluation.results import SuiteResult
from asimov_gym.evaluation.runner import SuiteRun, batches, run_suite
from asimov_gym.evaluation.suite import Suite, parse_suite
from tests.evaluation.standins import Statue

PUSH = {"bodies": ["pelvis_link"], "directions_deg": [180], "speeds": [0], "max_n": 600, "resolution_n": 200}


def _suite(**rest: Any) -> Suite:
    data: dict[str, Any] = {
        "repeats": 2,
        "traces": ["stand/still"],
        "scenarios": [
            {"config": "stand", "walks": {"still": [0, 0, 0], "asked": [0.3, 0, 0]}, "duration": 1},
            {
                "config": "stand",
                "walks": {"soft": [0, 0, 0]},
                "duration": 0.5,
                "vary": {"terrain": ["flat", "slope:3"]},
            },
        ],
    }
    return parse_suite(data | rest, "small")


def _figures(result: SuiteResult) -> dict[str, Any]:
    """What must not depend on how a suite was run."""
    data = result.to_json()
    return {key: data[key] for key in ("trials", "push_limits", "scenarios", "suite_hash", "complete")}


def test_results_do_not_depend_on_batching_or_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    suite = _suite()
    whole = run_suite(Statue(), suite, threads=2)
    monkeypatch.setattr(runner, "MAX_BATCH_BYTES", 1.0)
    assert all(len(batch) == 1 for batch in batches(suite.trials))
    assert _figures(run_suite(Statue(), suite, threads=1)) == _figures(whole)


def test_batches_share_a_model_and_fit_into_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    suite = _suite()
    packed = batches(suite.trials)
    assert sorted(len(batch) for batch in packed) == [2, 6]
    kept = [(trial.scenario.id, trial.repeat) for batch in packed for trial in batch]
    assert sorted(kept) == sorted((trial.scenario.id, trial.repeat) for trial in suite.trials)
    assert all(len({trial.scenario.conditions.terrain for trial in batch}) == 1 for batch in packed)
    monkeypatch.setattr(runner, "MAX_BATCH_BYTES", 3 * 50 * runner.ROW_BYTES)
    assert sorted(len(batch) for batch in batches(suite.trials)) == [2, 3, 3]


def test_a_result_holds_everything(tmp_path: Path) -> None:
    result = run_suite(Statue(), _suite(), tmp_path / "run")
    assert result.complete and len(result.trials) == 8
    assert (result.policy_name, result.policy_hash, result.suite) == ("statue", "0" * 64, "small")
    assert [t.repeat for t in result.trials_of("stand/still")] == [0, 1]
    trial = result.trials_of("stand/asked")[1]
    assert trial.survived and trial.delay_ms == 5.0 and trial.fall_s is None and trial.error is None
    assert result.trials_of("stand/still")[0].metrics["standing_drift_m"] is not None
    assert result.versions["mujoco"] and result.contract["layout"] == "asimov-80"
    with np.load(tmp_path / "run" / result.traces["stand/still"]) as trace:
        assert len(trace["position"]) == 50
    result.save(tmp_path / "run")
    again = SuiteResult.load(tmp_path / "run")
    assert again == replace(result, machine=again.machine)


def test_a_stopped_run_continues_to_the_same_result(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runner, "MAX_BATCH_BYTES", 3 * 50 * runner.ROW_BYTES)
    suite = _suite(push_limits=[PUSH])
    whole = run_suite(Statue(), suite)
    folder = tmp_path / "run"

    def stop_after(seconds: float) -> Any:
        def progress(stage: str, done: float, all_of_it: float) -> None:
            if stage == runner.PUSH_LIMITS or done > seconds:
                raise KeyboardInterrupt

        return progress

    run = SuiteRun(Statue(), suite, folder)
    with pytest.raises(KeyboardInterrupt):
        run.execute(stop_after(4.0))
    first = run.result()
    assert not first.complete and 3 <= len(first.trials) < 8
    # The machine may go down within a line.
    with (folder / "trials.jsonl").open("a") as file:
        file.write('{"trial": {"scenario": "stan')
    again = SuiteRun(Statue(), suite, folder, resume=True)
    assert again.result().trials == first.trials
    with pytest.raises(KeyboardInterrupt):
        again.execute(stop_after(1e9))
    steps: list[float] = []
    last = SuiteRun(Statue(), suite, folder, resume=True)
    done = last.execute(lambda stage, done, whole: steps.append(done) if stage == runner.SCENARIOS else None)
    assert _figures(done) == _figures(whole) and done.push_limits and done.complete
    assert steps == [suite.robot_seconds]  # nothing was run twice
    assert done.wall_clock_s >= first.wall_clock_s and done.started == first.started


def test_folders_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    with pytest.raises(RunFolderError, match="holds no run that could be continued"):
        run_suite(Statue(), _suite(), folder, resume=True)
    run_suite(Statue(), _suite(), folder)
    with pytest.raises(RunFolderError, match="holds a run already: continue it with --resume"):
        run_suite(Statue(), _suite(), folder)
    with pytest.raises(RunFolderError, match="another suite"):
        run_suite(Statue(), _suite(seed=1), folder, resume=True)
    other = Statue()
    other.sha256 = "1" * 64
    with pytest.raises(RunFolderError, match="another policy"):
        run_suite(other, _suite(), folder, resume=True)
    (folder / "trials.jsonl").write_text('{"trial": {}}\n')
    with pytest.raises(RunFolderError, match=r"trials.jsonl, line 1 cannot be read"):
        run_suite(Statue(), _suite(), folder, resume=True)


def test_what_cannot_be_run_is_a_failed_row_with_its_reason(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Broken(Statue):
        def infer(self, observation: np.ndarray) -> np.ndarray:
            return np.full((*observation.shape[:-1], 23), np.nan, dtype=np.float32)

    result = run_suite(Broken(), _suite())
    assert result.complete and len(result.trials) == 8 and not any(t.survived for t in result.trials)
    assert {t.error for t in result.trials} == {"the network's output is not finite after 0.00 s"}
    assert all(t.fall_s is None and t.was_run for t in result.trials)

    def absent(*args: Any, **kwargs: Any) -> None:
        raise ModuleNotFoundError("jax is not installed")

    monkeypatch.setattr(runner, "roll_out", absent)
    skipped = run_suite(Statue(), _suite(), tmp_path / "run")
    assert {t.error for t in skipped.trials} == {"skipped: jax is not installed"}
    assert not any(t.was_run for t in skipped.trials)
    monkeypatch.undo()
    # On a machine that can, they are run.
    assert all(t.survived for t in run_suite(Statue(), _suite(), tmp_path / "run", resume=True).trials)


def test_a_fall_and_its_pushes_are_told() -> None:
    suite = parse_suite({"scenarios": [{"rows": ["push_standing/pelvis_back"]}], "repeats": 1}, "push")
    (trial,) = run_suite(Statue(), suite).trials
    assert not trial.survived and trial.fall_s is not None and 2.0 < trial.fall_s < 8.0
    assert [(e.outcome, e.tier, e.force, e.at_s) for e in trial.events] == [
        ("failed", "reasonable", 450.0, 2.0),
        ("skipped", "beyond", 575.0, 8.0),
    ]


def test_push_limits_of_a_statue() -> None:
    (limit,) = run_suite(Statue(), _suite(push_limits=[PUSH], scenarios=[], traces=[])).push_limits
    assert limit.smallest_failed_n == limit.largest_survived_n + 200
    assert (limit.body, limit.direction, limit.speed, limit.repeats) == ("pelvis_link", (-1.0, 0.0, 0.0), 0.0, 2)


def test_results_refuse_other_schemas(tmp_path: Path) -> None:
    result = run_suite(Statue(), parse_suite({"scenarios": [], "push_limits": [PUSH | {"max_n": 200}]}, "p"))
    path = result.save(tmp_path)
    data = json.loads(path.read_text())
    for change, message in (
        ({"schema_version": 2}, "schema_version must be 1, got 2"),
        ({"extra": 1}, r"unknown keys \['extra'\]"),
    ):
        path.write_text(json.dumps(data | change))
        with pytest.raises(ValueError, match=message):
            SuiteResult.load(tmp_path)
    with pytest.raises(FileNotFoundError, match="no suite result at"):
        SuiteResult.load(tmp_path / "nowhere")
