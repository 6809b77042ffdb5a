"""Ablation studies: one training with everything, and again with one ingredient taken away; YAML in
`configs/ablations`.

`train.ablation_run` goes through one, `train.ablation_result` holds what came of it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from asimov_gym.presets import load_named, shipped_names, to_mapping
from train.config import PpoConfig
from train.overrides import check_about, check_name, check_overrides, differences, network_settings, overridden

BASE = "all"
"""Name of the variant with everything."""
_ELSEWHERE = {"samples": "the study", "seed": "the study, in seeds,"}
"""Settings that no overrides may hold."""


@dataclass(frozen=True)
class Variant:
    """A training of a study."""

    name: str
    """In lower case; its folders are called after it."""
    about: str
    """What is taken away, in a line."""
    overrides: dict[str, Any] = field(default_factory=dict)
    """Settings that differ from the base's, in the shape of a preset."""

    def __post_init__(self) -> None:
        check_name("variant name", self.name)
        check_about(f"variant {self.name!r}: about", self.about)
        check_overrides(f"variant {self.name!r}: overrides", self.overrides, _ELSEWHERE)


@dataclass(frozen=True)
class Study:
    """What is compared with what."""

    about: str
    """What is asked, in a line."""
    preset: str
    """Training preset of the base, but for `samples`, the seed and `overrides`."""
    samples: int
    """Samples of each training."""
    variants: tuple[Variant, ...]
    """Without the base, which is always the first."""
    name: str = "study"
    """The folder of its runs is called after it; the file's when that gives none."""
    overrides: dict[str, Any] = field(default_factory=dict)
    """Settings of all variants that differ from the preset's."""
    seeds: tuple[int, ...] = (1,)
    """Each variant is trained once with each."""
    base_seeds: tuple[int, ...] = ()
    """More seeds of the base alone: how much a figure differs from one training to the next."""
    suite: str = "quick"
    """That the results are judged by: a name, or a YAML file."""
    warm_start: bool = False
    """Whether each training begins with the networks of a run, which is to be named."""

    def __post_init__(self) -> None:
        check_name("name", self.name)
        check_about("about", self.about)
        if self.samples < 1:
            raise ValueError(f"samples must be at least 1, got {self.samples}")
        if not self.variants:
            raise ValueError("variants must not be empty")
        names = [variant.name for variant in self.all_variants]
        for name in names:
            if names.count(name) > 1:
                why = "the base is called so" if name == BASE else "two variants are called so"
                raise ValueError(f"variant {name!r}: name must be of its own, {why}")
        if not self.seeds:
            raise ValueError("seeds must not be empty")
        seeds = (*self.seeds, *self.base_seeds)
        if len(set(seeds)) < len(seeds) or min(seeds) < 0:
            raise ValueError(f"seeds and base_seeds must be different numbers from 0 on, got {list(seeds)}")
        check_overrides("overrides", self.overrides, _ELSEWHERE)
        self._check_variants()

    def _check_variants(self) -> None:
        base = self.config(self.base)
        for variant in self.variants:
            config = self.config(variant)
            if config == base:
                raise ValueError(f"variant {variant.name!r}: overrides change nothing, got {variant.overrides}")
            if self.warm_start:
                check_networks(f"variant {variant.name!r}", config, base, "the base")

    @property
    def base(self) -> Variant:
        """The variant with everything."""
        return Variant(BASE, "nothing is taken away")

    @property
    def all_variants(self) -> tuple[Variant, ...]:
        """The base and the variants."""
        return (self.base, *self.variants)

    @property
    def runs(self) -> tuple[tuple[Variant, int], ...]:
        """Every training, a variant and a seed, in order: a whole comparison with one seed comes first."""
        all_of_all = [(variant, seed) for seed in self.seeds for variant in self.all_variants]
        return (*all_of_all, *((self.base, seed) for seed in self.base_seeds))

    def config(self, variant: Variant, seed: int | None = None) -> PpoConfig:
        """Settings of a training; of the first seed when that is None.

        Raises:
            ValueError: the preset is unknown, or an override does not fit; names the variant.
        """
        own = {"samples": self.samples, "seed": self.seeds[0] if seed is None else seed}
        try:
            return overridden(self.preset, self.overrides, variant.overrides, own)
        except ValueError as error:
            raise ValueError(f"variant {variant.name!r}: {error}" if variant.overrides else str(error)) from error


def check_networks(whose: str, config: PpoConfig, parent: PpoConfig, parents: str) -> None:
    """Raise ValueError unless a training can go on with the networks of another.

    Args:
        whose: of the settings, for messages.
        config: settings.
        parent: settings of the other.
        parents: whose those are.
    """
    wanted = network_settings(parent)
    for where, value in network_settings(config).items():
        if value != wanted[where]:
            raise ValueError(
                f"{whose}: {where} must be {wanted[where]} as in {parents}, whose networks it goes on with, got {value}"
            )


def study_names() -> list[str]:
    """Names of the shipped studies."""
    return list(shipped_names("ablations"))


def load_study(name: str | Path) -> Study:
    """A study by name, or from a YAML file.

    Raises:
        ValueError: the name is unknown (lists the known ones), or the file does not describe a study; names the file,
            the variant, the field, the value and what is allowed.
        FileNotFoundError: there is no such file.
    """
    return load_named(Study, "ablation", "ablations", name)


def changes(config: PpoConfig, base: PpoConfig) -> dict[str, tuple[Any, Any]]:
    """What a variant does otherwise: base's and own value by the place of the setting."""
    return {where: (theirs, ours) for where, ours, theirs in differences(to_mapping(config), to_mapping(base))}
