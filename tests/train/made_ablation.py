"""Results of studies made up for tests: the shape of real ones, with figures and curves that follow simple rules."""

from __future__ import annotations

import math
from collections.abc import Mapping

from asimov_gym.evaluation.suite import load_suite
from asimov_gym.presets import to_mapping
from train.ablation import Study, changes, load_study
from train.ablation_figures import FIGURES, Value
from train.ablation_result import AblationResult, TrainingResult, VariantResult

WHOLE = 20
"""Trials of each figure."""


def value(name: str, shift: float = 0.0, count: int = WHOLE) -> Value:
    """A figure of a good policy, worse by so many hundredths of itself."""
    figure = FIGURES[name]
    if figure.is_share:
        passed = min(WHOLE, round(0.9 * WHOLE * (1.0 - shift)))
        return Value(passed / WHOLE, passed, WHOLE)
    good = 2e6 if figure.unit == "M" else 300.0 if figure.unit == "N" else 0.1
    sign = -1.0 if figure.better == "higher" else 1.0
    whole = 1 if figure.unit == "M" else WHOLE
    return Value(good * (1.0 + sign * shift), min(count, whole), whole)


def training(seed: int = 1, shift: float = 0.0, figures: Mapping[str, Value] | None = None) -> TrainingResult:
    """A training whose figures are all worse by so many hundredths; some can be given."""
    samples = [1e5 * (place + 1) for place in range(60)]
    curve = {
        "samples": tuple(samples),
        "episode_length_s": tuple(20.0 * (1.0 - math.exp(-n / 1e6)) for n in samples),
        "falls_per_min": tuple(60.0 * math.exp(-n / 1e6) for n in samples),
        "velocity_error_m_s": tuple(0.05 + 0.35 * math.exp(-n / 1.5e6) + 0.3 * shift for n in samples),
    }
    made = {name: value(name, shift) for name in FIGURES} | dict(figures or {})
    return TrainingResult(seed, 6_000_000, 660.0, "c" * 40, "Linux, 2 cores, no GPU", "a" * 64, made, curve)


def made_result(
    trainings: Mapping[str, tuple[TrainingResult, ...]] | None = None, study: Study | None = None
) -> AblationResult:
    """A result of a study, by default of `ingredients`; trainings by the name of the variant, one each by default."""
    study = study or load_study("ingredients")
    base = study.config(study.base)
    known = trainings or {variant.name: (training(),) for variant in study.all_variants}
    return AblationResult(
        study=to_mapping(study),
        settings=to_mapping(base),
        scale=1.0,
        suite=study.suite,
        suite_hash=load_suite(study.suite).hash,
        machine="Linux, 2 cores, no GPU",
        versions={"mujoco": "1.2.3"},
        commit="c" * 40,
        planned=len(study.runs),
        variants=tuple(
            VariantResult.of(one.name, one.about, changes(study.config(one), base), known[one.name])
            for one in study.all_variants
            if one.name in known
        ),
    )
