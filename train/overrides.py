"""Settings laid over those of a preset, as recipes and studies have them."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any

from asimov_gym.presets import from_mapping, to_mapping
from train.config import PpoConfig, load_preset

_NAME = re.compile(r"[a-z0-9][a-z0-9_-]*")


def laid_over(base: Mapping[str, Any], top: Mapping[str, Any]) -> dict[str, Any]:
    """The values of `top` over those of `base`; mappings are joined key by key, anything else is replaced."""
    joined = dict(base)
    for key, value in top.items():
        below = joined.get(key)
        joined[key] = laid_over(below, value) if isinstance(below, Mapping) and isinstance(value, Mapping) else value
    return joined


def overridden(preset: str, *overrides: Mapping[str, Any]) -> PpoConfig:
    """A preset's settings with others over them, the last on top.

    Raises:
        ValueError: the preset is unknown, or an override does not fit.
    """
    settings = to_mapping(load_preset(preset))
    for top in overrides:
        settings = laid_over(settings, top)
    return from_mapping(PpoConfig, settings)


def differences(ours: Any, theirs: Any, where: str = "") -> Iterator[tuple[str, Any, Any]]:
    """Where two configurations as plain data differ: place, our value, their value."""
    if isinstance(ours, dict) and isinstance(theirs, dict):
        for key in [*ours, *(key for key in theirs if key not in ours)]:
            yield from differences(ours.get(key), theirs.get(key), f"{where}.{key}" if where else key)
    elif ours != theirs:
        yield where, ours, theirs


def network_settings(config: PpoConfig) -> dict[str, Any]:
    """The settings that a network's shape follows from."""
    return {
        "walk.layout": config.walk.layout,
        "learner.hidden": config.learner.hidden,
        "learner.symmetry": "network or handed" if config.learner.symmetric else "samples or none",
    }


def check_name(where: str, name: str) -> None:
    """Raise ValueError unless a name may be that of a folder."""
    if not _NAME.fullmatch(name):
        raise ValueError(f"{where} must be lower-case letters, digits, - and _, got {name!r}")


def check_about(where: str, about: str) -> None:
    """Raise ValueError unless it is a line of text."""
    if not about.strip() or "\n" in about.strip():
        raise ValueError(f"{where} must be one line of text, got {about!r}")


def check_overrides(where: str, overrides: Any, elsewhere: Mapping[str, str]) -> None:
    """Raise ValueError unless it is a mapping without certain settings.

    Args:
        where: its place, for messages.
        overrides: to check.
        elsewhere: settings that have a place of their own, with who has them.
    """
    if not isinstance(overrides, Mapping):
        raise ValueError(f"{where} must be a mapping, got {overrides!r}")
    for name, owner in elsewhere.items():
        if name in overrides:
            raise ValueError(f"{where} must not hold {name}, which {owner} has, got {overrides[name]!r}")
