"""What a robot's console understands: each action a frozen dataclass of its arguments that knows how to act.

A request is a JSON object: `do` names the action, the other keys are its arguments under their field names.
`read_action` checks it against the dataclass, so that a typing error on the bench is answered with the field, the value
and what is allowed, and changes nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, fields
from functools import cache
from types import MappingProxyType, NoneType
from typing import Any, ClassVar, Literal, Protocol, get_args, get_origin, get_type_hints

from asimov_gym.edge.robot import SimulatedRobot
from asimov_gym.firmware import AlertId

LARGEST_FORCE = 5000.0
"""Largest push, N: about ten times the robot's weight."""


class Action(Protocol):
    """Something that a bench operator can do to the robot."""

    reports_itself: ClassVar[bool]
    """Whether the robot says in an event of its own what was done, so that the console need not."""

    def act(self, robot: SimulatedRobot) -> str:
        """Do it, with the edge's lock held, and say in a few words what was done.

        Raises:
            ValueError: an argument is out of range or names nothing; the message says what is allowed.
        """
        ...


@dataclass(frozen=True)
class _Action:
    """Defaults of all actions."""

    reports_itself: ClassVar[bool] = False


@dataclass(frozen=True)
class Restart(_Action):
    """Restart the firmware: what clears a latched fault."""

    reports_itself: ClassVar[bool] = True

    def act(self, robot: SimulatedRobot) -> str:
        robot.restart()
        return f"the firmware restarted, boot {robot.firmware.boots}"


@dataclass(frozen=True)
class EStop(_Action):
    """Press or release the emergency stop."""

    to: Literal["press", "release"]
    reports_itself: ClassVar[bool] = True

    def act(self, robot: SimulatedRobot) -> str:
        robot.edge.e_stop(self.to == "press")
        return f"emergency stop {self.to}ed" if self.to == "press" else "emergency stop released; the robot is in DAMP"


@dataclass(frozen=True)
class Gantry(_Action):
    """Work the gantry's winch by hand, or leave it to the firmware's modes (`auto`)."""

    to: Literal["hoist", "lower", "slack", "off", "auto"]

    def act(self, robot: SimulatedRobot) -> str:
        robot.firmware.gantry.by_hand(self.to)
        return f"gantry: {self.to}"


@dataclass(frozen=True)
class Push(_Action):
    """Push the robot at the centre of mass of a body."""

    force: tuple[float, float, float]
    """N, world frame."""
    seconds: float = 0.1
    body: str = "waist_yaw_link"

    def act(self, robot: SimulatedRobot) -> str:
        size = math.hypot(*self.force)
        if size > LARGEST_FORCE:
            raise ValueError(f"force must be at most {LARGEST_FORCE:g} N, got {size:g} N")
        robot.firmware.faults.push(self.force, self.seconds, self.body)
        return f"push of {size:.0f} N on {self.body} for {self.seconds:g} s"


@dataclass(frozen=True)
class Heat(_Action):
    """Bring a motor's winding to a temperature, from which it cools as it would."""

    motor: int | str
    """Name, or number in firmware order from 0."""
    celsius: float

    def act(self, robot: SimulatedRobot) -> str:
        robot.firmware.faults.heat(self.motor, self.celsius)
        return f"motor {self.motor} at {self.celsius:g} °C"


@dataclass(frozen=True)
class DropBus(_Action):
    """Let a CAN bus fall silent: its motors go limp and their readings stand still."""

    bus: int | str
    """Name, number from 0, or `all`."""
    seconds: float | None = None
    """Until `clear` when null."""

    def act(self, robot: SimulatedRobot) -> str:
        robot.firmware.faults.drop_bus(self.bus, self.seconds)
        return f"bus {self.bus} silent{_for(self.seconds)}"


@dataclass(frozen=True)
class DropMotor(_Action):
    """Cut one motor off its bus: it goes limp and its readings stand still."""

    motor: int | str
    """Name, or number in firmware order from 0."""
    seconds: float | None = None
    """Until `clear` when null."""

    def act(self, robot: SimulatedRobot) -> str:
        robot.firmware.faults.drop_motor(self.motor, self.seconds)
        return f"motor {self.motor} silent{_for(self.seconds)}"


@dataclass(frozen=True)
class Overcurrent(_Action):
    """Let a motor draw more current than its torque needs, as a shorted winding does."""

    motor: int | str
    """Name, or number in firmware order from 0."""
    amperes: float
    seconds: float | None = None
    """Until `clear` when null."""

    def act(self, robot: SimulatedRobot) -> str:
        robot.firmware.faults.overcurrent(self.motor, self.amperes, self.seconds)
        return f"motor {self.motor} draws {self.amperes:g} A more{_for(self.seconds)}"


@dataclass(frozen=True)
class DelayPolicy(_Action):
    """Make every inference of the network take longer."""

    ms: float
    seconds: float | None = None
    """Until `clear` when null."""

    def act(self, robot: SimulatedRobot) -> str:
        robot.firmware.faults.delay_policy(self.ms, self.seconds)
        return f"inference takes {self.ms:g} ms longer{_for(self.seconds)}"


@dataclass(frozen=True)
class FailPolicy(_Action):
    """Make inference raise an error."""

    seconds: float | None = None
    """Until `clear` when null."""

    def act(self, robot: SimulatedRobot) -> str:
        robot.firmware.faults.fail_policy(self.seconds)
        return f"inference fails{_for(self.seconds)}"


@dataclass(frozen=True)
class Battery(_Action):
    """Set the battery's state of charge."""

    percent: float

    def act(self, robot: SimulatedRobot) -> str:
        robot.firmware.faults.battery(self.percent)
        return f"battery at {self.percent:g} %"


@dataclass(frozen=True)
class Imu(_Action):
    """Stop the IMU: its last sample stands still."""

    seconds: float | None = None
    """Until `clear` when null."""

    def act(self, robot: SimulatedRobot) -> str:
        robot.firmware.faults.imu(self.seconds)
        return f"imu silent{_for(self.seconds)}"


@dataclass(frozen=True)
class Encoder(_Action):
    """Break a motor's encoder: its driver reports the error, its position and speed stand still."""

    motor: int | str
    """Name, or number in firmware order from 0."""
    seconds: float | None = None
    """Until `clear` when null."""

    def act(self, robot: SimulatedRobot) -> str:
        robot.firmware.faults.encoder(self.motor, self.seconds)
        return f"encoder error on motor {self.motor}{_for(self.seconds)}"


@dataclass(frozen=True)
class RaiseAlert(_Action):
    """Raise an alert of the catalogue without a cause; a critical one latches DAMP."""

    alert: str
    source: int = 0
    """Motor in firmware order where the alert concerns one."""

    def act(self, robot: SimulatedRobot) -> str:
        robot.firmware.faults.raise_alert(self.alert.upper(), self.source)
        alert = AlertId[self.alert.upper()]
        return f"alert {alert.name} ({alert.severity.name.lower()}), source {self.source}"


@dataclass(frozen=True)
class Clear(_Action):
    """End every injected fault that still lasts. A latched fault stays until `restart`."""

    def act(self, robot: SimulatedRobot) -> str:
        ongoing = robot.firmware.faults.ongoing
        robot.firmware.faults.clear()
        latched = "; a fault is latched, restart clears it" if robot.firmware.alerts.latched else ""
        return f"injected faults ended: {', '.join(ongoing) or 'there were none'}{latched}"


ACTIONS: Mapping[str, type[_Action]] = MappingProxyType(
    {
        "restart": Restart,
        "e_stop": EStop,
        "gantry": Gantry,
        "push": Push,
        "heat": Heat,
        "drop_bus": DropBus,
        "drop_motor": DropMotor,
        "overcurrent": Overcurrent,
        "delay_policy": DelayPolicy,
        "fail_policy": FailPolicy,
        "battery": Battery,
        "imu": Imu,
        "encoder": Encoder,
        "alert": RaiseAlert,
        "clear": Clear,
    }
)
"""Actions by the name that a request gives."""


def read_action(name: str, arguments: Mapping[str, Any]) -> Action:
    """An action from its name and the other keys of a request.

    Raises:
        ValueError: no such action, an argument that it does not have or lacks, or a value of the wrong type.
    """
    if name not in ACTIONS:
        raise ValueError(f"do must be status or one of {', '.join(ACTIONS)}; got {name!r}")
    kind = ACTIONS[name]
    known = {field.name: field for field in fields(kind)}
    for key in arguments:
        if key not in known:
            allowed = f"its arguments are {', '.join(known)}" if known else "it has no arguments"
            raise ValueError(f"{name} has no argument {key!r}; {allowed}")
    values = {}
    for key, field in known.items():
        if key in arguments:
            values[key] = _read_value(f"{name} {key}", _types(kind)[key], arguments[key])
        elif field.default is MISSING:
            raise ValueError(f"{name} needs the argument {key!r}")
    return kind(**values)  # type: ignore[return-value]


@cache
def _types(kind: type) -> dict[str, Any]:
    return get_type_hints(kind)


def _read_value(name: str, wanted: Any, value: Any) -> Any:
    """A JSON value as a field's type.

    Raises:
        ValueError: it is of another type, or not finite.
    """
    origin, options = get_origin(wanted), get_args(wanted)
    if origin is Literal:
        if value not in options:
            raise ValueError(f"{name} must be one of {', '.join(options)}; got {value!r}")
        return value
    if origin is tuple:
        if not isinstance(value, list) or len(value) != len(options):
            raise ValueError(f"{name} must be a list of {len(options)} numbers, got {value!r}")
        return tuple(_read_value(name, option, item) for option, item in zip(options, value, strict=True))
    for option in options or (wanted,):
        reader = _READERS[option]
        if (read := reader(value)) is not MISSING:
            return read
    words = " or ".join(_WORDS[option] for option in options or (wanted,))
    raise ValueError(f"{name} must be {words}, got {value!r}")


def _read_float(value: Any) -> Any:
    numeric = isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e15  # NaN is not
    return float(value) if numeric else MISSING


def _read_int(value: Any) -> Any:
    return value if isinstance(value, int) and not isinstance(value, bool) else MISSING


_READERS: Mapping[type, Callable[[Any], Any]] = {
    float: _read_float,
    int: _read_int,
    str: lambda value: value if isinstance(value, str) else MISSING,
    NoneType: lambda value: None if value is None else MISSING,
}
_WORDS = {float: "a finite number", int: "a whole number", str: "a text", NoneType: "null"}


def _for(seconds: float | None) -> str:
    return ", until it is cleared" if seconds is None else f" for {seconds:g} s"
