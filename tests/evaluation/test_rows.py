"""The benchmark's row format: what is read, what is refused and how the refusal reads, and the rows that come along."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

import pytest

from asimov_gym.evaluation.rows import RowError, body_names, parse_row, read_rows
from asimov_gym.evaluation.suite import shipped_rows

ROW: dict[str, Any] = {
    "id": "push_standing/example",
    "config": "push_standing",
    "schema_version": 1,
    "kind": "velocity-sequence",
    "name": "Example",
    "description": "",
    "tags": ["push"],
    "duration": 12.0,
    "commands": [{"t": 0.0, "vx": 0.0, "vy": 0.0, "wz": 0.0}, {"t": 3, "vx": 0.4, "vy": -0.1, "wz": 0.5}],
    "events": [
        {
            "t": 8.0,
            "type": "push",
            "dir": [0, 2],
            "force": 225,
            "duration": 0.15,
            "targetBody": "left_shoulder_pitch_link",
            "torqueAxis": [0, 0, 1],
            "torqueMag": 5,
            "label": "second",
            "tier": "beyond",
        },
        {"t": 2.0, "type": "push", "dir": [1, 0, 0], "force": 100, "duration": 0.15, "targetBody": None, "tier": None},
    ],
    "limits": {"vx": [-0.5, 1.0]},
    "foot_friction": 0.3,
    "metrics_opt_in": ["gait_symmetry"],
}


def _with(path: str, value: Any) -> dict[str, Any]:
    """The row with another value at a path such as `events.0.force`; `...` removes the key."""
    row = copy.deepcopy(ROW)
    place: Any = row
    *parents, last = path.split(".")
    for key in parents:
        place = place[int(key)] if key.isdigit() else place[key]
    if value is ...:
        del place[last]
    else:
        place[last] = value
    return row


def test_every_key_is_read() -> None:
    row = parse_row(ROW, "file.json")
    assert (row.id, row.config, row.name, row.duration) == ("push_standing/example", "push_standing", "Example", 12.0)
    assert [(c.t, c.vx, c.vy, c.wz) for c in row.commands] == [(0, 0, 0, 0), (3, 0.4, -0.1, 0.5)]
    first, second = row.events  # in order of time
    assert (first.t, first.body, first.direction, first.force, first.tier) == (2.0, "pelvis_link", (1, 0, 0), 100, None)
    assert (second.direction, second.torque, second.tier) == ((0.0, 1.0, 0.0), (0.0, 0.0, 5.0), "beyond")
    assert second.body == "left_shoulder_pitch_link" and second.label == "second"
    assert row.limits == (("vx", (-0.5, 1.0)),) and row.foot_friction == 0.3 and row.gait_symmetry


@pytest.mark.parametrize(
    ("path", "value", "field", "allowed"),
    [
        ("schema_version", 2, "schema_version", "1"),
        ("kind", "position", "kind", "velocity-sequence"),
        ("config", "friction", "config", "push_standing"),
        ("config", "swimming", "config", "locomotion"),
        ("id", "push_standing/Upper", "id", "lower-case"),
        ("duration", 0, "duration", "above 0"),
        ("duration", float("nan"), "duration", "a number"),
        ("duration", ..., "duration", "keys id"),
        ("commands", [], "commands", "at least one"),
        ("commands.1.t", 0.0, "commands[1].t", "later than"),
        ("commands.1.t", 13.0, "commands[1].t", "to 12"),
        ("commands.1.vx", 3.0, "commands[1].vx", "-2 to 2"),
        ("commands.1.height", 1.0, "commands[1].height", "only the keys"),
        ("events.0.type", "kick", "events[0].type", "push"),
        ("events.0.dir", [1], "events[0].dir", "2 or 3"),
        ("events.0.dir", [0, 0, 0], "events[0].dir", "not zero"),
        ("events.0.force", 0, "events[0].force", "above 0"),
        ("events.0.duration", 5.0, "events[0].duration", "to 4"),
        ("events.0.force", True, "events[0].force", "a number"),
        ("events.0.tier", "extreme", "events[0].tier", "'reasonable', 'beyond'"),
        ("events.0.strength", 1, "events[0].strength", "only the keys"),
        ("events.1.torqueMag", 3.0, "events[1].torqueMag", "torqueAxis is null"),
        ("limits", {"vx": [0.5, 0.2]}, "limits.vx[0]", "to 0"),
        ("limits", {"vz": [0, 1]}, "limits.vz", "vx, vy, wz"),
        ("foot_friction", 0.0, "foot_friction", "above 0"),
        ("metrics_opt_in", ["grace"], "metrics_opt_in", "gait_symmetry"),
        ("payload", 3.0, "payload", "only the keys"),
    ],
)
def test_what_is_not_of_the_format_is_refused(path: str, value: Any, field: str, allowed: str) -> None:
    with pytest.raises(RowError) as caught:
        parse_row(_with(path, value), "file.json")
    message = str(caught.value)
    assert caught.value.field == field
    assert message.startswith("file.json: row ") and "allowed" in message
    assert allowed in message


def test_an_unknown_body_is_an_error_and_never_the_pelvis() -> None:
    with pytest.raises(RowError, match=r"events\[0\]\.targetBody is 'pelvis'.*pelvis_link.*waist_yaw_link"):
        parse_row(_with("events.0.targetBody", "pelvis"), "file.json")
    assert "world" not in body_names()


def test_a_terrain_row_names_its_course() -> None:
    row = _with("config", "terrain") | {"id": "terrain/example"}
    with pytest.raises(RowError, match="terrain is None"):
        parse_row(row, "file.json")
    assert parse_row(row | {"terrain": "stairs_5cm"}, "file.json").terrain == "stairs_5cm"


OLD: dict[str, Any] = {
    "name": "Shoulder taps",
    "duration": 6,
    "commands": [{"t": 0, "vx": 0.6, "vy": 0, "wz": 0}],
    "events": [{"t": 2, "type": "push", "dir": [1, 0], "force": 175, "duration": 0.15, "label": "left (reasonable)"}],
    "gaitSymmetry": True,
}


def test_older_files_hold_one_test_each(tmp_path: Path) -> None:
    path = tmp_path / "Shoulder taps.json"
    path.write_text(json.dumps(OLD))
    (row,) = read_rows(path)
    assert (row.id, row.config, row.gait_symmetry) == ("push_walking/shoulder_taps", "push_walking", True)
    assert row.events[0].tier == "reasonable" and row.events[0].label == "left (reasonable)"
    still = OLD | {"commands": [{"t": 0, "vx": 0, "vy": 0, "wz": 0}]}
    assert parse_row(still, "a.json").config == "push_standing"
    assert parse_row(OLD | {"footFriction": 0.08}, "a.json").foot_friction == 0.08
    course = parse_row(OLD | {"terrain": "obstacles"}, "a.json")
    assert (course.config, course.terrain) == ("terrain", "obstacles")
    plain = OLD | {"events": []}
    assert parse_row(plain, "a.json").config == "locomotion"


def test_older_files_are_checked_as_strictly() -> None:
    with pytest.raises(RowError, match=r"foot_friction is 0\.3"):
        parse_row(OLD | {"foot_friction": 0.3}, "a.json")  # the newer spelling would be ignored
    both = copy.deepcopy(OLD)
    both["events"][0]["label"] = "reasonable, beyond"
    with pytest.raises(RowError, match="one tier"):
        parse_row(both, "a.json")


def test_files_of_many_rows(tmp_path: Path) -> None:
    second = ROW | {"id": "push_standing/other"}
    lines = tmp_path / "rows.jsonl"
    lines.write_text(json.dumps(ROW) + "\n\n" + json.dumps(second) + "\n")
    assert [row.id for row in read_rows(lines)] == ["push_standing/example", "push_standing/other"]
    twice = tmp_path / "rows.json"
    twice.write_text(json.dumps([ROW, ROW]))
    with pytest.raises(ValueError, match=r"rows\.json: id 'push_standing/example' is there twice"):
        read_rows(twice)
    twice.write_text("[]")
    with pytest.raises(ValueError, match="holds no row"):
        read_rows(twice)
    twice.write_text("{")
    with pytest.raises(ValueError, match="not JSON"):
        read_rows(twice)
    with pytest.raises(FileNotFoundError, match="no file of benchmark rows"):
        read_rows(tmp_path / "absent.json")


def test_the_published_rows() -> None:
    rows = shipped_rows()
    counts = {
        config: sum(row.config == config for row in rows.values()) for config in {r.config for r in rows.values()}
    }
    assert counts == {
        "locomotion": 2,
        "distance": 1,
        "push_standing": 10,
        "push_walking": 8,
        "push_sustained": 1,
        "friction": 2,
        "terrain": 7,
    }
    pushes = [row for row in rows.values() if row.config in ("push_standing", "push_walking")]
    for row in pushes:
        must, stretch = row.events
        assert [(e.t, e.duration, e.tier) for e in (must, stretch)] == [(2, 0.15, "reasonable"), (8, 0.15, "beyond")]
        assert must.body == stretch.body and must.direction == stretch.direction and must.force < stretch.force
        assert row.commands[0].vx == (0.6 if row.config == "push_walking" else 0.0)

    def forces(config: str, body: str, direction: tuple[float, float, float]) -> list[float]:
        (row,) = [
            r for r in pushes if r.config == config and r.events[0].body == body and r.events[0].direction == direction
        ]
        return [event.force for event in row.events]

    front, left, right, down = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)
    assert forces("push_standing", "pelvis_link", left) == [450, 575]
    assert forces("push_standing", "waist_yaw_link", front) == [250, 350]
    assert forces("push_standing", "right_shoulder_pitch_link", front) == [175, 275]
    assert forces("push_standing", "left_shoulder_pitch_link", left) == [225, 375]
    assert forces("push_standing", "right_shoulder_pitch_link", right) == [225, 300]
    assert forces("push_walking", "pelvis_link", (-1.0, 0.0, 0.0)) == [450, 575]
    assert forces("push_walking", "left_shoulder_pitch_link", down) == [850, 1200]
    assert forces("push_walking", "right_shoulder_pitch_link", right) == [150, 225]

    lap = rows["distance/square_lap_100m"]
    ends = [*(c.t for c in lap.commands[1:]), lap.duration]
    spans = [(b - c.t, c) for c, b in zip(lap.commands, ends, strict=True)]
    assert sum(span * c.vx for span, c in spans) == pytest.approx(100.0, abs=0.01)
    assert sum(span * c.wz for span, c in spans) == pytest.approx(2 * 3.14159, abs=0.01)
    assert rows["friction/icy_floor"].foot_friction == 0.08 and rows["friction/icy_floor"].events[0].force == 100
    assert [e.force for e in rows["push_sustained/pelvis_lateral_ramp"].events] == [110, 190, 260, 340]
