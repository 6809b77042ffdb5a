"""The UDP lane: one RobotCommand per datagram in, one RobotState per datagram out, 200 times a second.

As on the robot, state goes to one configured address whoever sends commands, no command is answered, and nothing is
authenticated: whoever reaches the control port can drive the robot.
"""

from __future__ import annotations

import ipaddress
import logging
import socket
import threading
from collections import OrderedDict
from dataclasses import dataclass
from typing import Any

from asimov_gym.edge.control import Client, Dialect, Source
from asimov_gym.edge.decode import MAX_PACKET_BYTES
from asimov_gym.edge.edge import Edge
from asimov_gym.edge.lifecycle import Lifecycle
from asimov_gym.edge.listener import EdgeListener
from asimov_gym.edge.transports import TransportError
from asimov_gym.edge.wire import io_pb2

CONTROL_PORT = 8850
STATE_PORT = 8851
STATE_HZ = 200
"""Rate of RobotState: the robot's own, and the fastest there is."""
MIN_STATE_HZ = 5
"""Slower, the public client never sees the robot armed: a gap over 0.25 s starts its count anew."""
MAX_SENDERS = 64
"""Senders remembered; beyond it the one that was silent longest is taken to have left."""

_POLL_S = 0.1
_log = logging.getLogger(__name__)


@dataclass
class StateCounters:
    """What became of the RobotState datagrams."""

    sent: int = 0
    refused: int = 0
    """Nobody listens at the state address."""
    blocked: int = 0
    """The socket's buffer was full: the frame was left out, the control loop went on."""
    failed: int = 0
    """Any other error, such as no route."""


class UdpLane(Lifecycle, EdgeListener):
    """Serves one edge over UDP between `start` and `stop`, or as a context manager.

    Args:
        edge: takes the commands and gives the state.
        control_port: UDP port that takes commands; 0 for any free one, known after `start`.
        state_host: name or address that gets the state.
        state_port: UDP port there.
        listen: address that `control_port` is opened on.
        state_hz: frames per second, from 5 to 200, a divisor of 200. Below 200 every frame carries the alerts; at 200
            one in twenty does, as on the robot.

    Raises:
        TransportError: a port or rate out of range.
    """

    wants_robot_state = True

    def __init__(
        self,
        edge: Edge,
        control_port: int = CONTROL_PORT,
        state_host: str = "127.0.0.1",
        state_port: int = STATE_PORT,
        listen: str = "127.0.0.1",
        state_hz: int = STATE_HZ,
    ) -> None:
        check_port("--udp-control-port", control_port)
        check_port("--udp-state-port", state_port, lowest=1)
        if not MIN_STATE_HZ <= state_hz <= STATE_HZ or STATE_HZ % state_hz:
            raise TransportError(
                f"state_hz must be a divisor of {STATE_HZ} from {MIN_STATE_HZ} to {STATE_HZ}, got {state_hz}"
            )
        self.control_port = control_port
        self.state_host = state_host
        self.state_port = state_port
        self.listen = listen
        self.states = StateCounters()
        self._edge = edge
        self._every = STATE_HZ // state_hz
        self._until_next = 0
        self._alerts = b""
        self._senders: OrderedDict[Any, Client] = OrderedDict()
        self._control: socket.socket | None = None
        self._state: socket.socket | None = None
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None

    @property
    def connect_line(self) -> str:
        """What a client needs to know, for people."""
        control = f"udp://{_bracketed(self.listen)}:{self.control_port}"
        return f"{control}, state to {_bracketed(self.state_host)}:{self.state_port}"

    def start(self) -> None:
        """Open both sockets and serve, in a thread. No effect while it runs.

        Raises:
            TransportError: a port is taken or not ours to open, or an address is unknown here.
        """
        if self._thread is not None:
            return
        try:
            self._state = _state_socket(self.state_host, self.state_port)
            self._control = _control_socket(self.listen, self.control_port)
        except TransportError:
            self._close_sockets()
            raise
        self.control_port = self._control.getsockname()[1]
        if not is_loopback(self.listen):
            _log.warning(
                "UDP commands are taken on %s:%d, which is not loopback: nothing on UDP is authenticated, anyone who "
                "reaches this port can drive the robot",
                self.listen,
                self.control_port,
            )
        self._stop.clear()
        self._thread = threading.Thread(target=self._receive, args=(self._control,), name="udp-lane", daemon=True)
        self._thread.start()
        self._edge.attach(self)

    def stop(self) -> None:
        """Stop serving: the clients have left. No effect if it does not run."""
        if self._thread is None:
            return
        self._edge.detach(self)
        self._stop.set()
        self._thread.join()
        self._thread = None
        self._close_sockets()
        for client in self._senders.values():
            self._edge.leave(client)
        self._senders.clear()

    def _close_sockets(self) -> None:
        for opened in (self._control, self._state):
            if opened is not None:
                opened.close()
        self._control = self._state = None

    # -- commands ----------------------------------------------------------------------------------

    def _receive(self, control: socket.socket) -> None:
        while not self._stop.is_set():
            try:
                # One byte more than the edge takes: what is too large shows, however large it was.
                packet, address = control.recvfrom(MAX_PACKET_BYTES + 1)
            except TimeoutError:
                continue
            except OSError as problem:
                _log.warning("UDP control socket: %s", problem)
                self._stop.wait(_POLL_S)
                continue
            try:
                self._edge.receive(packet, self._client(address))
            except Exception:  # a defect of ours: one packet is lost, the lane stays open for DAMP
                _log.exception("a packet of %s was not taken", address)

    def _client(self, address: Any) -> Client:
        """The sender's identity: its address. A sender that only falls silent has not left; control passes anyway."""
        client = self._senders.get(address)
        if client is None:
            client = Client(Source.UDP, f"udp {_bracketed(address[0])}:{address[1]}", (Dialect.IO,))
            self._senders[address] = client
            if len(self._senders) > MAX_SENDERS:
                self._edge.leave(self._senders.popitem(last=False)[1])
        self._senders.move_to_end(address)
        return client

    # -- state -------------------------------------------------------------------------------------

    def on_robot_state(self, timestamp_us: int, packet: bytes, report: bool) -> None:
        """Send the frame if it is one of this lane's, without ever waiting."""
        if self._every > 1 and report:
            # Serialized messages of one type merge when joined, so the alerts are kept as such a message of their own.
            alerts = io_pb2.RobotState.FromString(packet).active_alerts
            self._alerts = io_pb2.RobotState(active_alerts=alerts).SerializeToString()
        self._until_next -= 1
        if self._until_next > 0:
            return
        self._until_next = self._every
        self._send(packet if report or self._every == 1 else packet + self._alerts)

    def _send(self, packet: bytes) -> None:
        if self._state is None:
            return
        try:
            self._state.send(packet)
        except ConnectionRefusedError:
            self.states.refused += 1
        except BlockingIOError:
            self.states.blocked += 1
        except OSError as problem:
            self.states.failed += 1
            level = logging.WARNING if self.states.failed == 1 else logging.DEBUG
            _log.log(level, "state to %s:%d: %s", self.state_host, self.state_port, problem)
        else:
            self.states.sent += 1


def check_port(flag: str, port: int, lowest: int = 0) -> None:
    """Refuse a port number that cannot be one.

    Raises:
        TransportError: it is not from `lowest` (0 stands for any free port) to 65535.
    """
    if not lowest <= port <= 65535:
        raise TransportError(f"{flag} must be from {lowest} to 65535, got {port}")


def is_loopback(host: str) -> bool:
    """Whether an address, or `localhost`, reaches this machine only."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _bracketed(host: str) -> str:
    return f"[{host}]" if ":" in host else host


def _resolve(flag: str, host: str, port: int) -> tuple[socket.AddressFamily, Any]:
    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)
    except OSError as problem:
        raise TransportError(f"{flag} {host}: {problem.strerror}") from None
    # IPv4 first, as the public client binds and sends: `localhost` often means ::1 before 127.0.0.1.
    family, _, _, _, address = min(found, key=lambda one: one[0] is not socket.AF_INET)
    return family, address


def _control_socket(host: str, port: int) -> socket.socket:
    family, address = _resolve("--listen", host, port)
    opened = socket.socket(family, socket.SOCK_DGRAM)
    try:
        opened.settimeout(_POLL_S)
        opened.bind(address)
    except OSError as problem:
        opened.close()
        raise TransportError(
            f"cannot take UDP commands on port {port} of {host}: {problem.strerror}; choose another with "
            "--udp-control-port"
        ) from None
    return opened


def _state_socket(host: str, port: int) -> socket.socket:
    family, address = _resolve("--udp-state-host", host, port)
    opened = socket.socket(family, socket.SOCK_DGRAM)
    try:
        opened.setblocking(False)
        opened.connect(address)  # sends nothing; a refusal by the other machine is reported to connected sockets only
    except OSError as problem:
        opened.close()
        raise TransportError(f"cannot send state to {host}:{port} (--udp-state-host): {problem.strerror}") from None
    return opened
