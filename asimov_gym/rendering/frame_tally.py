"""What became of the pictures that were asked of a camera."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

WINDOW_S = 2.0
"""Time over which the rate is measured, s."""


@dataclass(frozen=True)
class FrameCounts:
    """Pictures of one camera since it was ready; `asked` is the sum of the three below it."""

    asked: int
    delivered: int
    dropped: int
    """Skipped because a newer one was wanted by then, or could be had."""
    pending: int
    """Asked for and not decided yet."""
    achieved_fps: float
    """Pictures delivered per second over the last two seconds; 0 when none was."""


class FrameTally:
    """Counts pictures by the running number of the poses they show, from 0. A number that is passed over was dropped.

    Args:
        now: a clock in seconds that never goes back.
    """

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self._now = now
        self._asked = self._delivered = self._decided = 0
        self._times: deque[float] = deque()

    def ask(self, count: int) -> None:
        """`count` more pictures are wanted."""
        self._asked += count

    def deliver(self, sequence: int) -> None:
        """The picture of a pose came; those before it that did not come never will."""
        self._delivered += 1
        self._decided = sequence + 1
        self._times.append(self._now())
        self._forget()

    def counts(self) -> FrameCounts:
        """The figures now."""
        self._forget()
        # The first time in the window starts the first interval.
        span = self._now() - self._times[0] if len(self._times) > 1 else 0.0
        rate = (len(self._times) - 1) / span if span > 0.0 else 0.0
        dropped = self._decided - self._delivered
        return FrameCounts(self._asked, self._delivered, dropped, self._asked - self._decided, rate)

    def _forget(self) -> None:
        oldest = self._now() - WINDOW_S
        while self._times and self._times[0] < oldest:
            self._times.popleft()
