"""Who commands the robot: one source at a time, by priority; DAMP is everybody's."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, IntEnum

from asimov_gym.firmware import MICROSECONDS

SILENCE_US = 2 * MICROSECONDS
"""Control passes on when its holder was silent this long."""


class Source(IntEnum):
    """Where a command comes from; a lower number takes control from a higher one."""

    E_STOP = 0
    CONSOLE = 1
    IN_PROCESS = 2
    UDP = 3
    LIVEKIT = 4
    JOINT_CONTROL = 5
    MOTION_MODES = 6


class Dialect(Enum):
    """The two sets of messages; `asimov_gym.edge.dialect` has their differences."""

    CLOUD = "cloud"
    """CloudCommand, EdgeTelemetry, EdgeEvent: the published interface."""
    IO = "io"
    """RobotCommand, RobotState: what the robot's public Python client speaks."""


@dataclass(frozen=True)
class Client:
    """A sender of commands.

    Raises:
        ValueError: the name is no text that messages can carry.
    """

    source: Source
    name: str
    """Unique among the connected clients; appears in events and recordings."""
    dialects: tuple[Dialect, ...] = (Dialect.CLOUD,)
    """What it may speak. With both, each packet is told apart by its protocol version."""

    def __post_init__(self) -> None:
        try:
            self.name.encode()
        except UnicodeEncodeError:  # else every event that names it would fail, in the control loop
            raise ValueError(f"name must be text without lone surrogates, got {self.name!r}") from None


@dataclass(frozen=True)
class Handover:
    """Control changed hands."""

    previous: Client | None
    current: Client | None
    reason: str
    """`first_command`, `priority`, `silence`, `left`, `e_stop` or `e_stop_released`."""


E_STOP_BUTTON = Client(Source.E_STOP, "e-stop")
"""Holder of control while the emergency stop is pressed."""


class Control:
    """The present holder of control."""

    def __init__(self) -> None:
        self.holder: Client | None = None
        self._heard_us = 0

    def claim(self, client: Client, now_us: int) -> tuple[bool, Handover | None]:
        """A command other than DAMP came in.

        Returns:
            Whether the client is in control, and the handover that gave it control, if any.
        """
        previous = self.holder
        if previous == E_STOP_BUTTON:
            return False, None
        if client == previous:
            self._heard_us = now_us
            return True, None
        if previous is None:
            reason = "first_command"
        elif client.source < previous.source:
            reason = "priority"
        elif now_us - self._heard_us >= SILENCE_US:
            reason = "silence"
        else:
            return False, None
        self.holder, self._heard_us = client, now_us
        return True, Handover(previous, client, reason)

    def leave(self, client: Client) -> Handover | None:
        """A client has gone; control is free if it had it."""
        if client != self.holder:
            return None
        self.holder = None
        return Handover(client, None, "left")

    def e_stop(self, pressed: bool) -> Handover | None:
        """The emergency stop takes control while it is pressed; released, control is free."""
        previous, current = self.holder, E_STOP_BUTTON if pressed else None
        if (previous == E_STOP_BUTTON) == pressed:
            return None
        self.holder = current
        return Handover(previous, current, "e_stop" if pressed else "e_stop_released")
