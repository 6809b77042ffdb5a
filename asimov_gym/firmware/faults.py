"""Fault injection: the one place where tests, the console and the command line break the simulated robot.

A fault is a cause in the hardware (a push, a dead bus, a slow network), never its symptom: the alerts that follow are
the firmware's own finding. Only `raise_alert` fakes a symptom, for alerts that this hardware has no cause for.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from asimov_gym.firmware.can_bus import BUS_NAMES, BUSES
from asimov_gym.firmware.clock import MICROSECONDS
from asimov_gym.firmware.condition import HEALTHY, Condition
from asimov_gym.robot.alerts import AlertId
from asimov_gym.robot.joints import MOTOR_NAMES

if TYPE_CHECKING:
    from asimov_gym.firmware.firmware import Firmware

_FOREVER = math.inf
_LARGEST = 2**32 - 1
"""Of the numbers of an alert: they are unsigned, 32 bits, in the messages."""


@dataclass(frozen=True)
class _Cause:
    """One ongoing fault. Which fields count depends on the kind."""

    since_us: int
    until_us: float
    motors: tuple[int, ...] = ()
    amount: float = 0.0
    wrench: Mapping[str, np.ndarray] = field(default_factory=dict)


class FaultInjector:
    """Breaks one robot. Call it as you would command the robot: not while a tick runs.

    Injecting the same kind of fault anew replaces the one before (for buses and motors: of the same bus or motor).
    Durations run on the robot's clock; None lasts until `clear`. A restart of the firmware ends nothing.

    Args:
        firmware: of the robot.
    """

    def __init__(self, firmware: Firmware) -> None:
        self._firmware = firmware
        self._causes: dict[tuple[str, int], _Cause] = {}
        self.condition = HEALTHY
        """What is wrong with the hardware now."""

    @property
    def ongoing(self) -> tuple[str, ...]:
        """What is wrong, in words, such as `bus left_leg` or `push`."""
        return tuple(_describe(kind, target) for kind, target in self._causes)

    # -- causes ----------------------------------------------------------------------------------------

    def push(self, force_n: Sequence[float] | np.ndarray, duration_s: float, body: str = "waist_yaw_link") -> None:
        """Push a body at its centre of mass.

        Args:
            force_n: world frame, N, (3,).
            duration_s: s, above 0.
            body: name of a body of the model.

        Raises:
            ValueError: an unknown body, a force that is not three finite numbers, or a bad duration.
        """
        model = self._firmware.physics.model
        bodies = [model.body(index).name for index in range(1, model.nbody)]
        if body not in bodies:
            raise ValueError(f"unknown body {body!r}; the bodies are {', '.join(bodies)}")
        force = np.asarray(force_n, dtype=np.float64)
        if force.shape != (3,) or not np.isfinite(force).all():
            raise ValueError(f"force_n must be three finite numbers, N, got {force_n!r}")
        wrench = {body: np.concatenate([force, np.zeros(3)])[None]}
        self._start("push", bodies.index(body), duration_s, wrench=wrench)

    def heat(self, motor: int | str, celsius: float) -> None:
        """Set a motor's temperature; it cools from there by itself.

        Raises:
            ValueError: an unknown motor, or a temperature outside -50 to 300 degrees.
        """
        index = motor_index(motor)
        _check_number("celsius", celsius, -50.0, 300.0)
        self._firmware.motors.temperature[index] = celsius

    def overcurrent(self, motor: int | str, amperes: float, seconds: float | None = None) -> None:
        """Let a motor draw this much more than its torque needs, as a shorted winding does. It heats the motor too.

        Raises:
            ValueError: an unknown motor, a current outside 0 to 500 A, or a bad duration.
        """
        index = motor_index(motor)
        _check_number("amperes", amperes, 0.0, 500.0)
        self._start("overcurrent", index, seconds, motors=(index,), amount=amperes)

    def drop_bus(self, bus: int | str, seconds: float | None = None) -> None:
        """Cut a CAN bus: its motors go limp and their last readings stand.

        Args:
            bus: name or number from `can_bus.BUSES`, or `all`.
            seconds: until it comes back; None for good.

        Raises:
            ValueError: an unknown bus, or a bad duration.
        """
        chosen = range(len(BUSES)) if bus == "all" else (bus_index(bus),)
        for index in chosen:
            self._start("bus", index, seconds, motors=BUSES[BUS_NAMES[index]])

    def drop_motor(self, motor: int | str, seconds: float | None = None) -> None:
        """Cut one motor off its bus: it goes limp and its last readings stand.

        Raises:
            ValueError: an unknown motor, or a bad duration.
        """
        index = motor_index(motor)
        self._start("motor", index, seconds, motors=(index,))

    def encoder(self, motor: int | str, seconds: float | None = None) -> None:
        """Break a motor's encoder: its driver reports the error, position and speed stand still.

        Raises:
            ValueError: an unknown motor, or a bad duration.
        """
        index = motor_index(motor)
        self._start("encoder", index, seconds, motors=(index,))

    def imu(self, seconds: float | None = None) -> None:
        """Stop the IMU: it repeats its last sample.

        Raises:
            ValueError: a bad duration.
        """
        self._start("imu", 0, seconds)

    def delay_policy(self, ms: float, seconds: float | None = None) -> None:
        """Make every inference take this much longer.

        Raises:
            ValueError: a delay outside 0 to 60,000 ms, or a bad duration.
        """
        _check_number("ms", ms, 0.0, 60_000.0)
        self._start("policy delay", 0, seconds, amount=ms)

    def fail_policy(self, seconds: float | None = None) -> None:
        """Make inference raise an error.

        Raises:
            ValueError: a bad duration.
        """
        self._start("policy failure", 0, seconds)

    def battery(self, soc_percent: float) -> None:
        """Set the battery's charge; it drains from there by itself.

        Raises:
            ValueError: outside 0 to 100.
        """
        self._firmware.battery.charge_to(soc_percent)

    def raise_alert(self, alert: AlertId | str, source: int = 0, value: int = 0, threshold: int = 0) -> None:
        """Raise an alert without a cause: it goes away after 2.5 s. A critical one latches DAMP.

        Raises:
            ValueError: the name is not in the catalogue, or a number is not from 0 to 2^32-1, as the messages have it.
        """
        if isinstance(alert, str):
            if alert not in AlertId.__members__:
                raise ValueError(f"unknown alert {alert!r}; the alerts are {', '.join(AlertId.__members__)}")
            alert = AlertId[alert]
        for name, number in (("source", source), ("value", value), ("threshold", threshold)):
            if not 0 <= number <= _LARGEST:
                raise ValueError(f"alert {name} must be from 0 to {_LARGEST}, got {number}")
        self._firmware.inject(alert, source, value, threshold)

    def clear(self) -> None:
        """End every ongoing cause. What follows from it stays: heat, charge, a latched fault."""
        self._causes.clear()
        self.condition = HEALTHY

    # -- the loop --------------------------------------------------------------------------------------

    def update(self, clock_us: int) -> None:
        """End the causes whose time is up. Called by the firmware each control step with the robot's clock, which is
        that of the step's end: a cause lasts through the step that ends with it."""
        if not self._causes:
            return
        over = [key for key, cause in self._causes.items() if clock_us > cause.until_us]
        for key in over:
            del self._causes[key]
        if over:
            self._compose()

    def _start(
        self,
        kind: str,
        target: int,
        seconds: float | None,
        motors: tuple[int, ...] = (),
        amount: float = 0.0,
        wrench: Mapping[str, np.ndarray] = MappingProxyType({}),
    ) -> None:
        if seconds is not None and not (math.isfinite(seconds) and seconds > 0.0):
            raise ValueError(f"duration must be above 0 s, or None to last until it is cleared, got {seconds!r}")
        now = self._firmware.clock.now_us()
        until = _FOREVER if seconds is None else now + round(seconds * MICROSECONDS)
        self._causes[kind, target] = _Cause(now, until, motors, amount, wrench)
        self._compose()

    def _compose(self) -> None:
        """Put the condition together from the causes."""
        silent_since: dict[int, int] = {}
        for cause in (*self._of("bus"), *self._of("motor")):
            for motor in cause.motors:
                silent_since[motor] = min(cause.since_us, silent_since.get(motor, cause.since_us))
        leak = np.zeros(len(MOTOR_NAMES))
        for cause in self._of("overcurrent"):
            leak[list(cause.motors)] = cause.amount
        encoders = [motor for cause in self._of("encoder") for motor in cause.motors]
        imu, delay = self._of("imu"), self._of("policy delay")
        self.condition = Condition(
            silent_since_us=MappingProxyType(silent_since),
            silent=_mask(silent_since),
            encoder_fault=_mask(encoders),
            leak=leak if leak.any() else None,
            imu_since_us=imu[0].since_us if imu else None,
            policy_delay_ms=delay[0].amount if delay else 0.0,
            policy_fails=bool(self._of("policy failure")),
            wrench=MappingProxyType({body: w for cause in self._of("push") for body, w in cause.wrench.items()}),
        )

    def _of(self, kind: str) -> list[_Cause]:
        return [cause for (known, _), cause in self._causes.items() if known == kind]


def motor_index(motor: int | str) -> int:
    """Place of a motor in firmware order, from its name (`L_Knee`) or number.

    Raises:
        ValueError: there is no such motor; the message lists them.
    """
    return _index("motor", motor, MOTOR_NAMES)


def bus_index(bus: int | str) -> int:
    """Place of a bus in `can_bus.BUSES`, from its name (`left_leg`) or number.

    Raises:
        ValueError: there is no such bus; the message lists them.
    """
    return _index("bus", bus, BUS_NAMES)


def _index(kind: str, wanted: int | str, names: Sequence[str]) -> int:
    if isinstance(wanted, str) and wanted in names:
        return names.index(wanted)
    if isinstance(wanted, int | np.integer) and not isinstance(wanted, bool) and 0 <= wanted < len(names):
        return int(wanted)
    known = ", ".join(f"{index} {name}" for index, name in enumerate(names))
    raise ValueError(f"unknown {kind} {wanted!r}; allowed are number or name of {known}")


def _mask(motors: Sequence[int] | Mapping[int, int]) -> np.ndarray | None:
    if not motors:
        return None
    mask = np.zeros(len(MOTOR_NAMES), dtype=bool)
    mask[list(motors)] = True
    return mask


def _check_number(name: str, value: float, low: float, high: float) -> None:
    if not (math.isfinite(value) and low <= value <= high):
        raise ValueError(f"{name} must be between {low:g} and {high:g}, got {value!r}")


def _describe(kind: str, target: int) -> str:
    if kind == "bus":
        return f"bus {BUS_NAMES[target]}"
    if kind in ("motor", "encoder", "overcurrent"):
        return f"{kind} {MOTOR_NAMES[target]}"
    return kind
