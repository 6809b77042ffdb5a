"""Two results side by side: pairing, intervals, flags, and what it refuses."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from asimov_gym.evaluation.compare import Comparison, DifferentSuitesError, compare, write_comparison
from asimov_gym.evaluation.results import SKIPPED, SuiteResult
from tests.evaluation.made_results import push, result, scenario, trial, whole_suite

INFO = scenario("grid/one", (0.5, 0.0, 0.0), 10)
ERROR = "velocity_error_m_s"


def made(errors: Sequence[float], fallen: Sequence[int] = (), name: str = "a", **other: object) -> SuiteResult:
    """Ten repeats of one walk."""
    trials = [
        trial(INFO, k, {} if k in fallen else {ERROR: error}, fall_s=2.0 if k in fallen else None)
        for k, error in enumerate(errors)
    ]
    return result([INFO], trials, policy_name=name, **other)


def metric(comparison: Comparison, name: str = ERROR):
    (row,) = [row for row in comparison.metrics if row.metric == name]
    return row


def test_a_small_gain_in_every_pair_is_seen_through_a_wide_spread() -> None:
    """Repeats differ by 0.05, the policies by 0.002: only pairing can tell."""
    spread = [0.01 + 0.005 * k for k in range(10)]
    better = [value - 0.002 - 0.0001 * (k % 3) for k, value in enumerate(spread)]
    row = metric(compare(made(spread), made(better, name="b")))
    assert row.flag == "better" and row.pairs == 10
    assert row.difference == pytest.approx(row.second - row.first) == pytest.approx(-0.00209)
    assert row.low is not None and row.high is not None and row.low < row.difference < row.high < 0.0
    assert metric(compare(made(better), made(spread, name="b"))).flag == "worse"


def test_noise_is_no_difference() -> None:
    first = [0.02, 0.03] * 5
    row = metric(compare(made(first), made([0.03, 0.02] * 5, name="b")))
    assert row.flag == "no difference" and row.difference == pytest.approx(0.0)


def test_higher_is_better_for_some_figures_and_neither_for_others() -> None:
    def with_figure(name: str, values: Sequence[float]) -> SuiteResult:
        return result([INFO], [trial(INFO, k, {name: value}) for k, value in enumerate(values)])

    low, high = [0.03 + 0.001 * k for k in range(10)], [0.05 + 0.001 * k for k in range(10)]
    for name, flag in (("foot_clearance_m", "better"), ("slip_m_s", "worse"), ("gait_frequency_hz", "different")):
        assert metric(compare(with_figure(name, low), with_figure(name, high)), name).flag == flag


def test_only_pairs_that_both_survived_have_a_figure() -> None:
    """The first policy lost its hard trials; the second must not look worse for having survived them."""
    first = made([0.02] * 10, fallen=(8, 9))
    second = made([0.02] * 8 + [0.2, 0.2], name="b")
    row = metric(compare(first, second))
    assert row.pairs == 8 and row.difference == 0.0 and row.flag == "no difference"


def test_survival_is_judged_by_the_pairs_that_differ() -> None:
    steady = [0.02] * 10
    comparison = compare(made(steady, fallen=range(6)), made(steady, name="b"))
    whole, grid = comparison.outcomes
    assert (whole.config, grid.config) == ("all", "grid")
    assert (grid.first, grid.second, grid.only_first, grid.only_second) == (4, 10, 0, 6)
    assert grid.p_value == pytest.approx(2 / 2**6) and grid.flag == "better"
    assert compare(made(steady), made(steady, fallen=range(6), name="b")).outcomes[0].flag == "worse"
    few = compare(made(steady, fallen=range(5)), made(steady, name="b")).outcomes[0]
    assert few.p_value == pytest.approx(2 / 2**5) and few.flag == "no difference"


def test_must_pass_pushes_count_also_where_the_next_one_fells_both() -> None:
    """No trial survives, but the second policy passes the first push of each."""
    info = scenario("push_standing/pelvis", repeats=8, seconds=12.0)

    def pushed(first: str, fall_s: float) -> SuiteResult:
        events = (push(450, "reasonable", first), push(575, "beyond", "failed" if first == "passed" else "skipped"))
        return result([info], [trial(info, k, fall_s=fall_s, events=events) for k in range(8)])

    rows = {row.what: row for row in compare(pushed("failed", 3.0), pushed("passed", 9.0)).outcomes[1:]}
    assert rows["survival"].flag == rows["pushes, beyond"].flag == "no difference"
    must = rows["pushes, reasonable"]
    assert (must.first, must.second, must.pairs, must.flag) == (0, 8, 8, "better")


def test_trials_with_another_seed_or_not_run_are_no_pairs() -> None:
    first, second = made([0.02] * 10), made([0.02] * 10, name="b")
    moved = replace(second, trials=(replace(second.trials[0], seed=1), *second.trials[1:-1]))
    comparison = compare(first, moved)
    assert comparison.pairs == 8 and comparison.unpaired == 3
    skipped = replace(second, trials=tuple(replace(t, error=f"{SKIPPED}no jax") for t in second.trials))
    with pytest.raises(DifferentSuitesError, match="share no trial with the same seed"):
        compare(first, skipped)


def test_other_suites_are_refused_unless_allowed() -> None:
    first, other = made([0.02] * 10), made([0.02] * 10, suite="full", suite_hash="6" * 64)
    with pytest.raises(DifferentSuitesError, match=r"made \(5555.* and full \(6666.*--allow-different"):
        compare(first, other)
    comparison = compare(first, other, allow_different=True)
    assert not comparison.same_suite and comparison.pairs == 10


def test_push_limits_differ_by_more_than_their_resolution() -> None:
    first = whole_suite()
    limits = list(first.push_limits)
    limits[0] = replace(limits[0], largest_survived_n=limits[0].largest_survived_n + 50.0)
    limits[1] = replace(limits[1], largest_survived_n=limits[1].largest_survived_n - 25.0)
    limits[2] = replace(limits[2], largest_survived_n=0.0)
    rows = compare(first, replace(first, push_limits=tuple(limits))).pushes
    assert [row.flag for row in rows[:4]] == ["better", "no difference", "worse", "no difference"]


def test_a_policy_against_itself_does_not_differ() -> None:
    comparison = compare(whole_suite(), whole_suite())
    flags = {row.flag for row in (*comparison.outcomes, *comparison.metrics, *comparison.pushes)}
    assert flags == {"no difference"}
    assert comparison.table().rows == (("–", "–", "–", "–", "–", "no difference"),)
    assert comparison.first != comparison.second  # columns can be told apart


def test_it_is_written_as_json_markdown_and_a_page(tmp_path: Path) -> None:
    comparison = compare(whole_suite(), whole_suite(error=lambda info: 0.02), allow_different=True)
    page = write_comparison(comparison, tmp_path / "new")
    text = page.read_text()
    assert page.name == "compare.html" and '<td class="good">better</td>' in text and "script" not in text
    data = json.loads((page.parent / "compare.json").read_text())
    assert data["pairs"] == comparison.pairs and data["metrics"][0]["metric"] == comparison.metrics[0].metric
    assert "| better |" in (page.parent / "compare.md").read_text()
