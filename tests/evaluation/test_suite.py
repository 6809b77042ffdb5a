"""Suite files: how they expand, what is refused, and the suites that come along."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import yaml

from asimov_gym.evaluation.suite import load_suite, parse_suite, suite_names, suite_of_rows
from asimov_gym.evaluation.variants import VARIANTS

WALK: dict[str, Any] = {"config": "walk", "walks": {"forward": [0.5, 0, 0]}, "duration": 2}


def _suite(*entries: dict[str, Any], **rest: Any) -> dict[str, Any]:
    return {"scenarios": list(entries), **rest}


def test_a_grid_is_every_combination_but_standing() -> None:
    grid = {"config": "grid", "grid": {"vx": [-0.5, 0, 0.5], "wz": [0, 0.8]}, "duration": 10, "repeats": 3}
    suite = parse_suite(_suite(grid), "mine")
    assert [s.id for s in suite.scenarios] == [
        "grid/vx-0.50_vy+0.00_wz+0.00",
        "grid/vx-0.50_vy+0.00_wz+0.80",
        "grid/vx+0.00_vy+0.00_wz+0.80",
        "grid/vx+0.50_vy+0.00_wz+0.00",
        "grid/vx+0.50_vy+0.00_wz+0.80",
    ]
    command = suite.scenarios[1].commands[0]
    assert (command.t, command.vx, command.vy, command.wz) == (0.0, -0.5, 0.0, 0.8)
    assert len(suite.trials) == 15 and suite.robot_seconds == 150.0


def test_what_varies_is_combined() -> None:
    entry = WALK | {"vary": {"delay": [0, "drawn"], "terrain": ["flat", "slope:6"]}, "conditions": {"noise": 1}}
    suite = parse_suite(_suite(entry, repeats=7), "mine")
    assert [(s.id, s.conditions.delay, s.conditions.terrain) for s in suite.scenarios] == [
        ("walk/forward_delay_0_terrain_flat", 0.0, "flat"),
        ("walk/forward_delay_0_terrain_slope:6", 0.0, "slope:6"),
        ("walk/forward_delay_drawn_terrain_flat", "drawn", "flat"),
        ("walk/forward_delay_drawn_terrain_slope:6", "drawn", "slope:6"),
    ]
    assert all(s.conditions.noise == 1.0 and s.repeats == 7 for s in suite.scenarios)


def test_commands_over_time_and_rows() -> None:
    entry = {"config": "walk", "walks": {"zigzag": [[0, 0.4, 0, 0.2], [2, 0.4, 0, -0.2]]}, "duration": 4}
    held = {"rows": ["distance"], "suffix": "held", "conditions": {"hold_heading": True}}
    suite = parse_suite(_suite(entry, {"rows": ["distance", "friction/icy_floor"]}, held), "mine")
    assert [s.id for s in suite.scenarios] == [
        "walk/zigzag",
        "distance/square_lap_100m",
        "friction/icy_floor",
        "distance/square_lap_100m_held",
    ]
    assert [c.t for c in suite.scenarios[0].commands] == [0.0, 2.0]
    lap, ice, held_lap = suite.scenarios[1:]
    assert lap.conditions.delay == "drawn" and lap.conditions.fall == "vendor" and not lap.conditions.hold_heading
    assert ice.conditions.foot_friction == 0.08
    assert held_lap.conditions.hold_heading and held_lap.conditions.fall == "vendor"


def test_push_limits_expand() -> None:
    limits = {"bodies": ["pelvis_link", "waist_yaw_link"], "directions_deg": [0, 90], "speeds": [0, 0.6], "max_n": 500}
    suite = parse_suite({"push_limits": [limits], "repeats": 4}, "mine")
    assert len(suite.push_limits) == 8 and suite.push_limits[0].repeats == 4 and suite.push_limits[0].max_n == 500.0
    assert len({search.id for search in suite.push_limits}) == 8


def test_the_hash_is_of_what_is_asked() -> None:
    base = parse_suite(_suite(WALK), "mine")
    same = parse_suite(_suite(WALK | {"description": "words"}, description="words"), "other name")
    assert base.hash == same.hash
    changes = [
        _suite(WALK, seed=1),
        _suite(WALK, repeats=6),
        _suite(WALK | {"duration": 3}),
        _suite(WALK | {"walks": {"forward": [0.4, 0, 0]}}),
        _suite(WALK | {"conditions": {"noise": 0.5}}),
        _suite(WALK | {"conditions": {"physics": "cg"}}),
        _suite(WALK | {"stand_at": 1}),
    ]
    assert len({base.hash, *(parse_suite(change, "mine").hash for change in changes)}) == 8
    assert base.with_repeats(6).hash == parse_suite(changes[1], "mine").hash


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({"scenario": []}, r"suite has unknown keys \['scenario'\]; known keys: description, seed"),
        ({}, "scenarios must not be empty"),
        (_suite(WALK, seed=-1), "seed must be a whole number"),
        (_suite(WALK, WALK), "'walk/forward' is there twice"),
        (_suite(WALK, traces=["walk/back"]), r"traces names unknown scenarios \['walk/back'\]"),
        (_suite({"config": "walk", "duration": 1}), r"scenarios\[0\] must have exactly one of grid, walks, rows"),
        (_suite(WALK | {"time": 3}), r"scenarios\[0\] has unknown keys \['time'\]"),
        (_suite({"walks": WALK["walks"], "duration": 2}), r"scenarios\[0\].config is missing"),
        (_suite(WALK | {"walks": {"forward": [0.5, 0]}}), r"walks.forward must be \[vx, vy, wz\]"),
        (_suite(WALK | {"walks": {"forward": [9, 0, 0]}}), r"walk/forward: vx must lie in \[-2, 2\], got 9"),
        (_suite(WALK | {"conditions": {"wind": 3}}), r"scenarios\[0\].conditions has unknown keys \['wind'\]"),
        (_suite(WALK | {"conditions": {"noise": "loud"}}), "noise must be a number, got 'loud'"),
        (_suite(WALK | {"vary": {"delay": [3]}}), r"scenarios\[0\].vary: conditions.delay must be whole physics steps"),
        (_suite(WALK | {"vary": {"terrain": ["moon"]}}), "terrain 'moon' is unknown"),
        (_suite(WALK | {"vary": {"delay": 5}}), r"scenarios\[0\].vary.delay must be a list, got 5"),
        (_suite(WALK | {"repeats": 0}), "repeats must be a whole number"),
        (_suite({"rows": ["swimming"]}), r"scenarios\[0\].rows: 'swimming' is unknown; known: all, distance"),
        (_suite(WALK | {"stand_at": "late"}), r"scenarios\[0\].stand_at must be a number, got 'late'"),
        (_suite({"rows": ["distance"], "stand_at": 3}), "stand_at is not allowed beside rows"),
        (_suite({"rows": ["distance"], "duration": 3}), "duration is not allowed beside rows"),
        ({"push_limits": [{"bodies": ["tail"], "directions_deg": [0], "speeds": [0]}]}, "unknown body 'tail'"),
        ({"push_limits": [{"bodies": ["pelvis_link"], "speeds": [0]}]}, "directions_deg is missing"),
    ],
)
def test_bad_suites_name_the_place(data: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        parse_suite(data, "mine")


def test_files_and_names(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(_suite(WALK)))
    assert load_suite(path).name == "mine"
    path.write_text("scenarios: [")
    with pytest.raises(ValueError, match=r"mine.yaml is not valid YAML"):
        load_suite(path)
    path.write_text("scenarios: 3")
    with pytest.raises(ValueError, match=r"mine.yaml: scenarios must be a list, got 3"):
        load_suite(path)
    with pytest.raises(ValueError, match="suite 'quack' is unknown; known suites: commands, full, physics"):
        load_suite("quack")
    with pytest.raises(FileNotFoundError, match="no suite file at"):
        load_suite(tmp_path / "absent.yaml")


def test_shipped_suites_and_their_size() -> None:
    assert set(suite_names()) == {"commands", "full", "physics", "quick", "smoke", "standard", "vendor"}
    suites = {name: load_suite(name) for name in suite_names()}
    assert all(suite.description for suite in suites.values())
    # About 400 robots are simulated in real time on two cores: `quick` stays under a minute with them.
    assert suites["smoke"].robot_seconds < 100
    assert suites["quick"].robot_seconds < 4000
    assert len(suites["vendor"].scenarios) == 31 and all(s.repeats == 5 for s in suites["vendor"].scenarios)


def test_standard_holds_what_every_bar_needs() -> None:
    standard = {s.id: s for s in load_suite("standard").scenarios}
    grid = [s for s in standard.values() if s.config == "grid"]
    assert all(s.duration_s == 60 and s.repeats == 20 and s.conditions.delay == "by_seed" for s in grid)
    for axis, low, high in (("vx", -0.5, 0.8), ("vy", -0.4, 0.4), ("wz", -0.8, 0.8)):
        values = {getattr(s.commands[0], axis) for s in grid}
        assert (min(values), max(values)) == (low, high)
    conditions = [s.conditions for s in standard.values()]
    assert {c.delay for c in conditions} >= {0.0, 5.0, 10.0, 15.0, 20.0, 25.0}
    assert {c.foot_friction for c in conditions} >= {0.08, 0.3, 1.2}
    assert {c.terrain for c in conditions} >= {"slope:6", "slope:-6", "rough:0.02", "rough:0.04"}
    assert {c.physics for c in conditions} >= {"evaluation", "half_step", "cg", "mjx", "feet_only"} <= set(VARIANTS)
    assert {s.conditions.hold_heading for s in standard.values() if s.config == "distance"} == {False, True}
    assert any(c.noise for c in conditions) and any(c.payload_kg for c in conditions)
    assert any(c.motor_strength < 1 for c in conditions)
    assert load_suite("full").robot_seconds > 2 * load_suite("standard").robot_seconds


def test_rows_of_a_file_are_a_suite(tmp_path: Path) -> None:
    row = {
        "id": "locomotion/mine",
        "config": "locomotion",
        "schema_version": 1,
        "kind": "velocity-sequence",
        "name": "Mine",
        "duration": 3,
        "commands": [{"t": 0, "vx": 0.3, "vy": 0, "wz": 0}],
        "events": [],
    }
    path = tmp_path / "rows.json"
    path.write_text(json.dumps(row))
    suite = suite_of_rows(path, repeats=2)
    assert suite.name == "rows" and [s.id for s in suite.scenarios] == ["locomotion/mine"]
    assert suite.scenarios[0].conditions.fall == "vendor" and len(suite.trials) == 2
