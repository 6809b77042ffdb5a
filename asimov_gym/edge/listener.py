"""Who hears what passes the edge."""

from __future__ import annotations

import logging
from collections.abc import Callable

from asimov_gym.edge.control import Client
from asimov_gym.edge.verdict import Verdict
from asimov_gym.firmware import FirmwareState, JointSample

_log = logging.getLogger(__name__)


class EdgeListener:
    """Gets a copy of everything that passes. Override what you need.

    The methods are called with the edge's lock held, on the thread of the control loop or of a transport: be quick, do
    not wait for anything.
    """

    wants_robot_state: bool = False
    """Whether this listener needs RobotState frames. The edge makes them only while an attached listener does."""

    wants_samples: bool = False
    """Whether this listener needs samples of joint control now. While an attached one does, the physics runs at
    1 kHz."""

    def on_command(self, received_us: int, client: Client, packet: bytes, verdict: Verdict) -> None:
        """A packet came in and got a verdict. `received_us` is the edge's wall clock."""

    def on_tick(self, state: FirmwareState) -> None:
        """A control step is done, 200 times a second; called before what is reported of it."""

    def on_sample(self, sample: JointSample) -> None:
        """A physics step is done, 1000 times a second; only while some listener wants samples."""

    def on_telemetry(self, timestamp_us: int, packet: bytes) -> None:
        """A serialized EdgeTelemetry goes out, 10 times a second."""

    def on_robot_state(self, timestamp_us: int, packet: bytes, report: bool) -> None:
        """A serialized RobotState goes out, 200 times a second.

        Args:
            timestamp_us: edge wall clock.
            packet: the message.
            report: true for one in twenty, which carries the alerts: the frame for a lane of 10 Hz.
        """

    def on_event(self, timestamp_us: int, packet: bytes) -> None:
        """A serialized EdgeEvent goes out."""


class Listeners:
    """Those who hear. A listener that raises an error is logged, once, and goes on hearing; the robot goes on, too."""

    def __init__(self) -> None:
        self.all: tuple[EdgeListener, ...] = ()
        """In the order in which they hear."""
        self._failed: set[int] = set()

    @property
    def want_robot_state(self) -> bool:
        """Whether any of them needs RobotState frames."""
        return any(listener.wants_robot_state for listener in self.all)

    def add(self, listener: EdgeListener) -> None:
        """Let a listener hear from now on."""
        self.all = (*self.all, listener)

    def remove(self, listener: EdgeListener) -> None:
        """Stop that; no effect if it did not hear."""
        self.all = tuple(known for known in self.all if known is not listener)
        self._failed.discard(id(listener))

    def tell(self, call: Callable[[EdgeListener], None]) -> None:
        """Call each of them."""
        for listener in self.all:
            try:
                call(listener)
            except Exception:
                if id(listener) not in self._failed:
                    self._failed.add(id(listener))
                    _log.exception(
                        "%s failed as a listener; its further failures are not told", type(listener).__name__
                    )
