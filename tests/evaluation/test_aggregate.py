"""From trials to shares, means, push rates and failed rows, counted by hand."""

from __future__ import annotations

import pytest

from asimov_gym.evaluation.aggregate import (
    by_config,
    by_scenario,
    failures,
    push_rows,
    push_tallies,
    select,
    vendor_figures,
    worst_joint,
)
from asimov_gym.evaluation.metrics import joint_metric
from asimov_gym.evaluation.results import SKIPPED
from tests.evaluation.made_results import push, result, scenario, trial, whole_suite


def test_survival_and_means_of_a_category() -> None:
    fast, slow = scenario("grid/fast", (0.8, 0, 0), 2), scenario("grid/slow", (0.2, 0, 0), 2)
    made = result(
        [fast, slow, scenario("standing/still")],
        [
            trial(fast, 0, {"velocity_error_m_s": 0.04}),
            trial(fast, 1, fall_s=3.0),
            trial(slow, 0, {"velocity_error_m_s": 0.01}),
            trial(slow, 1, {"velocity_error_m_s": 0.01}),
        ],
    )
    grid, standing = by_config(made)
    assert (grid.survival.passed, grid.survival.whole, grid.planned, grid.is_complete) == (3, 4, 4, True)
    assert (standing.survival.whole, standing.is_complete) == (0, False)
    assert grid.values("velocity_error_m_s") == [[0.04], [0.01, 0.01]]
    assert grid.mean_value("velocity_error_m_s") == pytest.approx(0.02)
    assert grid.largest("velocity_error_m_s") == 0.04
    assert grid.metrics == ("velocity_error_m_s",)
    assert [group.name for group in by_scenario(made)] == ["grid/fast", "grid/slow", "standing/still"]
    assert select(made, "", lambda info: info.commands[0][1] > 0.5).survival.passed == 1


def test_what_a_machine_cannot_run_is_no_fall() -> None:
    info = scenario("physics/mjx", repeats=2, physics="mjx")
    made = result([info], [trial(info, 0, error=f"{SKIPPED}no jax"), trial(info, 1)])
    (group,) = by_config(made)
    assert (group.survival.passed, group.survival.whole) == (1, 1)
    assert len(group.skipped) == 1 and not group.is_complete
    assert [f.reason for f in failures(made)] == [f"{SKIPPED}no jax"]


def test_a_push_row_passes_only_if_every_repeat_does() -> None:
    info = scenario("push_standing/pelvis", repeats=2, seconds=12.0)
    made = result(
        [info],
        [
            trial(info, 0, events=(push(450, "reasonable", "passed"), push(575, "beyond", "passed", at=8.0))),
            trial(
                info, 1, fall_s=9.0, events=(push(450, "reasonable", "passed"), push(575, "beyond", "failed", at=8.0))
            ),
        ],
    )
    must, stretch = push_rows(made)
    assert must.passed and not stretch.passed
    assert (stretch.outcomes.passed, stretch.outcomes.whole) == (1, 2)
    tallies = {tally.tier: tally for tally in push_tallies(push_rows(made))}
    assert tallies["reasonable"].max_force_survived_n == 450
    assert tallies["beyond"].max_force_survived_n is None
    assert tallies["beyond"].rows.value == 0.0 and tallies["beyond"].trials.value == 0.5
    (figures,) = vendor_figures(made)
    assert figures.upright_rate == 0.5 and figures.push_pass_rate == 0.75 and figures.max_force_survived_n == 450


def test_skipped_pushes_and_broken_trials_do_not_pass() -> None:
    info = scenario("push_standing/pelvis", repeats=3, seconds=12.0)
    fell = (push(450, "reasonable", "failed"), push(575, "beyond", "skipped", at=8.0))
    fine = (push(450, "reasonable", "passed"), push(575, "beyond", "passed", at=8.0))
    made = result(
        [info],
        [trial(info, 0, fall_s=2.9, events=fell), trial(info, 1, events=fine), trial(info, 2, error="diverged")],
    )
    assert [(row.outcomes.passed, row.outcomes.whole) for row in push_rows(made)] == [(1, 3), (1, 3)]


def test_failures_list_every_trial_that_did_not_pass_with_its_reason() -> None:
    made = whole_suite()
    listed = {(f.scenario, f.repeat): f.reason for f in failures(made)}
    assert listed["grid/0.8_0.4_0.8", 2] == "fell at 31.50 s"
    assert listed["noise/broken", 0] == "the simulation diverged after 3.20 s"
    assert listed["noise/broken", 1] == "not run"
    assert listed["push_standing/pelvis_link", 0] == ("fell at 8.90 s, after the push pelvis_link 550 of 550 N at 8 s")
    planned = sum(info.repeats for info in made.scenarios)
    passed = sum(t.survived for t in made.trials)
    assert len(listed) == planned - passed == 18


def test_worst_joint() -> None:
    metrics = {
        joint_metric("torque_peak_share", j): v for j, v in (("left_knee_joint", 0.7), ("right_knee_joint", 0.9))
    }
    assert worst_joint(metrics, "torque_peak_share") == "right_knee"
    assert worst_joint([metrics, {}], "torque_peak_share") == "right_knee"
    assert worst_joint({}, "torque_peak_share") is None
