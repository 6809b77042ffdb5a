"""Recipes: training presets one after the other, each warm-started from the one before; YAML in `configs/recipes`.

`train.recipe_run` goes through one.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from asimov_gym.presets import check_range, from_mapping, read_named, shipped_names, to_mapping
from train.config import PpoConfig, load_preset

_NAME = re.compile(r"[a-z0-9][a-z0-9_-]*")
MAX_STAGES = 99
"""Folders of stages are numbered with two digits."""


@dataclass(frozen=True)
class Stage:
    """A training run of a recipe."""

    name: str
    """In lower case; its folder is called after it."""
    preset: str
    """Training preset whose settings these are, but for `samples` and `overrides`."""
    samples: int
    """Samples to train; those of the preset do not count."""
    overrides: dict[str, Any] = field(default_factory=dict)
    """Settings that differ from the preset's, in the shape of a preset."""

    def __post_init__(self) -> None:
        _check_name("stage name", self.name)
        if self.samples < 1:
            raise ValueError(f"stage {self.name!r}: samples must be at least 1, got {self.samples}")
        _check_overrides(f"stage {self.name!r}: overrides", self.overrides)


@dataclass(frozen=True)
class Recipe:
    """How a policy is made from nothing."""

    about: str
    """What it makes and on what, in a line."""
    stages: tuple[Stage, ...]
    name: str = "recipe"
    """The folder of its runs is called after it; the file's when that gives none."""
    overrides: dict[str, Any] = field(default_factory=dict)
    """Settings of all stages that differ from the presets'; a stage's own come on top."""
    gpu: bool = False
    """Whether it is meant for an NVIDIA GPU, and refused without one."""

    def __post_init__(self) -> None:
        _check_name("name", self.name)
        if not self.about.strip() or "\n" in self.about.strip():
            raise ValueError(f"about must be one line of text, got {self.about!r}")
        if not 1 <= len(self.stages) <= MAX_STAGES:
            raise ValueError(f"stages must hold 1 to {MAX_STAGES} stages, got {len(self.stages)}")
        names = [stage.name for stage in self.stages]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"stages must have names of their own, got {', '.join(twice)} more than once")
        _check_overrides("overrides", self.overrides)
        self._check_warm_starts()

    def _check_warm_starts(self) -> None:
        """What is wrong with a later stage is said before the first is trained."""
        first, *later = map(_networks, self.configs)
        for stage, networks in zip(self.stages[1:], later, strict=True):
            for where, wanted in first.items():
                if networks[where] != wanted:
                    raise ValueError(
                        f"stage {stage.name!r}: {where} must be {wanted} as in the first stage, whose networks it goes "
                        f"on with, got {networks[where]}"
                    )

    @property
    def configs(self) -> tuple[PpoConfig, ...]:
        """Settings of the stages.

        Raises:
            ValueError: a preset is unknown, or an override does not fit.
        """
        return tuple(self._config(stage) for stage in self.stages)

    @property
    def samples(self) -> int:
        """Of all stages together."""
        return sum(stage.samples for stage in self.stages)

    def _config(self, stage: Stage) -> PpoConfig:
        try:
            settings = to_mapping(load_preset(stage.preset))
            for overrides in (self.overrides, stage.overrides, {"samples": stage.samples}):
                settings = laid_over(settings, overrides)
            return from_mapping(PpoConfig, settings)
        except ValueError as error:
            raise ValueError(f"stage {stage.name!r}: {error}") from error

    def scaled(self, factor: float) -> tuple[PpoConfig, ...]:
        """Settings of the stages with so many times the samples; the entropy bonus falls that much later.

        Raises:
            ValueError: the factor is out of range.
        """
        check_range("scale", factor, 1e-6, 1e3)
        if factor == 1.0:
            return self.configs
        return tuple(
            replace(
                config,
                samples=max(1, round(config.samples * factor)),
                learner=replace(
                    config.learner, entropy_samples=tuple(n * factor for n in config.learner.entropy_samples)
                ),
            )
            for config in self.configs
        )


def _networks(config: PpoConfig) -> dict[str, Any]:
    """The settings that a network's shape follows from."""
    return {
        "walk.layout": config.walk.layout,
        "learner.hidden": config.learner.hidden,
        "learner.symmetry": "network or handed" if config.learner.symmetric else "samples or none",
    }


def laid_over(base: Mapping[str, Any], top: Mapping[str, Any]) -> dict[str, Any]:
    """The values of `top` over those of `base`; mappings are joined key by key, anything else is replaced."""
    joined = dict(base)
    for key, value in top.items():
        below = joined.get(key)
        joined[key] = laid_over(below, value) if isinstance(below, Mapping) and isinstance(value, Mapping) else value
    return joined


def recipe_names() -> list[str]:
    """Names of the shipped recipes."""
    return list(shipped_names("recipes"))


def load_recipe(name: str | Path) -> Recipe:
    """A recipe by name, or from a YAML file.

    Raises:
        ValueError: the name is unknown (lists the known ones), or the file does not describe a recipe; names the field,
            the value and what is allowed.
        FileNotFoundError: there is no such file.
    """
    path, data = read_named("recipe", "recipes", name)
    try:
        return from_mapping(Recipe, {"name": path.stem, **data} if isinstance(data, Mapping) else data)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def _check_name(where: str, name: str) -> None:
    if not _NAME.fullmatch(name):
        raise ValueError(f"{where} must be lower-case letters, digits, - and _, got {name!r}")


def _check_overrides(where: str, overrides: Any) -> None:
    if not isinstance(overrides, Mapping):
        raise ValueError(f"{where} must be a mapping, got {overrides!r}")
    if "samples" in overrides:
        raise ValueError(f"{where} must not hold samples, which every stage has, got {overrides['samples']!r}")
