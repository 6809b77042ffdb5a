"""Who hears what passes the edge."""

from __future__ import annotations

from asimov_gym.edge.control import Client
from asimov_gym.edge.verdict import Verdict


class EdgeListener:
    """Gets a copy of everything that passes. Override what you need.

    The methods are called with the edge's lock held, on the thread of the control loop or of a transport: be quick, do
    not wait for anything.
    """

    wants_robot_state: bool = False
    """Whether this listener needs RobotState frames. The edge makes them only while an attached listener does."""

    def on_command(self, received_us: int, client: Client, packet: bytes, verdict: Verdict) -> None:
        """A packet came in and got a verdict. `received_us` is the edge's wall clock."""

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
