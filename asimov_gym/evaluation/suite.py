"""Suites: what a policy is judged by, expanded from a compact YAML file.

A suite file has the keys `description`, `seed`, `repeats` (of every entry that has none of its own), `traces` (ids of
scenarios of which repeat 0 is kept whole), `scenarios` and `push_limits`. An entry of `scenarios` is one of

* `grid: {vx: [...], vy: [...], wz: [...]}`: every combination but standing still;
* `walks: {NAME: COMMANDS, ...}`: each a command `[vx, vy, wz]`, or a list of `[t, vx, vy, wz]`;
* `rows: [...]`: rows of the robot maker's benchmark, by id, by category, or `all`;

with `config` (its category; rows bring their own), `duration` in s, `stand_at` (when the mode STAND takes over from the
policy, s; not for rows), `repeats`, `conditions` (fields of `Conditions`), `vary` (lists of values of conditions: every
combination is a scenario) and, for rows under other conditions than their own, `suffix` of their names.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from asimov_gym.assets import config_path
from asimov_gym.evaluation.push_limits import PushLimitSearch
from asimov_gym.evaluation.rows import AXES, Command, Row, read_rows
from asimov_gym.evaluation.scenario import DRAWN, Conditions, Scenario, Trial, scenario_of_row
from asimov_gym.evaluation.variants import variant_named
from asimov_gym.presets import from_mapping, read_named, shipped_names

PROTOCOL = 1
"""Counts changes of how suites are run, so that results from before and after one are not taken for the same."""
_SUITE_KEYS = ("description", "seed", "repeats", "traces", "scenarios", "push_limits")
_KINDS = ("grid", "walks", "rows")
_COMMON_KEYS = ("config", "duration", "stand_at", "repeats", "conditions", "vary", "suffix", "description")
_NAME = re.compile(r"[a-z0-9_]+")


@dataclass(frozen=True)
class Suite:
    """Everything that is asked of a policy, fully spelt out."""

    name: str
    description: str
    seed: int
    scenarios: tuple[Scenario, ...]
    push_limits: tuple[PushLimitSearch, ...] = ()
    traces: tuple[str, ...] = field(default=())
    """Ids of scenarios of which the trace of repeat 0 is kept."""

    def __post_init__(self) -> None:
        if not self.scenarios and not self.push_limits:
            raise ValueError(f"suite {self.name}: scenarios must not be empty")
        if isinstance(self.seed, bool) or not isinstance(self.seed, int) or not 0 <= self.seed < 2**31:
            raise ValueError(f"suite {self.name}: seed must be a whole number from 0 to 2^31 - 1, got {self.seed!r}")
        seen: set[str] = set()
        for entry in (*(s.id for s in self.scenarios), *(search.id for search in self.push_limits)):
            if entry in seen:
                raise ValueError(f"suite {self.name}: {entry!r} is there twice; give one of them a `suffix` or name")
            seen.add(entry)
        unknown = sorted(set(self.traces) - {s.id for s in self.scenarios})
        if unknown:
            raise ValueError(f"suite {self.name}: traces names unknown scenarios {unknown}")

    @cached_property
    def hash(self) -> str:
        """Of all that decides the outcome: 16 hexadecimal digits. Names, descriptions and traces do not."""
        # What came later and is not asked for is left out: suites without it keep their hash.
        scenarios = [
            {k: v for k, v in asdict(s).items() if k != "description" and (k, v) != ("stand_at_s", None)}
            for s in self.scenarios
        ]
        searches = [asdict(search) for search in self.push_limits]
        conditions = [s.conditions for s in self.scenarios] + [search.conditions for search in self.push_limits]
        variants = [asdict(variant_named(name)) for name in sorted({c.physics for c in conditions})]
        text = json.dumps([PROTOCOL, self.seed, scenarios, searches, variants], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    @property
    def trials(self) -> tuple[Trial, ...]:
        """Every repeat of every scenario."""
        return tuple(Trial.of(s, repeat, self.seed) for s in self.scenarios for repeat in range(s.repeats))

    @property
    def robot_seconds(self) -> float:
        """Simulated time of all scenarios together, s; push limits come on top."""
        return sum(s.duration_s * s.repeats for s in self.scenarios)

    def with_repeats(self, repeats: int) -> Suite:
        """The same with another number of repeats of everything."""
        return replace(
            self,
            scenarios=tuple(replace(s, repeats=repeats) for s in self.scenarios),
            push_limits=tuple(replace(search, repeats=repeats) for search in self.push_limits),
        )


def suite_names() -> tuple[str, ...]:
    """Suites that come with the package."""
    return shipped_names("suites")


def load_suite(name: str | Path) -> Suite:
    """A suite by name, or from a YAML file.

    Raises:
        ValueError: the name is unknown (lists the known ones), or the file does not describe a suite; names the place,
            the value and what is allowed.
        FileNotFoundError: there is no such file.
    """
    path, data = read_named("suite", "suites", name)
    try:
        return parse_suite(data, path.stem)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def suite_of_rows(path: Path, repeats: int = 5) -> Suite:
    """The rows of a file as a suite, under the benchmark's own conditions."""
    rows = read_rows(path)
    return Suite(path.stem, f"rows of {path.name}", 0, tuple(scenario_of_row(row, None, repeats) for row in rows))


def shipped_rows() -> dict[str, Row]:
    """The rows of the robot maker's benchmark, by id."""
    rows = [row for path in sorted(config_path("suites", "rows").glob("*.json")) for row in read_rows(path)]
    return {row.id: row for row in rows}


def parse_suite(data: Any, name: str) -> Suite:
    """A suite from plain data; the keys are those of the module's docstring.

    Raises:
        ValueError: names the place, the value and what is allowed.
    """
    _check_keys("suite", data, _SUITE_KEYS)
    repeats = data.get("repeats", 5)
    scenarios: list[Scenario] = []
    for i, entry in enumerate(_list("scenarios", data.get("scenarios") or [])):
        scenarios += _scenarios(f"scenarios[{i}]", entry, repeats)
    searches: list[PushLimitSearch] = []
    for i, entry in enumerate(_list("push_limits", data.get("push_limits") or [])):
        searches += _push_limits(f"push_limits[{i}]", entry, repeats)
    return Suite(
        name=name,
        description=str(data.get("description") or ""),
        seed=data.get("seed", 0),
        scenarios=tuple(scenarios),
        push_limits=tuple(searches),
        traces=tuple(map(str, _list("traces", data.get("traces") or []))),
    )


# -- entries -----------------------------------------------------------------------------------------------------------


def _scenarios(place: str, entry: Any, repeats: int) -> list[Scenario]:
    _check_keys(place, entry, (*_KINDS, *_COMMON_KEYS))
    kinds = [kind for kind in _KINDS if kind in entry]
    if len(kinds) != 1:
        raise ValueError(f"{place} must have exactly one of {', '.join(_KINDS)}, got {kinds}")
    repeats = entry.get("repeats", repeats)
    if kinds == ["rows"]:
        return _rows(place, entry, repeats)
    for key in ("config", "duration"):
        if key not in entry:
            raise ValueError(f"{place}.{key} is missing")
    config = str(entry["config"])
    if not _NAME.fullmatch(config):
        raise ValueError(f"{place}.config must be lower-case letters, digits and `_`, got {config!r}")
    walks = _grid(place, entry["grid"]) if kinds == ["grid"] else _walks(place, entry["walks"])
    return [
        Scenario(
            id=f"{config}/{walk}{suffix}{_suffix(entry)}",
            config=config,
            duration_s=_number(f"{place}.duration", entry["duration"]),
            commands=commands,
            conditions=conditions,
            repeats=repeats,
            stand_at_s=None if "stand_at" not in entry else _number(f"{place}.stand_at", entry["stand_at"]),
            description=str(entry.get("description") or ""),
        )
        for walk, commands in walks.items()
        for suffix, conditions in _conditions(place, entry, Conditions())
    ]


def _rows(place: str, entry: Mapping[str, Any], repeats: int) -> list[Scenario]:
    for key in ("config", "duration", "stand_at", "description"):
        if key in entry:
            raise ValueError(f"{place}.{key} is not allowed beside rows, which have their own")
    known = shipped_rows()
    chosen: list[Row] = []
    for wanted in _list(f"{place}.rows", entry["rows"]):
        found = [row for row in known.values() if wanted in ("all", row.id, row.config)]
        if not found:
            configs = dict.fromkeys(row.config for row in known.values())
            raise ValueError(f"{place}.rows: {wanted!r} is unknown; known: all, {', '.join((*configs, *known))}")
        chosen += [row for row in found if row not in chosen]
    scenarios = []
    for row in chosen:
        for suffix, conditions in _conditions(place, entry, Conditions(delay=DRAWN, fall="vendor")):
            scenario = scenario_of_row(row, conditions, repeats)
            scenarios.append(replace(scenario, id=f"{row.id}{suffix}{_suffix(entry)}"))
    return scenarios


def _push_limits(place: str, entry: Any, repeats: int) -> list[PushLimitSearch]:
    lists = ("bodies", "directions_deg", "speeds")
    known = (*lists, "max_n", "resolution_n", "repeats", "conditions")
    _check_keys(place, entry, known)
    for key in lists:
        if key not in entry:
            raise ValueError(f"{place}.{key} is missing")
    ((_, conditions),) = _conditions(place, entry, Conditions())
    figures = {key: _number(f"{place}.{key}", entry[key]) for key in ("max_n", "resolution_n") if key in entry}
    return [
        PushLimitSearch(
            body=str(body),
            direction_deg=_number(f"{place}.directions_deg", direction),
            speed=_number(f"{place}.speeds", speed),
            repeats=entry.get("repeats", repeats),
            conditions=conditions,
            **figures,
        )
        for speed in _list(f"{place}.speeds", entry["speeds"])
        for body in _list(f"{place}.bodies", entry["bodies"])
        for direction in _list(f"{place}.directions_deg", entry["directions_deg"])
    ]


def _grid(place: str, axes: Any) -> dict[str, tuple[Command, ...]]:
    _check_keys(f"{place}.grid", axes, AXES)
    values = [[_number(f"{place}.grid.{a}", v) for v in _list(f"{place}.grid.{a}", axes.get(a, [0.0]))] for a in AXES]
    walks = {}
    for vx, vy, wz in itertools.product(*values):
        if (vx, vy, wz) != (0.0, 0.0, 0.0):
            walks[f"vx{vx:+.2f}_vy{vy:+.2f}_wz{wz:+.2f}"] = (Command(0.0, vx, vy, wz),)
    return walks


def _walks(place: str, walks: Any) -> dict[str, tuple[Command, ...]]:
    if not isinstance(walks, Mapping) or not walks:
        raise ValueError(f"{place}.walks must map names to commands, got {walks!r}")
    parsed = {}
    for name, commands in walks.items():
        where = f"{place}.walks.{name}"
        if not _NAME.fullmatch(str(name)):
            raise ValueError(f"{where}: a name must be lower-case letters, digits and `_`")
        rows = _list(where, commands)
        if rows and not isinstance(rows[0], list | tuple):
            rows = [[0.0, *rows]]
        if not rows or any(not isinstance(row, list | tuple) or len(row) != 4 for row in rows):
            raise ValueError(f"{where} must be [vx, vy, wz], or a list of [t, vx, vy, wz], got {commands!r}")
        parsed[str(name)] = tuple(Command(*(_number(where, value) for value in row)) for row in rows)
    return parsed


def _conditions(place: str, entry: Mapping[str, Any], base: Conditions) -> Iterable[tuple[str, Conditions]]:
    """The conditions of an entry under each combination of what varies, and what they add to the name."""
    fixed = _with(base, f"{place}.conditions", entry.get("conditions") or {})
    varied = entry.get("vary") or {}
    if not isinstance(varied, Mapping):
        raise ValueError(f"{place}.vary must map conditions to lists, got {varied!r}")
    options = [[(key, value) for value in _list(f"{place}.vary.{key}", values)] for key, values in varied.items()]
    for combination in itertools.product(*options):
        suffix = "".join(f"_{key}_{_shown(value)}" for key, value in combination)
        yield suffix, _with(fixed, f"{place}.vary", dict(combination))


def _with(base: Conditions, place: str, values: Any) -> Conditions:
    _check_keys(place, values, tuple(f.name for f in fields(Conditions)))
    merged = {f.name: getattr(base, f.name) for f in fields(Conditions)} | dict(values)
    delay = merged.pop("delay")
    if not isinstance(delay, str):
        delay = _number(f"{place}.delay", delay)
    try:
        # The delay alone may be a number or a word.
        checked = from_mapping(Conditions, merged, place)
        return replace(checked, delay=delay)
    except ValueError as error:
        raise ValueError(f"{place}: {error}" if place not in str(error) else str(error)) from error


def _suffix(entry: Mapping[str, Any]) -> str:
    suffix = entry.get("suffix")
    return "" if suffix is None else f"_{suffix}"


def _shown(value: Any) -> str:
    return f"{value:g}" if isinstance(value, int | float) and not isinstance(value, bool) else str(value)


def _check_keys(place: str, data: Any, known: Sequence[str]) -> None:
    if not isinstance(data, Mapping):
        raise ValueError(f"{place} must be a mapping, got {data!r}")
    unknown = sorted(set(map(str, data)) - set(known))
    if unknown:
        raise ValueError(f"{place} has unknown keys {unknown}; known keys: {', '.join(known)}")


def _list(place: str, value: Any) -> list[Any]:
    if not isinstance(value, list | tuple):
        raise ValueError(f"{place} must be a list, got {value!r}")
    return list(value)


def _number(place: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"{place} must be a number, got {value!r}")
    return float(value)
