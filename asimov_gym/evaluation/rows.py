"""Tests in the row format of the robot maker's locomotion benchmark, read strictly.

A file holds one row (a JSON object), several (a JSON list), or one a line (`.jsonl`). Every key is checked; one that is
not known is an error, because a condition that is silently ignored makes a result that means nothing. Files from before
the format had a version hold one test each; they are read too (`read_rows` says how).
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from asimov_gym.evaluation.results import Tier
from asimov_gym.robot.model import robot_spec

SCHEMA_VERSION = 1
KIND = "velocity-sequence"
CONFIGS = ("locomotion", "distance", "push_standing", "push_walking", "push_sustained", "friction", "terrain")
"""Categories of the benchmark."""
TIERS: tuple[Tier, ...] = ("reasonable", "beyond")
DEFAULT_BODY = "pelvis_link"
"""Pushed when a row names no body. A body that the robot does not have is an error, never this one."""
GAIT_SYMMETRY = "gait_symmetry"
AXES = ("vx", "vy", "wz")
COMMAND_BOUNDS = {"vx": 2.0, "vy": 1.0, "wz": 2.0}
"""Largest magnitude of a command that the robot's interface takes, m/s and rad/s."""
MAX_DURATION_S = 3600.0
MAX_FORCE_N = 10_000.0
MAX_TORQUE_NM = 1000.0
MAX_FRICTION = 5.0

_ID = re.compile(r"[a-z0-9_]+/[a-z0-9_]+")
_ROW_KEYS = ("id", "config", "schema_version", "kind", "name", "duration", "commands", "events")
_ROW_OPTIONAL = ("description", "tags", "limits", "foot_friction", "metrics_opt_in", "terrain")
_OLD_KEYS = ("name", "duration", "commands", "events")
_OLD_OPTIONAL = ("description", "footFriction", "gaitSymmetry", "terrain")
_EVENT_KEYS = ("t", "type", "dir", "force", "duration")
_EVENT_OPTIONAL = ("targetBody", "torqueAxis", "torqueMag", "label", "tier")


class RowError(ValueError):
    """A row that cannot be run as it is written; names file, row, field, value and what is allowed."""

    def __init__(self, source: str, row: str, field: str, value: Any, allowed: str) -> None:
        super().__init__(f"{source}: row {row}: {field} is {value!r}, allowed: {allowed}")
        self.field = field


@dataclass(frozen=True)
class Command:
    """A velocity command, held until the next one."""

    t: float
    """s."""
    vx: float
    vy: float
    wz: float
    """rad/s."""


@dataclass(frozen=True)
class Push:
    """A force, and perhaps a torque, on one body at its centre of mass."""

    t: float
    """Begin, s."""
    duration: float
    """s."""
    force: float
    """N."""
    direction: tuple[float, float, float]
    """World frame, unit vector; the robot faces +x at the start."""
    body: str = DEFAULT_BODY
    torque: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """World frame, N·m."""
    label: str = ""
    tier: Tier | None = None


@dataclass(frozen=True)
class Row:
    """One test of the benchmark, checked."""

    id: str
    config: str
    name: str
    duration: float
    """s."""
    commands: tuple[Command, ...]
    events: tuple[Push, ...]
    description: str = ""
    tags: tuple[str, ...] = ()
    limits: tuple[tuple[str, tuple[float, float]], ...] = ()
    """Axis and range: taken instead of the range that the policy was trained for."""
    foot_friction: float | None = None
    """Sliding friction of the soles; None: the robot's own."""
    gait_symmetry: bool = False
    """Straight steady walking, of which the symmetry of the gait is to be measured."""
    terrain: str | None = None
    """Course; None: flat ground."""


@cache
def body_names() -> tuple[str, ...]:
    """Bodies of the robot that can be pushed."""
    return tuple(body.name for body in robot_spec(visuals=False).bodies if body.name != "world")


def read_rows(path: Path) -> tuple[Row, ...]:
    """All rows of a file.

    A test without `schema_version` is of the older form: `footFriction`, `gaitSymmetry` and `terrain` at the top, the
    tier as a word in a push's label, and no id. It gets the file's name as its own, and its category from its content:
    terrain, friction, pushes (standing or walking), else locomotion.

    Raises:
        FileNotFoundError: there is no such file.
        RowError: a row cannot be run as it is written.
        ValueError: the file is not JSON, empty, or has an id twice; names it.
    """
    if not path.is_file():
        raise FileNotFoundError(f"no file of benchmark rows at {path}")
    text = path.read_text(encoding="utf-8")
    try:
        if path.suffix == ".jsonl":
            data = [json.loads(line) for line in text.splitlines() if line.strip()]
        else:
            data = json.loads(text)
    except json.JSONDecodeError as error:
        raise ValueError(f"{path}: not JSON: {error}") from error
    entries = data if isinstance(data, list) else [data]
    if not entries:
        raise ValueError(f"{path}: holds no row")
    rows = tuple(parse_row(entry, path.name, index) for index, entry in enumerate(entries))
    seen: set[str] = set()
    for row in rows:
        if row.id in seen:
            raise ValueError(f"{path}: id {row.id!r} is there twice")
        seen.add(row.id)
    return rows


def parse_row(data: Any, source: str, index: int = 0) -> Row:
    """One row from plain data.

    Args:
        data: the row as JSON gives it.
        source: file, for messages and as the name of a test of the older form.
        index: place in the file, for messages about rows without an id.

    Raises:
        RowError: something about it is not as the format says.
    """
    if not isinstance(data, Mapping):
        raise RowError(source, f"#{index}", "row", data, "an object")
    check = _Checker(source, str(data.get("id", f"#{index}")))
    if "schema_version" not in data and "id" not in data:
        return _old_row(data, check, source)
    check.keys("row", data, _ROW_KEYS, _ROW_OPTIONAL)
    if data["schema_version"] != SCHEMA_VERSION or isinstance(data["schema_version"], bool):
        raise check.error("schema_version", data["schema_version"], str(SCHEMA_VERSION))
    check.one_of("kind", data["kind"], (KIND,))
    config = check.one_of("config", data["config"], CONFIGS)
    name_id = check.text("id", data["id"])
    if not _ID.fullmatch(name_id):
        raise check.error("id", name_id, "`<config>/<name>` of lower-case letters, digits and `_`")
    if name_id.split("/")[0] != config:
        raise check.error("config", config, f"{name_id.split('/')[0]!r}, the part of the id before `/`")
    duration = check.number("duration", data["duration"], above=0.0, high=MAX_DURATION_S)
    opted = check.sequence("metrics_opt_in", _given(data, "metrics_opt_in", ()))
    for entry in opted:
        check.one_of("metrics_opt_in", entry, (GAIT_SYMMETRY,))
    terrain = check.optional_text("terrain", data.get("terrain"))
    if config == "terrain" and terrain is None:
        raise check.error("terrain", None, "the name of a course, in a row of the category terrain")
    return Row(
        id=name_id,
        config=config,
        name=check.text("name", data["name"]),
        duration=duration,
        commands=_commands(data["commands"], duration, check),
        events=_events(data["events"], duration, check, tier_in_label=False),
        description=check.text("description", _given(data, "description", "")),
        tags=tuple(check.text("tags", tag) for tag in check.sequence("tags", _given(data, "tags", ()))),
        limits=_limits(data.get("limits"), check),
        foot_friction=_friction("foot_friction", data.get("foot_friction"), check),
        gait_symmetry=GAIT_SYMMETRY in opted,
        terrain=terrain,
    )


def _old_row(data: Mapping[str, Any], check: _Checker, source: str) -> Row:
    check.keys("row", data, _OLD_KEYS, _OLD_OPTIONAL)
    duration = check.number("duration", data["duration"], above=0.0, high=MAX_DURATION_S)
    commands = _commands(data["commands"], duration, check)
    events = _events(data["events"], duration, check, tier_in_label=True)
    friction = _friction("footFriction", data.get("footFriction"), check)
    terrain = check.optional_text("terrain", data.get("terrain"))
    symmetry = data.get("gaitSymmetry", False)
    if not isinstance(symmetry, bool):
        raise check.error("gaitSymmetry", symmetry, "true or false")
    if terrain is not None:
        config = "terrain"
    elif friction is not None:
        config = "friction"
    elif any(event.tier is not None for event in events):
        walks = any((command.vx, command.vy, command.wz) != (0.0, 0.0, 0.0) for command in commands)
        config = "push_walking" if walks else "push_standing"
    else:
        config = "locomotion"
    slug = re.sub(r"[^a-z0-9]+", "_", Path(source).stem.lower()).strip("_") or "test"
    return Row(
        id=f"{config}/{slug}",
        config=config,
        name=check.text("name", data["name"]),
        duration=duration,
        commands=commands,
        events=events,
        description=check.text("description", _given(data, "description", "")),
        foot_friction=friction,
        gait_symmetry=symmetry,
        terrain=terrain,
    )


def _commands(value: Any, duration: float, check: _Checker) -> tuple[Command, ...]:
    entries = check.sequence("commands", value)
    if not entries:
        raise check.error("commands", value, "at least one command")
    commands: list[Command] = []
    for i, entry in enumerate(entries):
        place = f"commands[{i}]"
        check.keys(place, entry, ("t", *AXES), ())
        t = check.number(f"{place}.t", entry["t"], low=0.0, high=duration)
        if commands and t <= commands[-1].t:
            raise check.error(f"{place}.t", t, f"later than the command before it, at {commands[-1].t:g} s")
        speeds = [check.number(f"{place}.{a}", entry[a], low=-COMMAND_BOUNDS[a], high=COMMAND_BOUNDS[a]) for a in AXES]
        commands.append(Command(t, *speeds))
    return tuple(commands)


def _events(value: Any, duration: float, check: _Checker, *, tier_in_label: bool) -> tuple[Push, ...]:
    events = [
        _event(f"events[{i}]", entry, duration, check, tier_in_label)
        for i, entry in enumerate(check.sequence("events", value))
    ]
    return tuple(sorted(events, key=lambda event: event.t))


def _event(place: str, entry: Any, duration: float, check: _Checker, tier_in_label: bool) -> Push:
    check.keys(place, entry, _EVENT_KEYS, _EVENT_OPTIONAL)
    check.one_of(f"{place}.type", entry["type"], ("push",))
    begin = check.number(f"{place}.t", entry["t"], low=0.0, high=duration)
    # A push that the end of the row cuts short would have less than its impulse.
    held = check.number(f"{place}.duration", entry["duration"], above=0.0, high=duration - begin)
    label = check.text(f"{place}.label", _given(entry, "label", ""))
    tier: Tier | None = entry.get("tier")
    if tier is not None:
        check.one_of(f"{place}.tier", tier, (*TIERS, None))
    elif tier_in_label:
        named: list[Tier] = [known for known in TIERS if re.search(rf"\b{known}\b", label.lower())]
        if len(named) > 1:
            raise check.error(f"{place}.label", label, "one tier in a label, not both")
        tier = named[0] if named else None
    body = entry.get("targetBody")
    if body is None:
        body = DEFAULT_BODY
    elif body not in body_names():
        raise check.error(f"{place}.targetBody", body, f"null ({DEFAULT_BODY}) or one of {', '.join(body_names())}")
    return Push(
        t=begin,
        duration=held,
        force=check.number(f"{place}.force", entry["force"], above=0.0, high=MAX_FORCE_N),
        direction=check.direction(f"{place}.dir", entry["dir"], (2, 3)),
        body=body,
        torque=_torque(place, entry.get("torqueAxis"), entry.get("torqueMag"), check),
        label=label,
        tier=tier,
    )


def _torque(place: str, axis: Any, magnitude: Any, check: _Checker) -> tuple[float, float, float]:
    if axis is None:
        if magnitude not in (None, 0, 0.0):
            raise check.error(f"{place}.torqueMag", magnitude, "null or 0 where torqueAxis is null")
        return (0.0, 0.0, 0.0)
    size = check.number(f"{place}.torqueMag", magnitude, low=0.0, high=MAX_TORQUE_NM)
    x, y, z = check.direction(f"{place}.torqueAxis", axis, (3,))
    return (size * x, size * y, size * z)


def _limits(value: Any, check: _Checker) -> tuple[tuple[str, tuple[float, float]], ...]:
    if value is None:
        return ()
    check.keys("limits", value, (), AXES)
    limits = []
    for axis in (a for a in AXES if a in value):
        bound = COMMAND_BOUNDS[axis]
        pair = check.sequence(f"limits.{axis}", value[axis])
        if len(pair) != 2:
            raise check.error(f"limits.{axis}", value[axis], "a pair [low, high]")
        # The range holds 0, else clamping would turn "stand still" into a walk.
        low = check.number(f"limits.{axis}[0]", pair[0], low=-bound, high=0.0)
        high = check.number(f"limits.{axis}[1]", pair[1], low=0.0, high=bound)
        limits.append((axis, (low, high)))
    return tuple(limits)


def _given(data: Mapping[str, Any], key: str, default: Any) -> Any:
    """The value of an optional key; the default where it is missing or null."""
    value = data.get(key)
    return default if value is None else value


def _friction(field: str, value: Any, check: _Checker) -> float | None:
    return None if value is None else check.number(field, value, above=0.0, high=MAX_FRICTION)


@dataclass(frozen=True)
class _Checker:
    """Checks of values that know which file and row they belong to."""

    source: str
    row: str

    def error(self, field: str, value: Any, allowed: str) -> RowError:
        return RowError(self.source, self.row, field, value, allowed)

    def keys(self, place: str, data: Any, needed: Sequence[str], optional: Sequence[str]) -> None:
        if not isinstance(data, Mapping):
            raise self.error(place, data, "an object")
        for key in needed:
            if key not in data:
                raise self.error(place if place != "row" else key, "missing", f"the keys {', '.join(needed)}")
        unknown = sorted(set(map(str, data)) - set(needed) - set(optional))
        if unknown:
            field = unknown[0] if place == "row" else f"{place}.{unknown[0]}"
            raise self.error(field, data[unknown[0]], f"only the keys {', '.join((*needed, *optional))}")

    def number(
        self,
        field: str,
        value: Any,
        *,
        low: float = -math.inf,
        above: float = -math.inf,
        high: float = math.inf,
    ) -> float:
        sound = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
        if not sound or not low <= value <= high or not value > above:
            bound = f"above {above:g}" if above > -math.inf else f"from {low:g}"
            raise self.error(field, value, f"a number {bound} to {high:g}")
        return float(value)

    def sequence(self, field: str, value: Any) -> Sequence[Any]:
        if not isinstance(value, list | tuple):
            raise self.error(field, value, "a list")
        return value

    def direction(self, field: str, value: Any, lengths: tuple[int, ...]) -> tuple[float, float, float]:
        entries = self.sequence(field, value)
        if len(entries) not in lengths:
            raise self.error(field, value, f"{' or '.join(map(str, lengths))} numbers")
        numbers = [self.number(f"{field}[{i}]", entry, low=-1e6, high=1e6) for i, entry in enumerate(entries)]
        x, y, z = (*numbers, 0.0)[:3]
        length = math.sqrt(x * x + y * y + z * z)
        if length == 0.0:
            raise self.error(field, value, "a direction that is not zero")
        return (x / length, y / length, z / length)

    def text(self, field: str, value: Any) -> str:
        if not isinstance(value, str):
            raise self.error(field, value, "text")
        return value

    def optional_text(self, field: str, value: Any) -> str | None:
        return None if value is None else self.text(field, value)

    def one_of(self, field: str, value: Any, options: Sequence[Any]) -> Any:
        if isinstance(value, bool) or value not in options:
            raise self.error(field, value, ", ".join(map(repr, options)))
        return value
