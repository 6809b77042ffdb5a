"""The maker's figures: the file holds together, and ours are never called better than they are."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from asimov_gym.assets import config_path
from asimov_gym.evaluation.card import CardFigures
from asimov_gym.evaluation.published import Published, published
from asimov_gym.evaluation.published_comparison import (
    BEHIND,
    Comparison,
    PushComparison,
    compare_counts,
    compare_figures,
    compare_pushes,
)
from asimov_gym.evaluation.results import PushLimit
from asimov_gym.presets import load
from tests.evaluation.made_results import push, result, scenario, trial

FRONT = (1.0, 0.0, 0.0)


def card_of(infos: list[tuple[Any, list[Any]]], limits: tuple[PushLimit, ...] = ()) -> CardFigures:
    """A card of scenarios, each with its trials."""
    return CardFigures.of(result([info for info, _ in infos], [t for _, trials in infos for t in trials], limits))


def pushed(name: str, forces: tuple[float, float], passed: int, of: int = 4, body: str = "pelvis_link") -> Any:
    """A row of the benchmark: every repeat passes the first `passed` pushes and fails the next."""
    info = scenario(name, (0.6 if "walking" in name else 0.0, 0.0, 0.0), of, 12.0)
    outcomes = ["passed"] * passed + ["failed"] + ["skipped"]
    tiers = ("reasonable", "beyond")
    events = tuple(
        push(f, tier, outcome, body, FRONT) for f, tier, outcome in zip(forces, tiers, outcomes, strict=False)
    )
    return info, [trial(info, k, events=events, fall_s=None if passed == 2 else 2.5) for k in range(of)]


def walked(name: str, repeats: int = 4, fell: int = 0, **metrics: float) -> Any:
    info = scenario(name, (0.5, 0.0, 0.5), repeats)
    return info, [trial(info, k, {} if k < fell else metrics, fall_s=3.0 if k < fell else None) for k in range(repeats)]


def limit(survived: float, felled: float | None, speed: float = 0.0, body: str = "pelvis_link") -> PushLimit:
    return PushLimit("push_limit/x", body, FRONT, speed, survived, felled, 25.0, 3)


def of_place(card: CardFigures, where: str, speed: float = 0.0) -> PushComparison:
    return next(one for one in compare_pushes(card, published()) if (one.where, one.speed) == (where, speed))


def named(found: tuple[Comparison, ...], what: str) -> Comparison:
    return next(one for one in found if one.what == what)


# -- the file --------------------------------------------------------------------------------------


def test_every_published_figure_names_its_document() -> None:
    theirs = published()
    for entry in (*theirs.pushes, *theirs.counts, *theirs.figures):
        assert entry.documents and set(entry.documents) <= set(theirs.documents)
    rows = [row for entry in theirs.pushes for row in entry.rows]
    assert len(rows) == len(set(rows))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"counts": [{"what": "a", "passed": 3, "of": 2, "documents": ["variance"]}]}, r"passed must lie in \[0, 2\]"),
        ({"counts": [{"what": "a", "passed": 1, "of": 2, "tier": "hard", "documents": ["variance"]}]}, "tier must be"),
        ({"pushes": [{"rows": ["push_standing/knee"], "sweeps": [], "documents": ["variance"]}]}, "unknown rows"),
        (
            {"pushes": [{"rows": ["locomotion/full_envelope"], "sweeps": [{"fails": 5}], "documents": ["variance"]}]},
            "rows must have a push, locomotion/full_envelope has none",
        ),
        ({"pushes": [{"rows": [], "sweeps": [{"fails": 5, "holds": 6}], "documents": ["variance"]}]}, "fails or holds"),
        (
            {"figures": [{"what": "a", "scenario": "locomotion/circle", "metric": "charm", "low": 1, "high": 1,
                          "documents": ["variance"]}]},
            "metric must be survival or one of .*, got 'charm'",
        ),
        (
            {"figures": [{"what": "a", "scenario": "locomotion/circle", "metric": "survival", "low": 1, "high": 1,
                          "documents": ["rumour"]}]},
            r"figures\[0\]\.documents must name some of methodology, variance, got rumour",
        ),
    ],
)  # fmt: skip
def test_bad_figures_are_refused(change: dict[str, Any], message: str, tmp_path: Path) -> None:
    data = yaml.safe_load(config_path("suites", "published", "model_aug_18_1.yaml").read_text())
    path = tmp_path / "made_up.yaml"
    path.write_text(yaml.safe_dump({**data, **change}))
    with pytest.raises(ValueError, match=message) as caught:
        load(Published, path)
    assert "made_up.yaml" in str(caught.value)


# -- pushes ----------------------------------------------------------------------------------------
# Theirs, chest to the front: 400 N in one sweep, 375 N in the other. Pelvis: 600 N, and none to 600 N.


@pytest.mark.parametrize(
    ("survived", "felled", "verdict"),
    [
        (300.0, 325.0, "worse"),
        (350.0, 375.0, "worse than one sweep"),
        (375.0, 400.0, "level"),
        (400.0, 425.0, "better"),
        (1200.0, None, "better"),
        (0.0, 0.0, "worse"),
    ],
)
def test_a_bisected_push_beside_two_sweeps(survived: float, felled: float | None, verdict: str) -> None:
    found = of_place(card_of([], (limit(survived, felled, body="waist_yaw_link"),)), "chest to the front")
    assert found.verdict == verdict and found.bisected
    assert found.theirs == "400 / 375"


@pytest.mark.parametrize(
    ("survived", "felled", "verdict"),
    [
        (550.0, 575.0, "worse"),
        (575.0, 600.0, "worse than one sweep"),
        (600.0, 625.0, "level"),
        (1200.0, None, "not worse, as far as tried"),
    ],
)
def test_a_sweep_that_never_fell_cannot_be_beaten(survived: float, felled: float | None, verdict: str) -> None:
    found = of_place(card_of([], (limit(survived, felled),)), "pelvis to the front")
    assert found.verdict == verdict and found.theirs == "600 / none to 600"


@pytest.mark.parametrize(
    ("passed", "survived", "felled", "verdict"),
    [(0, None, 225.0, "worse"), (1, 225.0, 300.0, "worse"), (2, 300.0, None, "not worse, as far as tried")],
)
def test_without_a_bisection_the_two_forces_of_the_row_count(
    passed: int, survived: float | None, felled: float | None, verdict: str
) -> None:
    row = pushed("push_standing/left_shoulder_front", (225.0, 300.0), passed, body="left_shoulder_pitch_link")
    found = of_place(card_of([row]), "left shoulder to the front")
    assert (found.survived, found.felled, found.bisected, found.verdict) == (survived, felled, False, verdict)
    assert found.must_pass is not None and found.must_pass.outcomes.passed == (4 if passed else 0)
    assert found.stretch is not None and found.stretch.outcomes.passed == (4 if passed == 2 else 0)


def test_a_failed_row_counts_against_a_bisection_that_went_better() -> None:
    row = pushed("push_standing/chest_front", (250.0, 350.0), 0, body="waist_yaw_link")
    found = of_place(card_of([row], (limit(500.0, 525.0, body="waist_yaw_link"),)), "chest to the front")
    assert (found.survived, found.felled, found.verdict) == (None, 250.0, "worse")


def test_standing_and_walking_are_not_mixed_up() -> None:
    card = card_of([], (limit(1200.0, None, 0.6, "waist_yaw_link"),))
    assert of_place(card, "chest to the front", 0.6).verdict == "better"
    standing = of_place(card, "chest to the front")
    assert standing.verdict == "not measured" and standing.ours == "–"
    assert of_place(card, "left shoulder down", 0.6).verdict == "not published"


# -- counts and walks ------------------------------------------------------------------------------


@pytest.mark.parametrize(("passed", "verdict"), [(1, "level"), (0, "worse")])
def test_counts_are_of_single_pushes(passed: int, verdict: str) -> None:
    rows = [
        pushed("push_standing/pelvis_front", (450.0, 575.0), 1),
        pushed("push_standing/chest_front", (250.0, 350.0), passed),
    ]
    found = named(compare_counts(card_of(rows), published()), "must-pass pushes")
    assert found.verdict == verdict and found.theirs == "20 of 20"
    assert found.ours.startswith(f"{4 + 4 * passed} of 8;")


def test_tests_that_differ_are_not_ranked() -> None:
    card = card_of(
        [pushed("push_standing/pelvis_front", (450.0, 575.0), 0), walked("locomotion/circle", velocity_rmse_m_s=9.0)]
    )
    assert named(compare_counts(card, published()), "pelvis, 450 N, standing, repeated").verdict == "not ranked"
    assert named(compare_figures(card, published()), "circle: RMS error of the velocity").verdict == "not ranked"


@pytest.mark.parametrize(("drift", "verdict"), [(1.1, "better"), (85.0, "level"), (90.0, "worse")])
def test_a_walk_is_ranked_against_their_range(drift: float, verdict: str) -> None:
    card = card_of([walked("distance/square_lap_100m", drift_final_m=drift)])
    found = named(compare_figures(card, published()), "100 m square, open loop: drift at the end")
    assert found.verdict == verdict and found.theirs == "83.9 to 87.5 m"


def test_a_fall_is_worse_than_none_and_is_named_beside_the_figure() -> None:
    card = card_of([walked("distance/square_lap_100m", fell=1, drift_final_m=2.0)])
    found = compare_figures(card, published())
    assert named(found, "100 m square, open loop: no fall").verdict == "worse"
    assert "1 of 4 fell" in named(found, "100 m square, open loop: drift at the end").ours


def test_ratios_are_to_the_policys_own_circle() -> None:
    circle = walked("locomotion/circle", yaw_rate_rmse_rad_s=0.2, drift_final_m=2.0)
    ice = walked("friction/icy_floor", yaw_rate_rmse_rad_s=1.0, drift_final_m=2.2)
    found = compare_figures(card_of([circle, ice]), published())
    turning = named(found, "icy floor: RMS error of the yaw rate, times that of the circle")
    assert (turning.verdict, turning.ours) == ("worse", "× 5")
    assert named(found, "icy floor: drift, times that of the circle").verdict == "better"
    fell = compare_figures(card_of([circle, walked("friction/icy_floor", fell=4)]), published())
    assert named(fell, "icy floor: drift, times that of the circle").verdict in BEHIND


def test_what_was_not_run_is_not_measured() -> None:
    card = card_of([walked("grid/a")])
    everything = (*compare_counts(card, published()), *compare_figures(card, published()))
    assert {one.verdict for one in everything} == {"not measured"}
