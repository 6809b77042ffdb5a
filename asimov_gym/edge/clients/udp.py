"""The lane over UDP, as the robot serves it: one RobotCommand per datagram out, one RobotState per datagram in.

The robot's facts are read first, over HTTP. Commands are not acknowledged and nothing is authenticated. The robot sends
its state to one configured address, so this machine must be that address.
"""

from __future__ import annotations

import logging
import socket
import threading
from collections.abc import Mapping
from typing import Any

from asimov_gym.edge.clients.link import LinkReceiver
from asimov_gym.edge.clients.robot_facts import fetch_facts
from asimov_gym.edge.control import Dialect

CONTROL_PORT = 8850
"""Where the robot takes commands."""
STATE_PORT = 8851
"""Where it sends its state, on the client's machine."""
FACTS_PORT = 3000
"""Where it tells its facts (TCP)."""

_MAX_DATAGRAM = 65535
_POLL_S = 0.1
_log = logging.getLogger(__name__)


class UdpLink:
    """A client's end of the UDP lane.

    It listens for state on the one local address that faces the robot (loopback for a robot on loopback), and takes
    datagrams from the robot's address only.

    Args:
        host: the robot's name or address.
        control_port: UDP port for commands on the robot.
        state_port: UDP port for state on this machine.
        facts_port: TCP port of the robot's facts.
        timeout: s; to read the facts.

    Raises:
        ValueError: a port outside 1 to 65535.
    """

    dialect = Dialect.IO
    carries_events = False
    velocity_expires = True

    def __init__(
        self,
        host: str,
        control_port: int = CONTROL_PORT,
        state_port: int = STATE_PORT,
        facts_port: int = FACTS_PORT,
        timeout: float = 5.0,
    ) -> None:
        ports = {"control_port": control_port, "state_port": state_port, "facts_port": facts_port}
        for name, port in ports.items():
            if not 1 <= port <= 65535:
                raise ValueError(f"{name} must be from 1 to 65535, got {port}")
        self.address = f"udp://[{host}]:{control_port}" if ":" in host else f"udp://{host}:{control_port}"
        self.facts: Mapping[str, Any] | None = None
        self.silence_hint = (
            f"Does the robot send its state to this machine's port {state_port} (its --udp-state-host and "
            "--udp-state-port)? Only one client at a time can have it."
        )
        self.strangers = 0
        """Datagrams on the state port that did not come from the robot's address."""
        self._host = host
        self._control_port = control_port
        self._state_port = state_port
        self._facts_port = facts_port
        self._timeout = timeout
        self._commands: socket.socket | None = None
        self._states: socket.socket | None = None
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None

    def open(self, receiver: LinkReceiver) -> None:
        """Read the facts, then open both directions."""
        self.facts = fetch_facts(self._host, self._facts_port, self._timeout)
        try:
            self._open_sockets()
        except ConnectionError:
            self.close()
            raise
        self._thread = threading.Thread(target=self._listen, args=(receiver,), name="udp-link", daemon=True)
        self._thread.start()

    def _open_sockets(self) -> None:
        try:
            found = socket.getaddrinfo(self._host, self._control_port, type=socket.SOCK_DGRAM)
            # IPv4 first, as the robot sends: `localhost` often means ::1 before 127.0.0.1.
            family, kind, protocol, _, peer = min(found, key=lambda one: one[0] is not socket.AF_INET)
            self._commands = socket.socket(family, kind, protocol)
            self._commands.connect(peer)  # sends nothing; finds the local address that faces the robot
            here = self._commands.getsockname()[0]
        except OSError as problem:
            raise ConnectionError(f"cannot reach {self._host}: {problem}") from None
        try:
            self._states = socket.socket(family, kind, protocol)
            self._states.settimeout(_POLL_S)
            self._states.bind((here, self._state_port))
        except OSError as problem:
            raise ConnectionError(
                f"cannot listen for state on UDP port {self._state_port} of {here}: {problem.strerror}. Another client "
                "may have it: choose another port, and start the robot with the same --udp-state-port"
            ) from None

    def send(self, packet: bytes, streamed: bool = False) -> None:
        """Send one datagram. That nobody listens there shows as silence, not here."""
        commands = self._commands
        if commands is None:
            raise ConnectionError(f"the link to {self.address} is closed")
        for _ in range(2):  # the system may report the refusal of an earlier datagram in place of sending this one
            try:
                commands.send(packet)
                return
            except ConnectionRefusedError:
                continue
            except OSError as problem:
                raise ConnectionError(f"cannot send to {self.address}: {problem}") from None

    def close(self) -> None:
        """Close the sockets and end the thread."""
        self._stop.set()
        commands, self._commands = self._commands, None
        if commands is not None:
            commands.close()
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join()
        states, self._states = self._states, None
        if states is not None:
            states.close()

    def _listen(self, receiver: LinkReceiver) -> None:
        states, commands = self._states, self._commands
        assert states is not None and commands is not None
        robot = commands.getpeername()[0]
        while not self._stop.is_set():
            try:
                packet, sender = states.recvfrom(_MAX_DATAGRAM)
            except TimeoutError:
                continue
            except OSError as problem:
                _log.debug("state socket: %s", problem)
                self._stop.wait(_POLL_S)
                continue
            if sender[0] != robot:
                self.strangers += 1
                continue
            receiver.on_state(packet)
