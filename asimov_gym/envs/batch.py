"""What an environment runs on: N robots at a task, stepped together. Single and vector environments share it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import gymnasium as gym
import numpy as np

from asimov_gym.physics import CPhysics

Observation = Any
"""An array whose first axis is the copies, or a dictionary of such arrays."""
Info = dict[str, Any]
"""Arrays whose first axis is the copies, or dictionaries of such arrays."""


@dataclass(frozen=True)
class BatchStep:
    """Outcome of a step of N copies. No copy has been restarted yet; every array is new."""

    observation: Observation
    reward: np.ndarray
    """(N,) float32."""
    terminated: np.ndarray
    """(N,) bool."""
    truncated: np.ndarray
    """(N,) bool."""
    info: Info


class EnvBatch(Protocol):
    """N robots at a task. It never starts an episode by itself."""

    @property
    def copies(self) -> int: ...

    @property
    def physics(self) -> CPhysics: ...

    @property
    def observation_space(self) -> gym.Space[Any]:
        """Of one copy."""
        ...

    @property
    def action_space(self) -> gym.spaces.Box[Any]:
        """Of one copy."""
        ...

    @property
    def option_names(self) -> tuple[str, ...]:
        """Options that `restart` knows."""
        ...

    def seed(self, seeds: Sequence[int]) -> None:
        """Give each copy its own random stream; it acts from the next `restart` on."""
        ...

    def restart(self, which: np.ndarray, options: Mapping[str, Any]) -> tuple[Observation, Info]:
        """Start the next episode of the copies in the mask `which`, (N,) bool; only their rows of the result count.

        Raises:
            ValueError: an option has a wrong value.
        """
        ...

    def step(self, action: np.ndarray) -> BatchStep:
        """One control step of every copy; `action` is checked: finite, float32, first axis the copies."""
        ...

    def markers(self, copy: int) -> np.ndarray:
        """Points to show beside the robot, world frame, m, (M, 3)."""
        ...

    def close(self) -> None:
        """Stop the physics threads."""
        ...


def check_action(action: Any, shape: tuple[int, ...]) -> np.ndarray:
    """The action as a new float32 array.

    Raises:
        ValueError: a wrong shape, or an entry that is not finite; names the entry.
    """
    array = np.array(action, dtype=np.float32)
    if array.shape != shape:
        raise ValueError(f"action must have shape {shape}, got {array.shape}")
    if not np.isfinite(array).all():
        place = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        index = ", ".join(map(str, place))
        raise ValueError(f"action[{index}] must be a finite number, got {array[place]}")
    return array


def check_options(options: Mapping[str, Any] | None, known: tuple[str, ...]) -> Mapping[str, Any]:
    """The options of a reset.

    Raises:
        ValueError: an unknown name; the message lists the known ones.
    """
    options = {} if options is None else options
    unknown = sorted(set(options) - set(known))
    if unknown:
        raise ValueError(f"reset options {unknown} are unknown; known options: {', '.join(known) or 'none'}")
    return options


def check_flag(name: str, value: Any) -> bool:
    """Raise ValueError unless `value` is True or False."""
    if not isinstance(value, bool | np.bool_):
        raise ValueError(f"{name} must be True or False, got {value!r}")
    return bool(value)


def row(values: Any, copy: int) -> Any:
    """The part of one copy in arrays or dictionaries of arrays; scalars become Python's own, arrays are copied."""
    if isinstance(values, Mapping):
        return {key: row(value, copy) for key, value in values.items()}
    entry = values[copy]
    if isinstance(entry, np.ndarray):
        return entry.copy()
    return entry.item() if isinstance(entry, np.generic) else entry


def replace_rows(values: Any, which: np.ndarray, fresh: Any) -> Any:
    """`values` with the rows of the mask `which` taken from `fresh`; arrays or dictionaries of arrays."""
    if isinstance(values, Mapping):
        return {key: replace_rows(value, which, fresh[key]) for key, value in values.items()}
    result = np.array(values)
    result[which] = fresh[which]
    return result


def masked_info(parts: Sequence[tuple[np.ndarray, Info]]) -> Info:
    """Infos in the form of Gymnasium's vector environments: beside each key, `_key` says which copies it speaks of.

    Args:
        parts: pairs of a mask (N,) bool and the info of the copies in it; the masks do not overlap. What needs no
            change is handed on, not copied.
    """
    if len(parts) == 1 and parts[0][0].all():  # most steps: nothing to join, nothing to blank out
        return _of_all(*parts[0])
    result: Info = {}
    for key in dict.fromkeys(key for _, info in parts for key in info):
        having = [(mask, info[key]) for mask, info in parts if key in info]
        covered = np.logical_or.reduce([mask for mask, _ in having])
        first = having[0][1]
        if isinstance(first, Mapping):
            result[key] = masked_info(having)
        else:
            array = np.array(first)
            array[~covered] = None if first.dtype == object else 0
            for mask, values in having[1:]:
                array[mask] = values[mask]
            result[key] = array
        result[f"_{key}"] = covered
    return result


def _of_all(everyone: np.ndarray, info: Mapping[str, Any]) -> Info:
    """The info of all copies in the form of `masked_info`."""
    result: Info = {}
    for key, values in info.items():
        result[key] = _of_all(everyone, values) if isinstance(values, Mapping) else values
        result[f"_{key}"] = everyone.copy()
    return result
