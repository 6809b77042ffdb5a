"""JAX on the machine at hand: the settings it needs before it starts up, and a cache of what it has compiled."""

from __future__ import annotations

import importlib.util
import os
import sys
import warnings
from pathlib import Path

_LEAST_THREADS = 4
EXTRA = "pip install 'asimov-gym[mjx]'"
"""How to get what this part of the package needs."""


def prepare() -> None:
    """Make sure that JAX is there, and set it up for machines with few cores.

    XLA's thread pool on the CPU is as large as the machine has cores. With fewer than four, batches of more than about
    60 robots wait for each other for ever; the environment variable NPROC makes the pool larger. XLA reads it when JAX
    starts up.

    Raises:
        ModuleNotFoundError: JAX or MJX is not installed; says how to get them.
    """
    for module, package in (("jax", "jax"), ("mujoco.mjx", "mujoco-mjx")):
        if importlib.util.find_spec(module) is None:
            raise ModuleNotFoundError(f"{package} is not installed, which environments on JAX need: {EXTRA}")
    if (os.cpu_count() or 1) >= _LEAST_THREADS or "NPROC" in os.environ:
        return
    os.environ["NPROC"] = str(_LEAST_THREADS)
    if _has_started():
        warnings.warn(
            f"JAX started up with a pool of {os.cpu_count()} threads, in which large batches on the CPU can hang: "
            f"import asimov_gym.envs.functional first, or set the environment variable NPROC={_LEAST_THREADS}",
            RuntimeWarning,
            stacklevel=3,
        )


def _has_started() -> bool:
    """Whether JAX has made its devices, after which its settings are fixed."""
    bridge = sys.modules.get("jax._src.xla_bridge")
    return bool(getattr(bridge, "_backends", None))


def enable_compile_cache(folder: Path | str | None = None) -> Path:
    """Keep what JAX compiles on disk, so that a second start takes seconds instead of minutes.

    It acts on every function that this process compiles from now on, and takes at least a second for. Functions with
    callbacks, such as environments on C physics, are never kept: they compile fast.

    Args:
        folder: where; `asimov-gym/xla` in the user's cache folder when None.

    Returns:
        The folder.
    """
    import jax

    if folder is None:
        folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "asimov-gym" / "xla"
    path = Path(folder)
    path.mkdir(parents=True, exist_ok=True)
    jax.config.update("jax_compilation_cache_dir", str(path))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 1.0)
    return path
