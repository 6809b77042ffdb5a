"""Files from which the step of a diverged copy can be repeated."""

from __future__ import annotations

import logging
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

if TYPE_CHECKING:
    from asimov_gym.envs.functional.env import FunctionalEnv

_log = logging.getLogger(__name__)


class DivergenceDump:
    """Writes the world before a step, the action and the random numbers of copies that diverged in it.

    Args:
        folder: where the files go, one for each step with diverged copies: `diverged_000001.npz` and so on.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._count = 0
        self._lock = threading.Lock()

    def watch(self, world: Any, action: Any, draws: Any, diverged: Any) -> None:
        """Write a file if any copy diverged; works inside compiled functions."""
        step = {"world": world, "action": action, "draws": dict(draws)}
        # Without empty arrays: XLA loses count of them in a branch with a callback.
        arrays = {_name(path): leaf for path, leaf in jax.tree_util.tree_leaves_with_path(step) if leaf.size}
        jax.lax.cond(
            jnp.any(diverged),
            lambda: jax.debug.callback(self._write, arrays, diverged),
            lambda: None,
        )

    def _write(self, arrays: Mapping[str, Any], diverged: Any) -> None:
        bad = np.flatnonzero(np.asarray(diverged))
        if not len(bad):  # a branch that `jax.vmap` has made into a selection
            return
        rows = {name: np.asarray(array)[bad] for name, array in arrays.items()}
        with self._lock:
            self._count += 1
            path = self._folder / f"diverged_{self._count:06d}.npz"
        self._folder.mkdir(parents=True, exist_ok=True)
        np.savez(path, allow_pickle=False, **rows)
        _log.warning("simulation of %d copies diverged; their state is in %s", len(bad), path)


def read_dump(env: FunctionalEnv, path: Path) -> tuple[Any, np.ndarray, dict[str, np.ndarray]]:
    """What a dump holds: world, actions (n, m) and random numbers of n copies.

    `env.advance(world, action, draws)` repeats the step.

    Raises:
        ValueError: the file is not of an environment of this kind.
    """
    with np.load(path) as file:
        arrays = dict(file)
    copies = len(arrays["action"]) if "action" in arrays else 0

    def fill(place: Any, leaf: Any) -> np.ndarray:
        name, shape = _name((jax.tree_util.DictKey("world"), *place)), leaf.shape[1:]
        if 0 in shape:
            return np.zeros((copies, *shape), dtype=leaf.dtype)
        if name not in arrays or arrays[name].shape[1:] != shape:
            raise ValueError(f"{path} is not of this environment: it lacks {name} of shape (n, *{shape})")
        return arrays[name]

    world = jax.tree_util.tree_map_with_path(fill, env.shapes().pipeline_state)
    draws = {name.removeprefix("draws."): value for name, value in arrays.items() if name.startswith("draws.")}
    return world, arrays["action"], draws


def _name(path: Any) -> str:
    """Name of a leaf, such as `world.simulation.qpos`."""
    return jax.tree_util.keystr(path, simple=True, separator=".")
