"""The two clocks that firmware and edge read: real time for people, steps for tests.

Every time-out, ramp and timestamp reads a clock, never a count of steps. So the same code runs in lockstep at many
times real time, and keeps its promises in wall-clock time when a slow machine simulates slower than real time.
"""

from __future__ import annotations

import time
from typing import Protocol

MICROSECONDS = 1_000_000
"""Microseconds in a second. Times are integers in this unit, so that sums of 5 ms steps stay exact."""


class Clock(Protocol):
    """What firmware and edge need of a clock."""

    def now_us(self) -> int:
        """Microseconds since the clock was made; never goes back."""
        ...

    def realtime_us(self) -> int:
        """Microseconds since the Unix epoch (CLOCK_REALTIME)."""
        ...


class WallClock:
    """Real time. The simulated robot runs in a thread of its own and keeps up with it, or says that it cannot."""

    def __init__(self) -> None:
        self._start = time.monotonic_ns()

    def now_us(self) -> int:
        return (time.monotonic_ns() - self._start) // 1000

    def realtime_us(self) -> int:
        return time.time_ns() // 1000


class StepClock:
    """Simulated time: moves only when the robot is stepped. Two runs with the same commands read the same times."""

    EPOCH_US = 1_767_225_600 * MICROSECONDS
    """Default start of the simulated real time: 2026-01-01T00:00:00Z."""

    def __init__(self, epoch_us: int = EPOCH_US) -> None:
        self._epoch_us = epoch_us
        self._now_us = 0

    def now_us(self) -> int:
        return self._now_us

    def realtime_us(self) -> int:
        return self._epoch_us + self._now_us

    def advance(self, microseconds: int) -> None:
        """Move time forward.

        Raises:
            ValueError: the step is not positive.
        """
        if microseconds <= 0:
            raise ValueError(f"a clock moves forward: microseconds must be > 0, got {microseconds}")
        self._now_us += microseconds
