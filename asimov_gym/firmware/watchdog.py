"""The loop watched by itself: how long a control step takes, how regular it is, and whether it came to a stop."""

from __future__ import annotations

from dataclasses import dataclass

from asimov_gym.firmware.alerts import AlertBoard
from asimov_gym.firmware.clock import MICROSECONDS
from asimov_gym.robot.alerts import AlertId


@dataclass(frozen=True)
class CycleTime:
    """Timing of the control steps of the last second, wall clock: it differs from run to run, in lockstep too."""

    max_us: int = 0
    """Longest control step, microseconds."""
    avg_us: int = 0
    """Mean of the control steps, microseconds."""
    jitter_us: int = 0
    """Largest departure of the time between two starts from the period, microseconds, positive when late; 0 in
    lockstep, which has no period in wall time."""


class Watchdog:
    """Measures the loop; bites when it has stood still.

    Args:
        period_us: time between two control steps.
        limit_s: a gap of this many seconds between two control steps is a fault.
        realtime: whether the loop keeps wall time; a lockstep loop may pause for as long as it likes.
    """

    def __init__(self, period_us: int, limit_s: float, realtime: bool) -> None:
        self._period_us = period_us
        self._limit_us = limit_s * MICROSECONDS
        self._realtime = realtime
        self._window = max(1, MICROSECONDS // period_us)
        self.cycle = CycleTime()
        """Of the last full second."""
        self.reset()

    def reset(self) -> None:
        """The loop starts, or starts again after a pause that was meant: the gap before it is no fault."""
        self._last_us: int | None = None
        self._clear()

    def _clear(self) -> None:
        self._count = 0
        self._sum_s = self._max_s = 0.0
        self._jitter_us = 0

    def check(self, board: AlertBoard, now_us: int) -> bool:
        """A control step starts. True if a stall before it latched DAMP just now.

        Args:
            board: takes the alert.
            now_us: firmware time.
        """
        last, self._last_us = self._last_us, now_us
        if not self._realtime or last is None:
            return False
        gap = now_us - last
        late = gap - self._period_us
        if abs(late) > abs(self._jitter_us):
            self._jitter_us = late
        if gap < self._limit_us:
            return False
        return board.set(AlertId.WATCHDOG_TIMEOUT, now_us, gap // 1000, round(self._limit_us / 1000))

    def add(self, seconds: float) -> None:
        """A control step has taken this long, wall clock."""
        self._count += 1
        self._sum_s += seconds
        if seconds > self._max_s:
            self._max_s = seconds
        if self._count == self._window:
            average = self._sum_s / self._count
            self.cycle = CycleTime(round(1e6 * self._max_s), round(1e6 * average), self._jitter_us)
            self._clear()
