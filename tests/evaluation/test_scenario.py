"""Scenarios, their conditions and the seeds of their repeats."""

from __future__ import annotations

import json

import numpy as np
import pytest

from asimov_gym.evaluation.rows import Command, Push
from asimov_gym.evaluation.scenario import Conditions, Scenario, Trial, scenario_of_row, trial_seed
from asimov_gym.evaluation.suite import shipped_rows


def _scenario(**figures: object) -> Scenario:
    given = {"id": "a/b", "config": "a", "duration_s": 1.0, "commands": (Command(0.0, 0.5, 0.0, 0.0),)}
    return Scenario(**{**given, **figures})


def test_commands_hold_until_the_next_one() -> None:
    commands = (Command(0.1, 0.5, 0.1, 0.2), Command(0.51, 0.0, 0.0, -0.3))
    rows = _scenario(commands=commands).command_rows()
    assert rows.shape == (50, 3)
    np.testing.assert_array_equal(rows[:5], 0.0)
    np.testing.assert_array_equal(rows[5:26], np.tile([0.5, 0.1, 0.2], (21, 1)))
    np.testing.assert_array_equal(rows[26:], np.tile([0.0, 0.0, -0.3], (24, 1)))  # 0.51 s lies within step 25


def test_stand_ends_the_commands() -> None:
    walk = _scenario(commands=(Command(0.0, 0.5, 0.0, 0.0),), stand_at_s=0.5)
    assert walk.stand_step == 25 and _scenario().stand_step == _scenario().steps == 50
    np.testing.assert_array_equal(walk.command_rows()[:, 0], [0.5] * 25 + [0.0] * 25)
    assert walk.info().stand_at_s == 0.5 and _scenario().info().stand_at_s is None
    with pytest.raises(ValueError, match=r"a/b: stand_at_s must lie in \[0\.02, 0\.98\], got 1"):
        _scenario(stand_at_s=1.0)
    with pytest.raises(ValueError, match=r"commands must come before stand_at_s 0\.5, got 0\.5"):
        _scenario(commands=(Command(0.0, 0.5, 0.0, 0.0), Command(0.5, 0.0, 0.0, 0.0)), stand_at_s=0.5)


def test_seeds_are_stable_and_spread_the_delays() -> None:
    # The value itself: it must be the same on every machine and in every version, or results cannot be compared.
    assert trial_seed(0, "grid/walk", 0) == 1162471741467816
    seeds = [trial_seed(0, "grid/walk", repeat) for repeat in range(60)]
    assert len(set(seeds)) == 60 and max(seeds) < 2**53
    assert [seed % 6 for seed in seeds] == [repeat % 6 for repeat in range(60)]
    assert trial_seed(1, "grid/walk", 0) != trial_seed(0, "grid/walk", 0) != trial_seed(0, "grid/walk2", 0)


def test_delay_by_seed_drawn_and_fixed() -> None:
    by_seed = [Trial.of(_scenario(), repeat, 0).delay_ms for repeat in range(12)]
    assert by_seed == [0.0, 5.0, 10.0, 15.0, 20.0, 25.0] * 2
    drawing = _scenario(conditions=Conditions(delay="drawn"))
    drawn = [Trial.of(drawing, repeat, 0).delay_ms for repeat in range(200)]
    # Physics steps of 5 ms: drawn in policy steps of 20 ms they would reach 100 ms.
    assert set(drawn) == {0.0, 5.0, 10.0, 15.0, 20.0, 25.0}
    assert drawn == [Trial.of(drawing, repeat, 0).delay_ms for repeat in range(200)]
    assert Trial.of(_scenario(conditions=Conditions(delay=15)), 3, 0).delay_ms == 15.0


def test_draws_of_one_use_do_not_depend_on_another() -> None:
    trial = Trial.of(_scenario(), 0, 0)
    first = trial.generator("start").random(3)
    trial.generator("noise").random(7)
    np.testing.assert_array_equal(trial.generator("start").random(3), first)
    assert not np.array_equal(trial.generator("noise").random(3), first)


@pytest.mark.parametrize(
    ("figures", "message"),
    [
        ({"delay": 12.0}, r"delay must be whole physics steps of 5 ms, got 12.0"),
        ({"delay": 100.0}, r"delay must lie in \[0, 40\], got 100"),
        ({"delay": "late"}, "delay must be 'by_seed', 'drawn' or 0 to 40 ms, got 'late'"),
        ({"noise": -1.0}, r"noise must lie in \[0, 10\]"),
        ({"payload_kg": 50.0}, r"payload_kg must lie in \[-5, 20\]"),
        ({"motor_strength": 0.0}, r"motor_strength must lie in \[0.05, 1\]"),
        ({"motor_strength": 0.5, "weak_joints": ("left_wing",)}, "unknown joints.*left_wing.*known: left_hip"),
        ({"weak_joints": ("left_knee_joint",)}, "weak_joints needs a motor_strength below 1"),
        ({"foot_friction": 0.0}, "foot_friction must lie in"),
        ({"terrain": "lava"}, "terrain 'lava' is unknown; known terrains: flat"),
        ({"fall": "soft"}, "fall must be one of firmware, vendor, got 'soft'"),
        ({"physics": "ode"}, "physics must be one of evaluation, half_step.*got 'ode'"),
        ({"physics": "mjx", "terrain": "rough"}, "'mjx' takes flat terrain"),
    ],
)
def test_bad_conditions_name_the_field(figures: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Conditions(**figures)


def test_half_a_time_step_allows_half_the_delay() -> None:
    assert Conditions(delay=2.5, physics="half_step").delay == 2.5


def test_bad_scenarios_name_the_field() -> None:
    with pytest.raises(ValueError, match="id must read 'a/<name>', got 'b/c'"):
        _scenario(id="b/c")
    with pytest.raises(ValueError, match="a/b: repeats must be a whole number"):
        _scenario(repeats=0)
    with pytest.raises(ValueError, match=r"a/b: vy must lie in \[-1, 1\]"):
        _scenario(commands=(Command(0.0, 0.0, 2.0, 0.0),))
    with pytest.raises(ValueError, match="unknown body 'pelvis'; known: pelvis_link"):
        _scenario(pushes=(Push(0.1, 0.1, 1.0, (1.0, 0.0, 0.0), "pelvis"),))
    with pytest.raises(ValueError, match="a/b: push end must lie in"):
        _scenario(pushes=(Push(0.9, 0.2, 1.0, (1.0, 0.0, 0.0)),))
    with pytest.raises(ValueError, match="pushes need physics on the C engine"):
        _scenario(pushes=(Push(0.1, 0.1, 1.0, (1.0, 0.0, 0.0)),), conditions=Conditions(physics="mjx"))


def test_a_row_as_scenario_keeps_its_conditions() -> None:
    rows = shipped_rows()
    ice = scenario_of_row(rows["friction/icy_floor"])
    assert (ice.conditions.foot_friction, ice.conditions.delay, ice.conditions.fall) == (0.08, "drawn", "vendor")
    assert len(ice.pushes) == 1 and ice.steps == 1300 and not ice.stands
    stairs = scenario_of_row(rows["terrain/stairs_10cm"], Conditions(noise=1.0), repeats=2)
    assert (stairs.conditions.terrain, stairs.conditions.noise, stairs.repeats) == ("stairs_10cm", 1.0, 2)
    assert scenario_of_row(rows["push_standing/chest_front"]).stands


def test_info_is_plain_data() -> None:
    info = _scenario(limits=(("vx", (-1.0, 1.0)),)).info()
    assert info.conditions["delay"] == "by_seed" and info.conditions["physics"] == "evaluation"
    assert info.conditions["limits"] == {"vx": [-1.0, 1.0]}
    assert info.commands == ((0.0, 0.5, 0.0, 0.0),)
    json.dumps(info.conditions, allow_nan=False)
