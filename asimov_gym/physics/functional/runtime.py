"""JAX on the machine at hand: the settings it needs before it starts up, and a cache of what it has compiled."""

from __future__ import annotations

import importlib.util
import logging
import os
import sys
import warnings
from pathlib import Path

_log = logging.getLogger(__name__)
_LEAST_THREADS = 4
_SOUND_CACHE = (0, 6, 2)
"""First version of JAX seen to compute the same with what it reads from its cache as with what it compiled. With 0.5.3
a step of the robot on the CPU comes out differently."""
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

    It acts on every function that this process compiles from now on, and takes a third of a second for at least.
    Functions with callbacks, such as environments on C physics, are never kept: they compile fast.

    Args:
        folder: where; `asimov-gym/xla` in the user's cache folder when None.

    Returns:
        The folder.

    Raises:
        RuntimeError: this version of JAX computes something else with what it reads from its cache.
    """
    import jax

    if jax.__version_info__ < _SOUND_CACHE:
        needed = ".".join(map(str, _SOUND_CACHE))
        raise RuntimeError(
            f"the compile cache of JAX {jax.__version__} gives wrong results, it needs {needed} or newer"
        )
    if folder is None:
        folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "asimov-gym" / "xla"
    path = Path(folder)
    path.mkdir(parents=True, exist_ok=True)
    jax.config.update("jax_compilation_cache_dir", str(path))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.3)
    return path


def keep_what_is_compiled() -> Path | None:
    """Switch the compile cache on, unless whoever runs this has decided: by `enable_compile_cache`, by JAX's own
    JAX_COMPILATION_CACHE_DIR, or by JAX_ENABLE_COMPILATION_CACHE=false.

    Returns:
        The folder; None where nothing is kept: where it is not a folder on this machine, or this version of JAX reads
        its cache wrongly.
    """
    import jax

    if jax.__version_info__ < _SOUND_CACHE or not jax.config.values["jax_enable_compilation_cache"]:
        return None
    chosen = jax.config.values["jax_compilation_cache_dir"]
    if chosen:
        return None if "://" in chosen else Path(chosen)
    try:
        return enable_compile_cache()
    except OSError as error:
        _log.warning("what is compiled is not kept for the next start: %s", error)
        return None
