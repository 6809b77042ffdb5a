"""What a session needs of a lane: bytes out, bytes in, and a few facts about the lane.

A link knows addresses, sockets and rooms; the session above it knows verbs, sequence numbers and the two dialects. A
link is used by one session and opened once:

    link = SomeLink(...)            # checks its arguments, opens nothing
    link.open(receiver)             # connects, or raises ConnectionError
    link.send(packet)               # any thread
    link.close()                    # any thread, any number of times
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

from asimov_gym.edge.control import Dialect


class LinkReceiver(Protocol):
    """Takes what a link brings in. The session implements it; links call it, from a thread of their own."""

    def on_state(self, packet: bytes, edge_timestamp_us: int = 0) -> None:
        """One sample of the robot's state, serialized: EdgeTelemetry in dialect A, RobotState in dialect B.

        Args:
            packet: the bytes as they came. Samples may be malformed, lost, doubled or late: the session sorts that out.
            edge_timestamp_us: the robot's wall clock for this sample, where the lane carries it beside the packet (a
                data-track frame's `user_timestamp`); 0 otherwise.
        """
        ...

    def on_event(self, packet: bytes) -> None:
        """One serialized EdgeEvent of the system channel, in order."""
        ...

    def on_lost(self, reason: str) -> None:
        """The lane has ended for good and will bring nothing more; `reason` is one line for people.

        Not for a pause: a link that reconnects by itself says nothing while it tries. Not called by `close`.
        """
        ...


class Link(Protocol):
    """One client's lane to one robot."""

    @property
    def dialect(self) -> Dialect:
        """How the packets are written. Known at the latest when `open` returns."""
        ...

    @property
    def address(self) -> str:
        """The robot's address on this lane, for messages: never with a credential in it."""
        ...

    @property
    def facts(self) -> Mapping[str, Any] | None:
        """What the robot says of itself (`robot_model`, `robot_os_version`, ...), known at the latest when `open`
        returns; None where the lane cannot tell."""
        ...

    @property
    def carries_events(self) -> bool:
        """Whether the lane has a system channel."""
        ...

    @property
    def velocity_expires(self) -> bool:
        """Whether the robot forgets a velocity that is not sent again (UDP: after 2 s). The session then repeats it."""
        ...

    @property
    def silence_hint(self) -> str:
        """What to look at when the lane is open and no state comes: one sentence."""
        ...

    def open(self, receiver: LinkReceiver) -> None:
        """Connect. Samples may reach `receiver` before this returns; the session waits for the first one afterwards.

        Raises:
            ConnectionError: the robot was not reached, or refused; one line that says which, and what to look at.
                Nothing stays open then.
        """
        ...

    def send(self, packet: bytes, streamed: bool = False) -> None:
        """Send one command packet. Quick: a lane that has to wait does so in its own thread.

        Args:
            packet: the serialized command.
            streamed: True for one of a stream of setpoints (a trajectory, a velocity that is not zero), which the next
                one replaces: a lane may carry it where packets can be lost. Modes and zero velocities never are.

        Raises:
            ConnectionError: the link is closed or lost.
        """
        ...

    def close(self) -> None:
        """Leave: no packet is taken or delivered afterwards. Never raises; idempotent."""
        ...
