"""The figures of a policy's card: what a suite's result says, without its single trials, as a JSON file.

It is small enough to be committed, and holds all that the tables and pictures of the docs show.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from asimov_gym.evaluation.bars import BarResult, judge
from asimov_gym.evaluation.plot_data import (
    GaitSample,
    Pushes,
    ScenarioFigures,
    TorqueUse,
    gait_samples,
    pushes,
    scenario_figures,
    torques,
)
from asimov_gym.evaluation.report import conditions, tables
from asimov_gym.evaluation.results import SuiteResult, plain
from asimov_gym.evaluation.table import Table
from asimov_gym.presets import from_mapping

CARD_VERSION = 2
"""Of the file; the first one held no suite's result."""
_INNERMOST = re.compile(r"([\[{])\n\s+([^\[\]{}]+?)\n\s+([\]}])")


class OldCardError(ValueError):
    """A card of an earlier version, which does not hold what this one reads."""


@dataclass(frozen=True)
class CardFigures:
    """What one run of a suite with one policy measured."""

    suite: str
    suite_hash: str
    policy_name: str
    policy_hash: str
    """SHA-256 of the policy file, hexadecimal."""
    contract: Mapping[str, Any]
    """The policy's contract in short, with how it was trained."""
    machine: Mapping[str, Any]
    versions: Mapping[str, Any]
    started: str
    """UTC, ISO 8601."""
    wall_clock_s: float
    complete: bool
    """False where the run was stopped before its end."""
    bars: tuple[BarResult, ...]
    conditions: tuple[Table, ...]
    tables: tuple[Table, ...]
    scenarios: tuple[ScenarioFigures, ...]
    pushes: Pushes
    torques: TorqueUse
    gaits: tuple[GaitSample, ...]
    card_version: int = CARD_VERSION

    @classmethod
    def of(cls, result: SuiteResult, folder: Path | None = None) -> CardFigures:
        """From a result.

        Args:
            result: of a suite.
            folder: its run folder with the traces; without one the card has no gait samples.
        """
        kept = ("suite", "suite_hash", "policy_name", "policy_hash", "contract", "machine", "versions", "started")
        return cls(
            **{name: getattr(result, name) for name in kept},
            wall_clock_s=result.wall_clock_s,
            complete=result.complete,
            bars=tuple(judge(result)),
            conditions=tuple(conditions(result.scenarios)),
            tables=tuple(tables(result)),
            scenarios=scenario_figures(result),
            pushes=pushes(result),
            torques=torques(result),
            gaits=() if folder is None else gait_samples(result, folder),
        )

    @classmethod
    def load(cls, path: Path) -> CardFigures:
        """Read a card's file.

        Raises:
            FileNotFoundError: there is none.
            OldCardError: it was written by an earlier version; says how to make it again.
            ValueError: it is not a card; names the file and the key.
        """
        if not path.is_file():
            raise FileNotFoundError(f"no card at {path}: python -m train card RUN makes one")
        try:
            data = json.loads(path.read_text(encoding="utf-8"))
        except ValueError as error:
            raise ValueError(f"{path} is not valid JSON: {error}") from error
        version = data.get("card_version", 1) if isinstance(data, dict) else None
        if isinstance(version, int) and version < CARD_VERSION:
            raise OldCardError(
                f"{path.name} is a card of version {version}, {CARD_VERSION} is needed: "
                "python -m train card RUN makes it again"
            )
        if isinstance(version, int) and version > CARD_VERSION:
            raise ValueError(f"{path}: card_version must be {CARD_VERSION}, got {version}")
        try:
            return from_mapping(cls, data)
        except (ValueError, TypeError) as error:
            raise ValueError(f"{path}: {error}") from error

    def save(self, path: Path) -> None:
        """Write it as JSON."""
        path.write_text(short_json(plain(asdict(self))), encoding="utf-8")

    def scenario(self, name: str) -> ScenarioFigures | None:
        """A scenario by its id; None where the suite does not have it."""
        return next((one for one in self.scenarios if one.id == name), None)


def short_json(data: Any) -> str:
    """Plain data as JSON, lists and objects that hold no others on one line each."""
    text = json.dumps(data, indent=1, allow_nan=False)
    return _INNERMOST.sub(lambda found: found[1] + re.sub(r"\n\s+", " ", found[2]) + found[3], text) + "\n"
