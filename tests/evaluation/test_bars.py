"""The bars: what they measure, and that each can be met, missed and not measured."""

from __future__ import annotations

import itertools
from dataclasses import replace

import pytest

from asimov_gym.evaluation.bars import BARS, BarResult, judge
from asimov_gym.evaluation.results import SKIPPED, SuiteResult
from tests.evaluation.made_results import push, result, scenario, trial, whole_suite

CORNERS = list(itertools.product((-0.5, 0.8), (-0.4, 0.4), (-0.8, 0.8)))


def bar(made: SuiteResult, name: str) -> BarResult:
    """The one bar whose name begins so."""
    (found,) = [one for one in judge(made) if one.name.startswith(name)]
    return found


def grid(
    error: float = 0.02, seconds: float = 60.0, fell: int = -1, corners: int = 8, repeats: int = 20
) -> SuiteResult:
    """The corners of the command range, some repeats each; repeat 0 of corner `fell` falls."""
    infos = [scenario(f"grid/{i}", corner, repeats, seconds) for i, corner in enumerate(CORNERS[:corners])]
    figures = {"velocity_error_m_s": error, "yaw_rate_error_rad_s": error}
    trials = [
        trial(info, k, figures, fall_s=50.0 if i == fell and k == 0 else None)
        for i, info in enumerate(infos)
        for k in range(repeats)
    ]
    return result(infos, [replace(t, metrics={}) if t.fall_s else t for t in trials])


def test_grid_bars() -> None:
    assert bar(grid(), "survival, every command").verdict == "met"
    assert bar(grid(), "velocity error over a gait").verdict == "met"
    assert bar(grid(0.031), "velocity error over a gait").verdict == "missed"
    assert bar(grid(0.031), "yaw rate error over a gait").verdict == "met"
    assert bar(grid(0.041), "yaw rate error over a gait").verdict == "missed"
    fell = bar(grid(fell=3), "survival, every command")
    assert fell.verdict == "missed" and fell.value == pytest.approx(159 / 160) and "1 fell" in fell.detail


def test_the_grid_must_be_whole_and_its_walks_a_minute() -> None:
    half = bar(grid(corners=4), "velocity error over a gait")
    assert half.verdict == "not measured" and "vx does not span -0.5 to 0.8" in half.detail
    short = bar(grid(seconds=12.0), "survival, every command")
    assert short.verdict == "not measured" and "walks of 12 s" in short.detail
    few = bar(grid(repeats=19), "survival, every command")
    assert few.verdict == "not measured" and "19 repeats are too little" in few.detail
    assert bar(grid(seconds=12.0), "velocity error over a gait").verdict == "met"


def test_a_command_that_fells_every_robot_is_not_left_out_of_a_mean() -> None:
    made = grid()
    made = replace(made, trials=tuple(replace(t, metrics={}) if t.scenario == "grid/5" else t for t in made.trials))
    missed = bar(made, "velocity error over a gait")
    assert missed.verdict == "missed" and missed.value is None and "grid/5" in missed.detail


def test_a_result_that_is_not_complete_can_miss_a_bar_but_not_meet_it() -> None:
    part = replace(grid(), trials=grid().trials[:-1])
    assert bar(part, "survival, every command").verdict == "not measured"
    assert bar(part, "survival, every command").value == 1.0
    assert bar(replace(grid(fell=0), trials=grid(fell=0).trials[:-1]), "survival, every command").verdict == "missed"


def test_standing_bars_take_the_worst_trial() -> None:
    info = scenario("standing/still", repeats=2, seconds=12.0)
    good = {"standing_drift_m": 0.03, "standing_drift_settled_m": 0.004, "standing_steps": 0.0}
    poor = good | {"standing_drift_settled_m": 0.011, "standing_steps": 2.0}
    made = result([info], [trial(info, 0, good), trial(info, 1, good)])
    assert bar(made, "standing: drift").verdict == "met" and bar(made, "standing: steps").verdict == "met"
    made = result([info], [trial(info, 0, good), trial(info, 1, poor)])
    assert bar(made, "standing: drift").value == 0.011 and bar(made, "standing: drift").verdict == "missed"
    assert bar(made, "standing: steps").verdict == "missed"
    fallen = bar(result([info], [trial(info, 0, good), trial(info, 1, fall_s=4.0)]), "standing: drift")
    assert fallen.verdict == "missed" and fallen.value is None


def test_push_bars_need_all_eighteen_rows() -> None:
    infos = [scenario(f"push_standing/{i}", repeats=1) for i in range(18)]
    passed = (push(450, "reasonable", "passed"), push(575, "beyond", "passed", at=8.0))
    failed = (push(450, "reasonable", "passed"), push(575, "beyond", "failed", at=8.0))
    trials = [trial(info, 0, events=passed) for info in infos[:-1]] + [trial(infos[-1], 0, events=failed)]
    made = result(infos, trials)
    assert bar(made, "must-pass pushes").verdict == "met"
    stretch = bar(made, "stretch pushes")
    assert stretch.verdict == "missed" and stretch.aim and stretch.value == pytest.approx(17 / 18)
    assert bar(result(infos[:5], trials[:5]), "must-pass pushes").verdict == "not measured"
    assert bar(result(infos, trials[:17]), "must-pass pushes").verdict == "not measured"


def test_square_bars_tell_open_loop_from_heading_held() -> None:
    infos = [scenario(f"distance/{held}", (0.6, 0, 0), 1, 180.0, hold_heading=held) for held in (False, True)]
    made = result(infos, [trial(infos[0], 0, {"drift_final_m": 83.0}), trial(infos[1], 0, {"drift_final_m": 11.0})])
    assert bar(made, "100 m square, open loop: drift").verdict == "met"
    assert bar(made, "100 m square, heading held: drift").verdict == "missed"
    assert bar(made, "100 m square, heading held: no fall").verdict == "met"
    far = result(infos[:1], [trial(infos[0], 0, {"drift_final_m": 84.0})])
    assert bar(far, "100 m square, open loop: drift").verdict == "missed"  # below theirs, not as far
    assert bar(far, "100 m square, heading held: drift").verdict == "not measured"


def test_ground_bars_take_their_range_only() -> None:
    infos = [
        scenario("friction/icy", (0.5, 0, 0), 1, foot_friction=0.08),
        scenario("friction/wet", (0.5, 0, 0), 1, foot_friction=0.3),
        scenario("friction/wet_floor", (0.5, 0, 0), 1, foot_friction=0.3, fall="vendor"),
        scenario("ground/up", (0.4, 0, 0), 1, terrain="slope:-6"),
        scenario("ground/steep", (0.4, 0, 0), 1, terrain="slope:10"),
        scenario("ground/rough", (0.4, 0, 0), 1, terrain="rough:0.04,1"),
        scenario("terrain/rough", (0.4, 0, 0), 1, terrain="rough"),
    ]
    falls = {"friction/icy", "friction/wet_floor", "ground/steep", "terrain/rough"}
    made = result(infos, [trial(info, 0, fall_s=3.0 if info.id in falls else None) for info in infos])
    for name in ("survival, friction", "survival, slopes", "survival, rough"):
        assert bar(made, name).verdict == "met" and bar(made, name).detail == "1 trial"


def test_physics_bars_compare_the_same_walks() -> None:
    def made(falls: int) -> SuiteResult:
        infos = [scenario(f"physics/{p}", (0.6, 0, 0), 100, physics=p) for p in ("evaluation", "half_step")]
        infos.append(scenario("grid/other", (0.6, 0, 0), 100))
        trials = [
            trial(info, k, fall_s=2.0 if k < (falls if "half" in info.id else 0) or info.config == "grid" else None)
            for info in infos
            for k in range(100)
        ]
        return result(infos, trials)

    assert bar(made(1), "half the time step").verdict == "met"
    assert bar(made(2), "half the time step").verdict == "missed"
    assert bar(made(2), "half the time step").value == pytest.approx(0.02)
    assert bar(made(2), "other solver").verdict == "not measured"


def test_what_a_machine_cannot_run_is_not_measured_and_says_why() -> None:
    info = scenario("physics/mjx", repeats=1, physics="mjx")
    found = bar(result([info], [trial(info, 0, error=f"{SKIPPED}jax is not installed")]), "MJX")
    assert found.verdict == "not measured" and "jax is not installed" in found.detail


def test_every_bar_has_its_scenarios_in_the_standard_suite() -> None:
    """All trials of `standard` passed, with perfect figures: then every bar is met."""
    from asimov_gym.evaluation.metrics import METRICS
    from asimov_gym.evaluation.pushes import push_outcomes
    from asimov_gym.evaluation.suite import load_suite

    suite = load_suite("standard")
    pushes = {s.id: push_outcomes(s.pushes, None) for s in suite.scenarios}
    infos = [s.info() for s in suite.scenarios]
    figures = dict.fromkeys(METRICS, 0.0)
    made = result(infos, [trial(i, k, figures, events=pushes[i.id]) for i in infos for k in range(i.repeats)])
    assert {one.name: one.verdict for one in judge(made)} == {b.name: "met" for b in BARS}


def test_nothing_is_met_by_an_empty_result() -> None:
    assert {one.verdict for one in judge(result([], []))} == {"not measured"}
    assert {one.verdict for one in judge(whole_suite())} == {"met", "missed", "not measured"}
