"""Pictures that were asked for are delivered, dropped or pending; nothing else."""

from __future__ import annotations

import pytest

from asimov_gym.rendering.frame_tally import WINDOW_S, FrameTally


def test_numbers_passed_over_are_dropped() -> None:
    tally = FrameTally()
    tally.ask(10)
    tally.deliver(0)
    tally.deliver(3)
    tally.deliver(7)
    counts = tally.counts()
    assert (counts.asked, counts.delivered, counts.dropped, counts.pending) == (10, 3, 5, 2)


def test_rate_is_that_of_the_last_two_seconds() -> None:
    now = [100.0]
    tally = FrameTally(lambda: now[0])
    assert tally.counts().achieved_fps == 0.0
    for number in range(60):
        now[0] += 0.05
        tally.ask(1)
        tally.deliver(number)
    assert tally.counts().achieved_fps == pytest.approx(20.0)
    for number in range(60, 75):
        now[0] += 0.2
        tally.deliver(number)
    assert tally.counts().achieved_fps == pytest.approx(5.0)
    now[0] += WINDOW_S
    assert tally.counts().achieved_fps == 0.0
