"""What a suite measured, as plain data that survives JSON: trials, pushes, push limits, and where they come from."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, Literal, TypeVar

SCHEMA_VERSION = 1
SKIPPED = "skipped: "
RESULT_FILE = "result.json"
"""Name of a suite's result in its run folder."""

Tier = Literal["reasonable", "beyond"]
"""Of a push in the robot maker's benchmark: one that must be survived, and one that is beyond that."""
Outcome = Literal["passed", "failed", "skipped"]
"""The robot stayed up until the next event; it fell before that; it was down already."""

T = TypeVar("T")


@dataclass(frozen=True)
class PushOutcome:
    """One push of a trial, and what came of it."""

    label: str
    body: str
    direction: tuple[float, float, float]
    """World frame, unit vector."""
    force: float
    """N."""
    at_s: float
    tier: Tier | None
    outcome: Outcome


@dataclass(frozen=True)
class TrialResult:
    """One repeat of a scenario."""

    scenario: str
    """Id of the scenario."""
    config: str
    """Its category."""
    repeat: int
    seed: int
    """All that is random in the trial follows from it."""
    delay_ms: float
    """Action delay."""
    survived: bool
    """False also where `error` says why it could not be run to its end."""
    fall_s: float | None
    """Time of the fall; None where the robot did not fall."""
    events: tuple[PushOutcome, ...]
    metrics: Mapping[str, float | None]
    """Figures of `asimov_gym.evaluation.metrics`; None where a figure has no meaning for this trial."""
    error: str | None
    """Why the trial failed without a fall: the simulation diverged, the network's output was not finite, and so on. It
    begins with `SKIPPED` where the trial could not be tried on this machine, which says nothing about the policy."""

    @property
    def was_run(self) -> bool:
        """False where this machine could not try it."""
        return self.error is None or not self.error.startswith(SKIPPED)


@dataclass(frozen=True)
class ScenarioInfo:
    """What a scenario asked for."""

    id: str
    config: str
    description: str
    duration_s: float
    commands: tuple[tuple[float, float, float, float], ...]
    """Time (s), vx, vy (m/s), yaw rate (rad/s): each held until the next."""
    conditions: Mapping[str, Any]
    """Every condition by name, as plain data; see `asimov_gym.evaluation.scenario.Conditions`."""
    repeats: int
    stand_at_s: float | None = None
    """When the mode STAND takes over from the policy."""


@dataclass(frozen=True)
class PushLimit:
    """The largest push that every repeat survived, found by bisection."""

    scenario: str
    body: str
    direction: tuple[float, float, float]
    """World frame, unit vector."""
    speed: float
    """Forward command while pushed, m/s; 0 stands."""
    largest_survived_n: float
    """N; 0 where the robot fell without a push too."""
    smallest_failed_n: float | None
    """N; None where the largest force that was tried was survived."""
    resolution_n: float
    repeats: int


@dataclass(frozen=True)
class SuiteResult:
    """Everything that one run of a suite with one policy measured."""

    suite: str
    suite_hash: str
    """Of everything that the suite asks for; results with the same hash may be compared."""
    policy_name: str
    policy_hash: str
    """SHA-256 of the policy file, hexadecimal."""
    contract: Mapping[str, Any]
    """The policy's contract in short: layout, rates, gait clock, command ranges, training."""
    machine: Mapping[str, Any]
    versions: Mapping[str, str]
    started: str
    """UTC, ISO 8601."""
    wall_clock_s: float
    """Of all sittings together."""
    scenarios: tuple[ScenarioInfo, ...]
    trials: tuple[TrialResult, ...]
    push_limits: tuple[PushLimit, ...]
    complete: bool
    """False where the run was stopped before its end."""
    traces: Mapping[str, str] = field(default_factory=dict)
    """File (.npz) of repeat 0 by scenario id, relative to the run folder; see `asimov_gym.evaluation.rollout`."""
    schema_version: int = SCHEMA_VERSION

    def trials_of(self, scenario: str) -> tuple[TrialResult, ...]:
        """The trials of a scenario, by repeat."""
        return tuple(sorted((t for t in self.trials if t.scenario == scenario), key=lambda t: t.repeat))

    def to_json(self) -> dict[str, Any]:
        """Plain data; numbers that are not finite are null."""
        return plain(asdict(self))

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> SuiteResult:
        """The result from plain data.

        Raises:
            ValueError: another schema version, or a key is missing or unknown; names it.
        """
        version = data.get("schema_version")
        if version != SCHEMA_VERSION:
            raise ValueError(f"schema_version must be {SCHEMA_VERSION}, got {version!r}")
        values = _checked(cls, data)
        values["scenarios"] = tuple(_scenario(entry) for entry in values["scenarios"])
        values["trials"] = tuple(trial_from_json(entry) for entry in values["trials"])
        values["push_limits"] = tuple(push_limit_from_json(entry) for entry in values["push_limits"])
        return cls(**values)

    def save(self, folder: Path) -> Path:
        """Write `result.json` into a folder; a reader never sees half a file."""
        path = folder / RESULT_FILE
        part = path.with_suffix(".part")
        part.write_text(json.dumps(self.to_json(), indent=1, allow_nan=False) + "\n", encoding="utf-8")
        os.replace(part, path)
        return path

    @classmethod
    def load(cls, path: Path) -> SuiteResult:
        """Read a result file, or the one in a run folder.

        Raises:
            FileNotFoundError: there is none.
            ValueError: it is not a result of this schema; names the file.
        """
        file = path / RESULT_FILE if path.is_dir() else path
        if not file.is_file():
            raise FileNotFoundError(f"no suite result at {file}")
        try:
            return cls.from_json(json.loads(file.read_text(encoding="utf-8")))
        except (ValueError, TypeError, AttributeError) as error:
            raise ValueError(f"{file} is not a suite result: {error}") from error


def trial_from_json(data: Mapping[str, Any]) -> TrialResult:
    """A trial from plain data.

    Raises:
        ValueError: a key is missing or unknown.
    """
    values = _checked(TrialResult, data)
    values["events"] = tuple(_event(entry) for entry in values["events"])
    return TrialResult(**values)


def push_limit_from_json(data: Mapping[str, Any]) -> PushLimit:
    """A push limit from plain data.

    Raises:
        ValueError: a key is missing or unknown.
    """
    values = _checked(PushLimit, data)
    values["direction"] = tuple(values["direction"])
    return PushLimit(**values)


def plain(value: Any) -> Any:
    """Mappings, lists and scalars that strict JSON can hold: what is not finite becomes None."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _event(data: Mapping[str, Any]) -> PushOutcome:
    values = _checked(PushOutcome, data)
    values["direction"] = tuple(values["direction"])
    return PushOutcome(**values)


def _scenario(data: Mapping[str, Any]) -> ScenarioInfo:
    values = _checked(ScenarioInfo, data)
    values["commands"] = tuple(tuple(row) for row in values["commands"])
    return ScenarioInfo(**values)


def _checked(cls: type[T], data: Mapping[str, Any]) -> dict[str, Any]:
    """The entries of a mapping, which must be exactly the fields of a dataclass."""
    known = {f.name for f in fields(cls)}  # type: ignore[arg-type]
    missing, unknown = sorted(known - set(data)), sorted(set(data) - known)
    if missing or unknown:
        raise ValueError(f"{cls.__name__}: missing keys {missing}, unknown keys {unknown}")
    return dict(data)
