"""Which learner on which engine: as asked, or what the machine is best at; and whether that can run here."""

from __future__ import annotations

import importlib.util
import os
import platform
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from train.config import PpoConfig

_NEEDS = {
    "brax": (("brax", "flax", "optax", "jax", "mujoco.mjx"), "pip install 'asimov-gym[brax]'"),
    "rsl_rl": (("rsl_rl", "tensordict"), "pip install 'asimov-gym[train]'"),
    "mjx": (("jax", "mujoco.mjx"), "pip install 'asimov-gym[mjx]'"),
    "warp": (("jax", "mujoco.mjx", "warp"), "pip install 'asimov-gym[mjx]' 'mujoco-mjx[warp]'"),
}
"""Modules of each learner and engine, and how to get them."""


def settled(config: PpoConfig) -> tuple[PpoConfig, str]:
    """The settings with learner and engine filled in, and the reason in words.

    With an NVIDIA GPU that JAX sees it is Brax on MJX, else rsl-rl on C physics.

    Raises:
        ValueError: the combination cannot run here; says what to do.
    """
    gpu = why_no_gpu() if None in (config.library, config.physics) else ""
    library, physics, reasons = config.library, config.physics, []
    if library is None or physics is None:
        reasons.append("JAX sees an NVIDIA GPU" if gpu is None else gpu)
    if library is None:
        library = "brax" if gpu is None and missing("brax") is None else "rsl_rl"
        if gpu is None and library == "rsl_rl":
            reasons.append(f"Brax is not installed ({_NEEDS['brax'][1]})")
    if physics is None:
        physics = "mjx" if gpu is None and missing("mjx") is None else "c"
    chosen = replace(config, library=library, physics=physics)
    check(chosen, gpu)
    return chosen, "; ".join(reasons) or "as asked"


def check(config: PpoConfig, gpu: str | None = "") -> None:
    """Make sure that the learner and the engine of the settings can run here.

    Args:
        config: settings with both filled in.
        gpu: what `why_no_gpu` said, where it was asked already.

    Raises:
        ValueError: they cannot; says what to do.
    """
    for what, name in (("learner", config.library), ("physics", config.physics)):
        if name is not None and (module := missing(name)) is not None:
            raise ValueError(f"{what} {name} needs {module}, which is not installed: {_NEEDS[name][1]}")
    if config.physics != "warp" and not (config.library == "brax" and config.device == "cuda"):
        return
    gpu = why_no_gpu() if gpu == "" else gpu
    if gpu is None:
        return
    if config.physics == "warp":
        raise ValueError(f"physics warp needs an NVIDIA GPU, and {gpu}: use --physics mjx, or --physics c on a CPU")
    raise ValueError(f"device cuda needs a GPU that JAX sees for learner brax, and {gpu}: use --device cpu")


def missing(name: str) -> str | None:
    """The first module of a learner or an engine that is not installed; None when all are."""
    modules, _ = _NEEDS.get(name, ((), ""))
    return next((module for module in modules if not _found(module)), None)


def why_no_gpu() -> str | None:
    """Why JAX cannot use an NVIDIA GPU here, in words; None where it can."""
    if not has_nvidia():
        return "there is no NVIDIA GPU here"
    if missing("mjx") is not None:
        return "there is an NVIDIA GPU here but JAX is not installed (pip install 'asimov-gym[brax]' 'jax[cuda12]')"
    if jax_platform() != "gpu":
        return "there is an NVIDIA GPU here but JAX does not see it (pip install 'jax[cuda12]')"
    return None


def has_nvidia() -> bool:
    """Whether an NVIDIA driver is there. (Asking JAX would take seconds.)"""
    return shutil.which("nvidia-smi") is not None or Path("/proc/driver/nvidia/version").exists()


def jax_platform() -> str:
    """Where JAX computes: `cpu`, `gpu` or `tpu`; empty where it does not start.

    A process of its own asks, because JAX that has started cannot be joined with that of other ranks any more, and
    takes a GPU's memory.
    """
    asked = subprocess.run(
        [sys.executable, "-c", "import jax; print(jax.default_backend())"], capture_output=True, text=True, check=False
    )
    return asked.stdout.strip()


def machine() -> str:
    """System, processor cores and GPUs of this machine, in words."""
    gpus = gpu_names()
    graphics = f"{len(gpus)} × {gpus[0]}" if gpus else "no GPU"
    return f"{platform.system()}, {platform.machine()}, {os.cpu_count()} cores, {graphics}"


def gpu_names() -> tuple[str, ...]:
    """Models of the NVIDIA GPUs."""
    if shutil.which("nvidia-smi") is None:
        return ()
    command = ["nvidia-smi", "--query-gpu=name", "--format=csv,noheader"]
    asked = subprocess.run(command, capture_output=True, text=True, check=False)
    return tuple(asked.stdout.strip().splitlines()) if asked.returncode == 0 else ()


def _found(module: str) -> bool:
    top, _, _ = module.partition(".")
    return importlib.util.find_spec(top) is not None and importlib.util.find_spec(module) is not None
