"""How the tests of the Brax learner set JAX up, and when they are skipped."""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Iterator
from pathlib import Path

MODULES = ("torch", "rsl_rl", "tensorboard", "brax", "flax", "optax", "mujoco.mjx")


def why_absent() -> str | None:
    """Why the learner's tests are skipped; None where it is installed."""
    absent = [module for module in MODULES if importlib.util.find_spec(module.partition(".")[0]) is None]
    return f"{absent[0]} is not installed: pip install 'asimov-gym[brax]'" if absent else None


def quick_to_compile(cache: Path) -> Iterator[None]:
    """JAX with little optimisation, which halves the time of tests, and with a compile cache of their own."""
    import jax

    before, home = jax.config.values["jax_compilation_cache_dir"], os.environ.get("XDG_CACHE_HOME")
    os.environ["XDG_CACHE_HOME"] = str(cache)
    jax.config.update("jax_disable_most_optimizations", True)
    yield
    jax.config.update("jax_disable_most_optimizations", False)
    jax.config.update("jax_compilation_cache_dir", before)
    os.environ.pop("XDG_CACHE_HOME") if home is None else os.environ.update(XDG_CACHE_HOME=home)
