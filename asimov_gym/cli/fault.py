"""`asimov fault`: what a bench operator does to a running `asimov robot`, through its local console."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass, fields
from typing import Annotated, Any, ClassVar, Literal

import tyro

from asimov_gym.cli.console_client import DEFAULT_NAME, NoRobot, ask


@dataclass(frozen=True, kw_only=True)
class Request:
    """One request to a robot's console: the fields but `name` are its arguments, under their own names."""

    do: ClassVar[str]
    """What the console calls it."""

    name: str = DEFAULT_NAME
    """Which robot, as its own --name says."""

    def arguments(self) -> dict[str, Any]:
        """The request's arguments. A number in the place of a name is a number to the console too."""
        given = {field.name: getattr(self, field.name) for field in fields(self) if field.name != "name"}
        return {
            key: int(value) if isinstance(value, str) and value.isdecimal() else value for key, value in given.items()
        }

    def run(self) -> int:
        """Ask, print the reply. Exit code 2 when no robot runs or it refuses."""
        try:
            reply = ask(self.name, {"do": self.do, **self.arguments()})
        except (NoRobot, ValueError) as error:
            print(f"asimov fault: {error}", file=sys.stderr)
            return 2
        if "error" in reply:
            print(f"asimov fault: {reply['error']}", file=sys.stderr)
            return 2
        print(reply["done"] if "done" in reply else json.dumps(reply["status"], indent=2))
        return 0


@dataclass(frozen=True, kw_only=True)
class Push(Request):
    """Push the robot, at the centre of mass of a body."""

    do = "push"
    force: tuple[float, float, float]
    """N, world frame: x where the robot faced at start, y to its left, z up."""
    seconds: float = 0.1
    """How long."""
    body: str = "waist_yaw_link"
    """Body of the model that is pushed; the torso by default."""


@dataclass(frozen=True, kw_only=True)
class Heat(Request):
    """Bring a motor to a temperature: from 60 °C it is a warning, at 80 °C the robot goes to DAMP."""

    do = "heat"
    motor: tyro.conf.Positional[str]
    """Name such as L_Knee, or number in firmware order from 0."""
    celsius: tyro.conf.Positional[float]
    """°C."""


@dataclass(frozen=True, kw_only=True)
class Bus(Request):
    """Let a CAN bus fall silent: its motors go limp."""

    do = "drop_bus"
    bus: tyro.conf.Positional[str]
    """left_leg, right_leg, left_arm, right_arm, waist_neck, a number from 0, or all."""
    seconds: float | None = None
    """How long; until `asimov fault clear` when left out."""


@dataclass(frozen=True, kw_only=True)
class Motor(Request):
    """Cut one motor off its bus: it goes limp."""

    do = "drop_motor"
    motor: tyro.conf.Positional[str]
    """Name such as L_Knee, or number in firmware order from 0."""
    seconds: float | None = None
    """How long; until `asimov fault clear` when left out."""


@dataclass(frozen=True, kw_only=True)
class Overcurrent(Request):
    """Let a motor draw more current than its torque needs, as a shorted winding does."""

    do = "overcurrent"
    motor: tyro.conf.Positional[str]
    """Name such as L_Knee, or number in firmware order from 0."""
    amperes: tyro.conf.Positional[float]
    """A."""
    seconds: float | None = None
    """How long; until `asimov fault clear` when left out."""


@dataclass(frozen=True, kw_only=True)
class DelayPolicy(Request):
    """Make every inference of the walking network take longer. It has 20 ms."""

    do = "delay_policy"
    ms: tyro.conf.Positional[float]
    """ms."""
    seconds: float | None = None
    """How long; until `asimov fault clear` when left out."""


@dataclass(frozen=True, kw_only=True)
class FailPolicy(Request):
    """Make inference of the walking network fail."""

    do = "fail_policy"
    seconds: float | None = None
    """How long; until `asimov fault clear` when left out."""


@dataclass(frozen=True, kw_only=True)
class Battery(Request):
    """Set the battery's charge: below 20 % is a warning, at 0 it protects itself."""

    do = "battery"
    percent: tyro.conf.Positional[float]
    """0 to 100."""


@dataclass(frozen=True, kw_only=True)
class Imu(Request):
    """Stop the IMU."""

    do = "imu"
    seconds: float | None = None
    """How long; until `asimov fault clear` when left out."""


@dataclass(frozen=True, kw_only=True)
class Encoder(Request):
    """Break a motor's encoder."""

    do = "encoder"
    motor: tyro.conf.Positional[str]
    """Name such as L_Knee, or number in firmware order from 0."""
    seconds: float | None = None
    """How long; until `asimov fault clear` when left out."""


@dataclass(frozen=True, kw_only=True)
class Alert(Request):
    """Raise an alert of the robot's catalogue without a cause, such as FALL_DETECTED."""

    do = "alert"
    alert: tyro.conf.Positional[str]
    """Its name; a wrong one is answered with the list."""
    source: int = 0
    """Motor in firmware order, where the alert concerns one."""


@dataclass(frozen=True, kw_only=True)
class Clear(Request):
    """End every injected fault that still lasts. What it has latched stays until `asimov fault restart`."""

    do = "clear"


@dataclass(frozen=True, kw_only=True)
class Restart(Request):
    """Restart the firmware: the only thing that clears a latched fault."""

    do = "restart"


@dataclass(frozen=True, kw_only=True)
class EStop(Request):
    """Press or release the emergency stop: while it is pressed the robot stays in DAMP."""

    do = "e_stop"
    to: tyro.conf.Positional[Literal["press", "release"]]
    """What to do with the button."""


@dataclass(frozen=True, kw_only=True)
class Gantry(Request):
    """Work the gantry by hand; `auto` leaves it to the robot's modes again."""

    do = "gantry"
    to: tyro.conf.Positional[Literal["hoist", "lower", "slack", "off", "auto"]]
    """hoist: hangs the robot; lower: feet on the ground, rope near; slack: rope out of the way; off: no rope."""


@dataclass(frozen=True, kw_only=True)
class Status(Request):
    """Print what the robot is doing, as JSON."""

    do = "status"


FaultRequest = (
    Annotated[Push, tyro.conf.subcommand("push")]
    | Annotated[Heat, tyro.conf.subcommand("heat")]
    | Annotated[Bus, tyro.conf.subcommand("bus")]
    | Annotated[Motor, tyro.conf.subcommand("motor")]
    | Annotated[Overcurrent, tyro.conf.subcommand("overcurrent")]
    | Annotated[DelayPolicy, tyro.conf.subcommand("delay-policy")]
    | Annotated[FailPolicy, tyro.conf.subcommand("fail-policy")]
    | Annotated[Battery, tyro.conf.subcommand("battery")]
    | Annotated[Imu, tyro.conf.subcommand("imu")]
    | Annotated[Encoder, tyro.conf.subcommand("encoder")]
    | Annotated[Alert, tyro.conf.subcommand("alert")]
    | Annotated[Clear, tyro.conf.subcommand("clear")]
    | Annotated[Restart, tyro.conf.subcommand("restart")]
    | Annotated[EStop, tyro.conf.subcommand("e-stop")]
    | Annotated[Gantry, tyro.conf.subcommand("gantry")]
    | Annotated[Status, tyro.conf.subcommand("status")]
)


@dataclass(frozen=True)
class Fault:
    """Cause a fault in a running `asimov robot`, clear it, restart it, work its gantry and emergency stop.

    Exit code 0 when the robot did it, 2 when no robot runs here or it refused.
    """

    request: tyro.conf.OmitArgPrefixes[FaultRequest]

    def run(self) -> int:
        return self.request.run()
