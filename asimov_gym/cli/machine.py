"""The machine that a measurement was made on, without anything that tells whose it is."""

from __future__ import annotations

import os
import platform
import re
import subprocess
from dataclasses import dataclass
from pathlib import Path

from asimov_gym.versions import installed_versions
from train.hardware import gpu_names

PACKAGES = (
    "gymnasium",
    "mujoco",
    "numpy",
    "onnxruntime",
    "rsl-rl-lib",
    "torch",
    "brax",
    "jax",
    "mujoco-mjx",
    "mujoco-warp",
    "warp-lang",
)
"""Distributions that speed depends on."""
BUSY = 0.5
"""Load average above which measurements are disturbed."""


@dataclass(frozen=True)
class Machine:
    """What speed depends on."""

    cpu: str
    """Model of the processor."""
    cores: int
    """Logical ones that this process may use."""
    memory_gb: float
    gpus: tuple[str, ...]
    """Models of the NVIDIA GPUs."""
    system: str
    python: str
    packages: dict[str, str]
    """Versions of what is installed of `PACKAGES`."""

    @classmethod
    def this(cls) -> Machine:
        """The machine at hand."""
        packages = installed_versions(PACKAGES)
        return cls(_cpu(), cores(), _memory_gb(), gpu_names(), _system(), platform.python_version(), packages)

    @property
    def name(self) -> str:
        """A file name for it: processor, cores, and GPU where there is one."""
        words = " ".join([self.cpu, f"{self.cores} cores", *self.gpus[:1]])
        return re.sub(r"[^a-z0-9]+", "_", words.lower()).strip("_")


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def load_average() -> float | None:
    """Mean number of busy programs over the last minute; None where the system does not say."""
    return round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None


def peak_memory_mb() -> float | None:
    """The most memory that this process has held so far; None where the system does not say."""
    try:
        import resource
    except ModuleNotFoundError:  # Windows
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 2**20 if platform.system() == "Darwin" else peak / 2**10


def _cpu() -> str:
    found = ""
    if Path("/proc/cpuinfo").exists():
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
        match = re.search(r"^model name\s*:\s*(.+)$", text, flags=re.MULTILINE)
        found = match[1] if match else ""
    elif platform.system() == "Darwin":
        found = _output("sysctl", "-n", "machdep.cpu.brand_string")
    cleaned = re.sub(r"\((?:r|tm)\)|@.*|\bcpu\b|\bprocessor\b", " ", found, flags=re.IGNORECASE)
    return " ".join(cleaned.split()) or platform.processor() or platform.machine()


def _memory_gb() -> float:
    if not hasattr(os, "sysconf") or "SC_PHYS_PAGES" not in os.sysconf_names:
        return float("nan")
    return round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30, 1)


def _system() -> str:
    try:
        name = platform.freedesktop_os_release()["PRETTY_NAME"]
    except (OSError, KeyError):
        name = f"{platform.system()} {platform.release()}"
    return f"{name}, {platform.machine()}"


def _output(*command: str) -> str:
    """What a command prints; nothing where it fails."""
    try:
        return subprocess.run(command, capture_output=True, text=True, timeout=10, check=True).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return ""
