"""YAML presets validated into frozen dataclasses, and back; and the checks such dataclasses make of their fields."""

from __future__ import annotations

import collections.abc
import dataclasses
import math
import types
import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

import yaml

from asimov_gym.assets import config_path

T = TypeVar("T")


def check_range(name: str, value: float, low: float, high: float) -> None:
    """Raise ValueError unless `low <= value <= high`."""
    if not (isinstance(value, int | float) and math.isfinite(value) and low <= value <= high):
        raise ValueError(f"{name} must lie in [{low:g}, {high:g}], got {value!r}")


def check_interval(name: str, value: tuple[float, float], low: float, high: float) -> None:
    """Raise ValueError unless `value` is an ordered pair within [low, high]."""
    if len(value) != 2:
        raise ValueError(f"{name} must be a pair [low, high], got {value!r}")
    check_range(f"{name}[0]", value[0], low, high)
    check_range(f"{name}[1]", value[1], low, high)
    if value[0] > value[1]:
        raise ValueError(f"{name} must be ordered low to high, got {value!r}")


def check_weights(name: str, weights: Mapping[str, float], terms: Mapping[str, Any]) -> None:
    """Raise ValueError unless each weight belongs to one of `terms` and is a number within 1000 of zero."""
    unknown = sorted(set(weights) - set(terms))
    if unknown:
        raise ValueError(f"{name} has unknown terms {unknown}; known terms: {', '.join(terms)}")
    for term, weight in weights.items():
        check_range(f"{name}.{term}", weight, -1e3, 1e3)


def from_mapping(cls: type[T], data: Mapping[str, Any], where: str = "") -> T:
    """Build a dataclass from nested mappings; fields that are missing keep their defaults.

    A field that is itself a mapping, such as that of the reward weights, is laid over its default, key by key.

    Raises:
        ValueError: an unknown key or a value of the wrong kind; the message names the field and what is known.
    """
    if not isinstance(data, collections.abc.Mapping):
        raise ValueError(f"{where or cls.__name__} must be a mapping, got {data!r}")
    known = {f.name: f for f in dataclasses.fields(cls)}  # type: ignore[arg-type]
    unknown = sorted(set(map(str, data)) - set(known))
    if unknown:
        place = f" in {where}" if where else ""
        raise ValueError(f"unknown keys {unknown}{place}; known keys: {', '.join(known)}")
    missing = sorted(name for name, f in known.items() if name not in data and _is_required(f))
    if missing:
        raise ValueError(f"{where or cls.__name__} lacks {', '.join(missing)}; known keys: {', '.join(known)}")
    hints = typing.get_type_hints(cls)
    values = {}
    for name, value in data.items():
        path = f"{where}.{name}" if where else name
        values[name] = _convert(hints[name], value, path, known[name])
    try:
        return cls(**values)
    except TypeError as error:
        raise ValueError(f"{where or cls.__name__}: {error}") from error


def shipped_names(folder: str) -> tuple[str, ...]:
    """Names of the YAML files in a folder of `configs`."""
    return tuple(sorted(path.stem for path in config_path(folder).glob("*.yaml")))


def read_named(kind: str, folder: str, name: str | Path) -> tuple[Path, Any]:
    """A shipped YAML file by its name, or any by its path: where it is, and what it holds as plain data.

    Args:
        kind: what it describes, for messages.
        folder: of `configs`.
        name: of a shipped file, or a path that ends in `.yaml` or `.yml`.

    Raises:
        ValueError: the name is unknown (lists the known ones), or the file is not YAML.
        FileNotFoundError: there is no such file.
    """
    text, known = str(name), shipped_names(folder)
    if text in known:
        path = config_path(folder, f"{text}.yaml")
    elif Path(text).suffix in (".yaml", ".yml"):
        path = Path(text)
    else:
        raise ValueError(f"{kind} {text!r} is unknown; known {kind}s: {', '.join(known)}, or a .yaml file")
    if not path.is_file():
        raise FileNotFoundError(f"no {kind} file at {path}")
    try:
        return path, yaml.safe_load(path.read_text(encoding="utf-8"))
    except yaml.YAMLError as error:
        raise ValueError(f"{path} is not valid YAML: {' '.join(str(error).split())}") from error


def load_named(cls: type[T], kind: str, folder: str, name: str | Path) -> T:
    """A dataclass with the field `name` from a shipped YAML file or any; the file's name where it gives none.

    The arguments are those of `read_named`.

    Raises:
        ValueError: as there, or the file does not fit the dataclass; names the file, the place and what is allowed.
        FileNotFoundError: there is no such file.
    """
    path, data = read_named(kind, folder, name)
    try:
        return from_mapping(cls, {"name": path.stem, **data} if isinstance(data, Mapping) else data)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def load(cls: type[T], path: Path) -> T:
    """Read a preset file.

    Raises:
        FileNotFoundError: the file is missing.
        ValueError: it is not YAML, or does not fit the dataclass; names the file.
    """
    try:
        data = yaml.safe_load(path.read_text(encoding="utf-8"))
    except yaml.YAMLError as error:
        raise ValueError(f"{path} is not valid YAML: {error}") from error
    try:
        return from_mapping(cls, {} if data is None else data)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def to_mapping(config: Any) -> Any:
    """The dataclass as plain mappings, lists and scalars, ready for YAML or JSON."""
    if dataclasses.is_dataclass(config) and not isinstance(config, type):
        return {f.name: to_mapping(getattr(config, f.name)) for f in dataclasses.fields(config)}
    if isinstance(config, collections.abc.Mapping):
        return {str(key): to_mapping(value) for key, value in config.items()}
    if isinstance(config, list | tuple):
        return [to_mapping(value) for value in config]
    if isinstance(config, Path):
        return str(config)
    return config


def save(config: Any, path: Path) -> None:
    """Write a dataclass as YAML."""
    path.write_text(yaml.safe_dump(to_mapping(config), sort_keys=False), encoding="utf-8")


def _is_required(field: dataclasses.Field[Any]) -> bool:
    return field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING


def _convert(hint: Any, value: Any, path: str, field: dataclasses.Field[Any]) -> Any:
    origin, args = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        if value is None and type(None) in args:
            return None
        (hint,) = [a for a in args if a is not type(None)][:1]
        return _convert(hint, value, path, field)
    if dataclasses.is_dataclass(hint) and isinstance(hint, type):
        return from_mapping(hint, value, path)
    if origin is collections.abc.Mapping:
        if not isinstance(value, collections.abc.Mapping):
            raise ValueError(f"{path} must be a mapping, got {value!r}")
        default = field.default_factory() if field.default_factory is not dataclasses.MISSING else {}
        return {**default, **{k: _convert(args[1], v, f"{path}.{k}", field) for k, v in value.items()}}
    if origin is tuple:
        if not isinstance(value, list | tuple):
            raise ValueError(f"{path} must be a list, got {value!r}")
        inner = args[0]
        return tuple(_convert(inner, v, f"{path}[{i}]", field) for i, v in enumerate(value))
    if hint is float:
        return _number(value, path)
    if hint is bool and not isinstance(value, bool):
        raise ValueError(f"{path} must be true or false, got {value!r}")
    if hint is int and (isinstance(value, bool) or not isinstance(value, int)):
        raise ValueError(f"{path} must be a whole number, got {value!r}")
    if hint is str and not isinstance(value, str):
        raise ValueError(f"{path} must be text, got {value!r}")
    if hint is Path:
        return Path(str(value))
    return value


def _number(value: Any, path: str) -> float:
    if isinstance(value, str):
        try:  # YAML 1.1 reads 1e-3 as text
            return float(value)
        except ValueError:
            pass
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"{path} must be a number, got {value!r}")
    return float(value)
