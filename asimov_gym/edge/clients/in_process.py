"""The lane to a simulated robot in the same process."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from asimov_gym.edge.clients.link import LinkReceiver
from asimov_gym.edge.control import Client, Dialect
from asimov_gym.edge.facts import facts
from asimov_gym.edge.listener import EdgeListener
from asimov_gym.edge.robot import SimulatedRobot


class InProcessLink(EdgeListener):
    """Bytes handed to the robot's edge and back, without a network.

    Args:
        robot: running, or advanced by the caller.
        client: who connects; the link speaks its first dialect.
    """

    carries_events = True
    velocity_expires = False
    silence_hint = "The robot in this process gives its state at once."

    def __init__(self, robot: SimulatedRobot, client: Client) -> None:
        self.client = client
        self.dialect = client.dialects[0]
        self.address = f"the robot in this process, as {client.name}"
        self.facts: Mapping[str, Any] | None = facts()
        self.wants_robot_state = self.dialect is Dialect.IO
        self._robot = robot
        self._receiver: LinkReceiver | None = None

    def open(self, receiver: LinkReceiver) -> None:
        """Attach; the robot's present state is delivered at once."""
        edge = self._robot.edge
        with edge.lock:
            self._receiver = receiver
            edge.attach(self)
            receiver.on_state(edge.latest_robot_state if self.wants_robot_state else edge.latest)

    def send(self, packet: bytes, streamed: bool = False) -> None:
        """Hand a packet to the edge."""
        self._robot.edge.receive(packet, self.client, streamed)

    def close(self) -> None:
        """Leave: control is free if this client had it, and its velocity becomes zero."""
        if self._receiver is None:
            return
        edge = self._robot.edge
        with edge.lock:
            self._receiver = None
            edge.detach(self)
            edge.leave(self.client)

    # -- EdgeListener ------------------------------------------------------------------------------

    def on_telemetry(self, timestamp_us: int, packet: bytes) -> None:
        if self._receiver is not None and self.dialect is Dialect.CLOUD:
            self._receiver.on_state(packet)

    def on_robot_state(self, timestamp_us: int, packet: bytes, report: bool) -> None:
        if self._receiver is not None and self.wants_robot_state:
            self._receiver.on_state(packet, timestamp_us)

    def on_event(self, timestamp_us: int, packet: bytes) -> None:
        if self._receiver is not None:
            self._receiver.on_event(packet)
