from __future__ import annotations

import numpy as np
import pytest

from asimov_gym.firmware import Battery, BatteryConfig
from asimov_gym.robot.motor import RATED_TORQUE

REST = np.zeros(25)
PLAIN = BatteryConfig(capacity_ah=1.0, full_v=48.0, empty_v=48.0, resistance_ohm=0.0, idle_w=48.0)


def run(battery: Battery, seconds: float, torque: np.ndarray, speed: np.ndarray) -> None:
    for _ in range(round(seconds / 0.005)):
        if battery.due(0.005):
            battery.sample(torque, speed)


def test_one_ampere_empties_one_ampere_hour_in_an_hour() -> None:
    battery = Battery(PLAIN)
    run(battery, 360.0, REST, REST)
    assert battery.state.soc_percent == pytest.approx(90.0, abs=0.01)
    assert battery.state.current_a == pytest.approx(-1.0)
    assert battery.state.protection_flags == 0


def test_motors_draw_what_they_drive_and_what_they_burn() -> None:
    battery = Battery(PLAIN)
    torque, speed = REST.copy(), REST.copy()
    torque[:3], speed[:3] = [10.0, 10.0, -10.0], [4.0, -4.0, -2.0]  # the second brakes and gives nothing back
    run(battery, 0.1, torque, speed)
    burnt = 50.0 * ((10.0 / RATED_TORQUE[:3]) ** 2).sum()
    assert -48.0 * battery.state.current_a == pytest.approx(48.0 + 40.0 + 20.0 + burnt)


def test_voltage_falls_with_charge_and_sags_under_load() -> None:
    battery = Battery(BatteryConfig(idle_w=0.0))
    assert battery.state.voltage_v == pytest.approx(54.6)
    battery.charge_to(50.0)
    assert battery.state.voltage_v == pytest.approx(46.8)
    run(battery, 0.05, RATED_TORQUE, REST)
    power, state = 25 * 50.0, battery.state
    assert -state.voltage_v * state.current_a == pytest.approx(power)
    assert state.voltage_v == pytest.approx(46.8 + 0.08 * state.current_a, abs=0.001)


def test_an_empty_pack_stays_empty() -> None:
    battery = Battery(PLAIN)
    battery.charge_to(0.001)
    run(battery, 5.0, REST, REST)
    assert (battery.state.soc_percent, battery.state.protection_flags) == (0.0, 1)


@pytest.mark.parametrize(
    ("field", "value"),
    [("capacity_ah", 0.0), ("start_soc_percent", 101.0), ("empty_v", 60.0), ("idle_w", float("nan"))],
)
def test_config_names_the_bad_field(field: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"battery {field}"):
        BatteryConfig(**{field: value})
