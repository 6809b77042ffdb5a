from __future__ import annotations

import time

import pytest

from asimov_gym.firmware import StepClock, WallClock


def test_step_clock_moves_only_when_advanced() -> None:
    clock = StepClock(epoch_us=1_000)
    assert (clock.now_us(), clock.realtime_us()) == (0, 1_000)
    clock.advance(5_000)
    assert (clock.now_us(), clock.realtime_us()) == (5_000, 6_000)
    with pytest.raises(ValueError, match="microseconds must be > 0"):
        clock.advance(0)


def test_wall_clock_follows_real_time() -> None:
    clock = WallClock()
    before, start = clock.now_us(), time.monotonic()
    time.sleep(0.02)
    measured, elapsed = clock.now_us() - before, 1e6 * (time.monotonic() - start)
    assert 20_000 <= measured <= elapsed + 1_000
    assert abs(clock.realtime_us() - 1e6 * time.time()) < 1e6
