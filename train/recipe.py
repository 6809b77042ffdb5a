"""Recipes: training presets one after the other, each warm-started from the one before; YAML in `configs/recipes`.

`train.recipe_run` goes through one.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from asimov_gym.presets import load_named, shipped_names
from train.config import PpoConfig
from train.overrides import check_about, check_name, check_overrides, network_settings, overridden

_ELSEWHERE = {"samples": "every stage"}
"""Settings that no overrides may hold."""
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
        check_name("stage name", self.name)
        if self.samples < 1:
            raise ValueError(f"stage {self.name!r}: samples must be at least 1, got {self.samples}")
        check_overrides(f"stage {self.name!r}: overrides", self.overrides, _ELSEWHERE)


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
    averaged_stages: int = 1
    """The result is the mean of the networks that so many last stages end with: see `train.mean_run`."""
    calibrated: bool = False
    """Its commands are calibrated: see `train.calibration`."""
    gpu: bool = False
    """Whether it is meant for an NVIDIA GPU, and refused without one."""

    def __post_init__(self) -> None:
        check_name("name", self.name)
        check_about("about", self.about)
        if not 1 <= len(self.stages) <= MAX_STAGES:
            raise ValueError(f"stages must hold 1 to {MAX_STAGES} stages, got {len(self.stages)}")
        names = [stage.name for stage in self.stages]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"stages must have names of their own, got {', '.join(twice)} more than once")
        check_overrides("overrides", self.overrides, _ELSEWHERE)
        if not 1 <= self.averaged_stages <= len(self.stages):
            raise ValueError(f"averaged_stages must lie in [1, {len(self.stages)}], got {self.averaged_stages}")
        self._check_warm_starts()

    def _check_warm_starts(self) -> None:
        """What is wrong with a later stage is said before the first is trained."""
        first, *later = map(network_settings, self.configs)
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
            return overridden(stage.preset, self.overrides, stage.overrides, {"samples": stage.samples})
        except ValueError as error:
            raise ValueError(f"stage {stage.name!r}: {error}") from error

    def scaled(self, factor: float) -> tuple[PpoConfig, ...]:
        """Settings of the stages with so many times the samples; the entropy bonus falls that much later.

        Raises:
            ValueError: the factor is out of range.
        """
        return tuple(config.scaled(factor) for config in self.configs)


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
    return load_named(Recipe, "recipe", "recipes", name)
