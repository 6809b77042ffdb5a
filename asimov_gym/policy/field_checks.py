"""Checks of a contract's fields: each returns the value in its final type or names the field that is wrong."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np


class ContractError(ValueError):
    """A policy's contract is malformed or the robot cannot honour it.

    Attributes:
        field: metadata key at fault, with an index where one entry is, such as `joint_stiffness[3]`.
        value: what it holds.
        allowed: what it may hold, in words.
    """

    def __init__(self, field: str, value: object, allowed: str) -> None:
        super().__init__(f"policy contract: {field} is {_shorten(value)}; allowed: {allowed}")
        self.field = field
        self.value = value
        self.allowed = allowed


class _Missing:
    def __repr__(self) -> str:
        return "missing"


_MISSING = _Missing()


def _shorten(value: object, limit: int = 160) -> str:
    text = repr(value)
    return text if len(text) <= limit else f"{text[:limit]}... ({len(text)} characters)"


def json_value(metadata: Mapping[str, str], key: str, default: str | None = None) -> Any:
    """Value of a metadata key.

    Raises:
        ContractError: the key is missing without a default, or its text is not JSON.
    """
    text = metadata.get(key, default)
    if text is None:
        raise ContractError(key, _MISSING, "a key that every policy file has in its metadata")
    try:
        return json.loads(text)
    except json.JSONDecodeError:
        raise ContractError(key, text, "JSON text") from None


def number(name: str, value: Any, *, low: float = -math.inf, above: float = -math.inf) -> float:
    """A finite number of at least `low` and above `above`."""
    is_number = isinstance(value, int | float | np.floating | np.integer) and not isinstance(value, bool)
    # Compared before it is converted: JSON may hold whole numbers that no float can.
    is_finite = is_number and -sys.float_info.max <= value <= sys.float_info.max
    if not is_finite or value < low or value <= above:
        bound = f" of at least {low:g}" if low > -math.inf else f" above {above:g}" if above > -math.inf else ""
        raise ContractError(name, value, f"a finite number{bound}")
    return float(value)


def whole(name: str, value: Any) -> int:
    """A whole number of at least 1."""
    if not isinstance(value, int) or isinstance(value, bool) or value < 1:
        raise ContractError(name, value, "a whole number of at least 1")
    return value


def _sequence(name: str, value: Any, allowed: str, length: int | None = None) -> Sequence[Any]:
    if not isinstance(value, Sequence | np.ndarray) or isinstance(value, str):
        raise ContractError(name, value, allowed)
    if length is not None and len(value) != length:
        raise ContractError(name, value, f"{allowed} ({len(value)} are given)")
    return value  # type: ignore[return-value]


def numbers(name: str, value: Any, n: int, **bounds: float) -> tuple[float, ...]:
    """`n` numbers, each within `bounds` as for `number`."""
    values = _sequence(name, value, f"{n} numbers, one per joint", n)
    return tuple(number(f"{name}[{i}]", entry, **bounds) for i, entry in enumerate(values))


def pairs(name: str, value: Any, n: int) -> tuple[tuple[float, float], ...]:
    """`n` pairs of finite numbers, each ordered low to high."""
    entries = _sequence(name, value, f"{n} pairs [low, high]", n)
    return tuple(_pair(f"{name}[{i}]", entry) for i, entry in enumerate(entries))


def _pair(name: str, value: Any) -> tuple[float, float]:
    pair = _sequence(name, value, "a pair [low, high]", 2)
    low, high = number(f"{name}[0]", pair[0]), number(f"{name}[1]", pair[1])
    if low > high:
        raise ContractError(name, [low, high], "a pair in order, low to high")
    return low, high


def strings(name: str, value: Any) -> tuple[str, ...]:
    """A list of strings."""
    entries = _sequence(name, value, "a list of strings")
    for i, entry in enumerate(entries):
        if not isinstance(entry, str):
            raise ContractError(f"{name}[{i}]", entry, "a string")
    return tuple(entries)
