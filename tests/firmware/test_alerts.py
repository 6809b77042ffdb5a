from __future__ import annotations

import pytest

from asimov_gym.firmware import CLEAR_DELAY_US, AlertBoard, AlertId, Severity, error_bit


def test_fall_sets_the_documented_error_word() -> None:
    board = AlertBoard()
    assert board.set(AlertId.FALL_DETECTED, now_us=0)
    assert board.error_flags == 0x101
    assert board.latched


def test_over_temperature_sets_the_documented_error_word() -> None:
    board = AlertBoard()
    board.set(AlertId.MOTOR_OVERTEMP, now_us=0, source=3)
    assert board.error_flags == 0x9


def test_warning_does_not_latch() -> None:
    board = AlertBoard()
    assert not board.set(AlertId.MOTOR_TEMP_HIGH, now_us=0)
    assert (board.error_flags, board.latched) == (0, False)
    assert AlertId.MOTOR_TEMP_HIGH.severity is Severity.WARNING
    with pytest.raises(ValueError, match="MOTOR_TEMP_HIGH is WARNING"):
        error_bit(AlertId.MOTOR_TEMP_HIGH)


def test_only_the_first_critical_alert_latches() -> None:
    board = AlertBoard()
    assert board.set(AlertId.FALL_DETECTED, now_us=0)
    assert not board.set(AlertId.POLICY_SPAZ, now_us=1)
    assert board.error_flags == 0x101 | 0x200


def test_alert_goes_two_and_a_half_seconds_after_its_cause_and_the_flags_stay() -> None:
    board = AlertBoard()
    board.set(AlertId.FALL_DETECTED, now_us=1_000, value=610, threshold=600)
    board.set(AlertId.FALL_DETECTED, now_us=9_000, value=650, threshold=600)
    alert = board.active[0]
    assert (alert.first_set_us, alert.value) == (1_000, 650)
    board.expire(9_000 + CLEAR_DELAY_US - 1)
    assert board.active
    board.expire(9_000 + CLEAR_DELAY_US)
    assert not board.active
    assert board.error_flags == 0x101
    assert CLEAR_DELAY_US == 2_500_000


def test_alerts_are_told_apart_by_source() -> None:
    board = AlertBoard()
    board.set(AlertId.MOTOR_TEMP_HIGH, 0, source=5)
    board.set(AlertId.MOTOR_TEMP_HIGH, 0, source=2)
    assert [alert.source for alert in board.active] == [2, 5]
