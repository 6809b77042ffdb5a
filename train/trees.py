"""Trees of arrays by name, as checkpoints hold them: they outlive the classes that the trees are made of."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import asimov_gym.physics.functional  # noqa: F401  (first: it prepares JAX before anything starts it)

# isort: split
import jax
import numpy as np


def named(tree: Any, read: Callable[[jax.Array], np.ndarray] = np.array) -> dict[str, np.ndarray]:
    """Arrays by the path to them, such as `pipeline_state.task.phase`.

    Args:
        tree: of arrays.
        read: copies one to NumPy.
    """
    return {_name(path): read(leaf) for path, leaf in jax.tree_util.tree_leaves_with_path(tree)}


def filled(shapes: Any, arrays: Mapping[str, np.ndarray], put: Callable[[np.ndarray], Any]) -> Any:
    """The tree that `named` took apart.

    Args:
        shapes: a tree of the same kind with the shape and type of each array.
        arrays: by name.
        put: makes an array of JAX of one.

    Raises:
        ValueError: an array is missing or has another shape: the checkpoint is of other settings.
    """

    def fill(path: Any, leaf: Any) -> Any:
        name = _name(path)
        found = arrays.get(name)
        if found is None or found.shape != leaf.shape:
            has = "nothing" if found is None else f"shape {found.shape}"
            raise ValueError(
                f"the checkpoint does not fit these settings: {name} must have shape {leaf.shape}, got {has}"
            )
        return put(found.astype(leaf.dtype))

    return jax.tree_util.tree_map_with_path(fill, shapes)


def _name(path: Any) -> str:
    return jax.tree_util.keystr(path, simple=True, separator=".")
