"""The loop watched by itself, on a wall clock that the test moves."""

from __future__ import annotations

import pytest

from asimov_gym.firmware import AlertId, Firmware, FirmwareConfig, Stand, State, StepClock
from asimov_gym.firmware.alerts import AlertBoard
from asimov_gym.firmware.watchdog import Watchdog
from asimov_gym.physics import CPhysics


class HandClock:
    """A wall clock as far as the firmware can tell."""

    def __init__(self) -> None:
        self.us = 0

    def now_us(self) -> int:
        return self.us

    def realtime_us(self) -> int:
        return self.us


@pytest.fixture
def clock() -> HandClock:
    return HandClock()


@pytest.fixture
def firmware(clock: HandClock) -> Firmware:
    firmware = Firmware(CPhysics(1), clock, None, FirmwareConfig())
    for _ in range(3):
        clock.us += 5_000
        firmware.tick()
    firmware.command(Stand())
    return firmware


def test_a_standstill_of_half_a_second_latches(firmware, clock) -> None:
    clock.us += 620_000
    snapshot = firmware.tick()
    assert (snapshot.state, snapshot.error_flags) == (State.DAMP, 1 | 1 << 5)
    assert [(a.id, a.value, a.threshold) for a in snapshot.alerts] == [(AlertId.WATCHDOG_TIMEOUT, 620, 500)]


def test_being_late_is_no_fault(firmware, clock) -> None:
    for _ in range(10):
        clock.us += 450_000
        snapshot = firmware.tick()
    assert (snapshot.state, snapshot.error_flags) == (State.STAND, 0)


def test_a_pause_that_was_meant_is_no_standstill(firmware, clock) -> None:
    clock.us += 60_000_000
    firmware.resume()
    assert firmware.tick().error_flags == 0
    clock.us += 60_000_000
    firmware.restart()
    clock.us += 60_000_000
    assert firmware.tick().error_flags == 0


def test_a_lockstep_robot_may_pause_for_as_long_as_it_likes() -> None:
    clock = StepClock()
    firmware = Firmware(CPhysics(1), clock)
    firmware.tick()
    clock.advance(60_000_000)
    assert firmware.tick().error_flags == 0


def test_cycle_time_is_that_of_the_last_second() -> None:
    watchdog, board = Watchdog(period_us=5_000, limit_s=0.5, realtime=True), AlertBoard()
    now = 0
    for step in range(200):
        now += 9_000 if step == 50 else 5_000
        watchdog.check(board, now)
        watchdog.add(0.004 if step == 7 else 0.001)
    assert watchdog.cycle.max_us == 4_000
    assert watchdog.cycle.avg_us == round((199 * 1_000 + 4_000) / 200)
    assert watchdog.cycle.jitter_us == 4_000
    for _ in range(200):
        now += 5_000
        watchdog.check(board, now)
        watchdog.add(0.001)
    assert (watchdog.cycle.max_us, watchdog.cycle.avg_us, watchdog.cycle.jitter_us) == (1_000, 1_000, 0)


def test_the_firmware_measures_itself(bench) -> None:
    cycle = bench.run(1.005).cycle  # the second ends with the 200th step
    assert 0 < cycle.avg_us <= cycle.max_us
    assert cycle.jitter_us == 0
