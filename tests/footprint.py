"""What a process and its objects take up, for tests that nothing grows and nothing is left behind."""

from __future__ import annotations

import gc
import logging
import os
import resource
import sys
import threading
import time
import types
from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path

_STATM = Path("/proc/self/statm")
_NOT_ENTERED = (
    type,
    types.ModuleType,
    types.FunctionType,
    types.BuiltinFunctionType,
    types.CodeType,
    types.FrameType,
    logging.Logger,
    logging.Handler,
    threading.Thread,
)
"""Doors to the rest of the program: what lies behind them belongs to nobody in particular."""


@dataclass(frozen=True)
class Footprint:
    """Threads, open files and memory of this process at one moment."""

    threads: tuple[str, ...]
    """Names of the Python threads, sorted."""
    files: int
    """Open file descriptors."""
    memory_mib: float
    """Resident memory; where the system does not tell, the largest there was."""

    @classmethod
    def now(cls) -> Footprint:
        """Of this moment, after a collection of garbage."""
        gc.collect()
        names = tuple(sorted(thread.name for thread in threading.enumerate()))
        return cls(names, len(os.listdir("/dev/fd")), _memory_mib())


def _memory_mib() -> float:
    if _STATM.exists():
        return int(_STATM.read_text().split()[1]) * os.sysconf("SC_PAGESIZE") / 2**20
    largest = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return largest / (2**20 if sys.platform == "darwin" else 2**10)


def held_bytes(root: object, without: Collection[object] = ()) -> int:
    """Bytes of all Python objects that can be reached from `root`: a list that grows somewhere inside shows here.

    Args:
        root: where to begin.
        without: objects that are not entered, such as ones that may grow.
    """
    seen = {id(one) for one in without}
    waiting, total = [root], 0
    while waiting:
        one = waiting.pop()
        if id(one) in seen or isinstance(one, _NOT_ENTERED):
            continue
        seen.add(id(one))
        total += sys.getsizeof(one)
        waiting.extend(gc.get_referents(one))
    return total


def eventually(condition: Callable[[], bool], what: str, timeout: float = 10.0) -> None:
    """Wait until a condition holds.

    Raises:
        AssertionError: it does not within `timeout` seconds; `what` says what was waited for.
    """
    end = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < end, f"not within {timeout:g} s: {what}"
        time.sleep(0.001)
