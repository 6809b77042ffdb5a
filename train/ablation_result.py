"""What came of a study: every training with its figures and curves, as a JSON file small enough to be committed."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from asimov_gym.evaluation.card import short_json
from asimov_gym.evaluation.results import plain
from asimov_gym.presets import from_mapping
from train.ablation import BASE
from train.ablation_figures import FEWEST, FIGURES, Value

RESULT_FILE = "ablation.json"
VERSION = 1
"""Of the file."""
Verdict = Literal["better", "worse", "no difference", "not measured"]
"""Of a variant against the base."""


@dataclass(frozen=True)
class Spread:
    """A figure over the trainings of a variant."""

    mean: float | None
    """Over the seeds that have it; None where none has."""
    low: float | None
    high: float | None
    seeds: int
    """Trainings; with one, nothing says how much another would differ."""
    count: int
    """Trials that have the figure, of all seeds together; of a share, those that passed."""
    whole: int

    @classmethod
    def of(cls, values: Sequence[Value]) -> Spread:
        """From one value for each seed."""
        known = [one.value for one in values if one.value is not None]
        count, whole = sum(one.count for one in values), sum(one.whole for one in values)
        if not known:
            return cls(None, None, None, len(values), count, whole)
        return cls(sum(known) / len(known), min(known), max(known), len(values), count, whole)

    @property
    def share(self) -> float:
        """Of the trials that have it."""
        return self.count / self.whole if self.whole else 0.0


@dataclass(frozen=True)
class TrainingResult:
    """One training of a variant."""

    seed: int
    samples: int
    seconds: float
    """Wall-clock time of the training."""
    commit: str | None
    machine: str
    policy_hash: str
    """SHA-256 of the exported network, hexadecimal."""
    figures: Mapping[str, Value]
    """By the names of `train.ablation_figures.FIGURES`."""
    curve: Mapping[str, tuple[float | None, ...]]
    """`samples`, and those of `train.ablation_figures.CURVES`."""


@dataclass(frozen=True)
class VariantResult:
    """The trainings of a variant."""

    name: str
    about: str
    changes: Mapping[str, Any]
    """The base's value and its own by the place of the setting."""
    trainings: tuple[TrainingResult, ...]
    figures: Mapping[str, Spread]

    @classmethod
    def of(
        cls, name: str, about: str, changes: Mapping[str, Any], trainings: Sequence[TrainingResult]
    ) -> VariantResult:
        """With the spreads of the figures."""
        names = [name for name in FIGURES if any(name in one.figures for one in trainings)]
        spreads = {n: Spread.of([one.figures[n] for one in trainings if n in one.figures]) for n in names}
        return cls(name, about, changes, tuple(trainings), spreads)


@dataclass(frozen=True)
class AblationResult:
    """A study, and what is known of it so far."""

    study: Mapping[str, Any]
    """All its settings."""
    settings: Mapping[str, Any]
    """Those of the base's training, spelt out."""
    scale: float
    """The study's samples were multiplied by this."""
    suite: str
    suite_hash: str
    machine: str
    versions: Mapping[str, Any]
    commit: str | None
    """Of the code that wrote the file."""
    planned: int
    """Trainings that the study asks for."""
    variants: tuple[VariantResult, ...]
    """Those with a finished training; the base is the first where it has one."""
    after: tuple[Mapping[str, Any], ...] = ()
    """Stages of the run that all began with, oldest first."""
    failures: Mapping[str, str] = field(default_factory=dict)
    """Why a training broke, by the name of its folder."""
    ablation_version: int = VERSION

    @property
    def base(self) -> VariantResult | None:
        """The variant with everything."""
        return next((variant for variant in self.variants if variant.name == BASE), None)

    @property
    def finished(self) -> int:
        """Trainings that are here."""
        return sum(len(variant.trainings) for variant in self.variants)

    @property
    def repeats(self) -> int:
        """Trainings of the base."""
        return 0 if self.base is None else len(self.base.trainings)

    # -- what differs --------------------------------------------------------------------------------------------------

    def tolerance(self, name: str) -> float | None:
        """The difference from the base that a figure must exceed to count; None where the base does not have it.

        The largest of the figure's own bound, `FEWEST` trials of a share, and what the base's trainings differ by.
        """
        spread = None if self.base is None else self.base.figures.get(name)
        if spread is None or spread.mean is None or spread.low is None or spread.high is None:
            return None
        figure = FIGURES[name]
        bounds = [figure.bound, figure.relative * abs(spread.mean), spread.high - spread.low]
        if figure.is_share and spread.whole:
            bounds.append(FEWEST * spread.seeds / spread.whole)  # of the trials of one training
        return max(bounds)

    def judge(self, variant: VariantResult, name: str) -> Verdict:
        """A figure of a variant against the base's.

        A figure that nothing has is worse than any. One that is the mean of fewer robots, because others fell, is never
        better: those that are left may have had the easier commands.
        """
        base = None if self.base is None else self.base.figures.get(name)
        mine, tolerance = variant.figures.get(name), self.tolerance(name)
        if base is None or mine is None:
            return "not measured"
        if base.mean is None or mine.mean is None:
            return "no difference" if base.mean == mine.mean else "worse" if mine.mean is None else "better"
        assert tolerance is not None
        gain = mine.mean - base.mean if FIGURES[name].better == "higher" else base.mean - mine.mean
        if abs(gain) <= tolerance + 1e-12:  # 0.31 less 0.3 is 0.010000000000000009
            return "no difference"
        if gain < 0.0:
            return "worse"
        fewer = not FIGURES[name].is_share and mine.share < base.share
        return "no difference" if fewer else "better"

    # -- the file ------------------------------------------------------------------------------------------------------

    def save(self, path: Path) -> None:
        """Write it as JSON; a reader never sees half a file."""
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_suffix(".part")
        part.write_text(short_json(plain(asdict(self))), encoding="utf-8")
        os.replace(part, path)

    @classmethod
    def load(cls, path: Path) -> AblationResult:
        """Read a file.

        Raises:
            FileNotFoundError: there is none.
            ValueError: it is not a study's result of this version; names the file and the key.
        """
        if not path.is_file():
            raise FileNotFoundError(f"no study result at {path}: python -m train ablation makes one")
        try:
            data = json.loads(path.read_text(encoding="utf-8"))
            version = data.get("ablation_version") if isinstance(data, dict) else None
            if version != VERSION:
                raise ValueError(f"ablation_version must be {VERSION}, got {version!r}")
            return from_mapping(cls, data)
        except (ValueError, TypeError) as error:
            raise ValueError(f"{path}: {error}") from error
