"""The facts endpoint: `GET /api/version` over HTTP, which a UDP client reads before it opens anything else."""

from __future__ import annotations

import json
import logging
import socket
import socketserver
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from http import HTTPStatus
from typing import Any

from asimov_gym.edge.facts import facts
from asimov_gym.edge.lifecycle import Lifecycle
from asimov_gym.edge.transports import TransportError
from asimov_gym.edge.transports.udp import check_port, is_loopback

FACTS_PORT = 3000
PATH = "/api/version"
REQUEST_S = 2.0
"""A client has this long for its whole request, and again to take the reply."""
DRAIN_S = 0.5
"""After the reply, this long for the client to finish sending and to close."""
MAX_REQUEST_BYTES = 8192
"""Request line and headers; a longer request is refused."""
MAX_CONCURRENT = 16
"""Requests at a time; one more is closed unread."""
_PAUSE_S = 0.1
"""After a connection that cannot be accepted, for want of file descriptors most likely."""

_END = b"\r\n\r\n"
_log = logging.getLogger(__name__)


class FactsServer(Lifecycle):
    """Tells the robot's facts between `start` and `stop`, or as a context manager.

    Every request has a connection, a thread and 2 s of its own, at most 16 at a time, so that slow or silent clients
    hold up nobody for long.

    Args:
        port: TCP; 0 for any free one, known after `start`.
        listen: address that it is opened on.
        document: what to tell, asked for with each request.

    Raises:
        TransportError: the port is out of range.
    """

    def __init__(
        self,
        port: int = FACTS_PORT,
        listen: str = "127.0.0.1",
        document: Callable[[], Mapping[str, Any]] = facts,
    ) -> None:
        check_port("--facts-port", port)
        self.port = port
        self.listen = listen
        self._document = document
        self._server: _Server | None = None
        self._thread: threading.Thread | None = None

    @property
    def connect_line(self) -> str:
        """Where the facts are, for people."""
        host = f"[{self.listen}]" if ":" in self.listen else self.listen
        return f"http://{host}:{self.port}{PATH}"

    def start(self) -> None:
        """Open the port and serve, in a thread. No effect while it runs.

        Raises:
            TransportError: the port is taken or not ours to open, or the address is unknown here.
        """
        if self._server is not None:
            return
        try:
            family, _, _, _, address = socket.getaddrinfo(self.listen, self.port, type=socket.SOCK_STREAM)[0]
            self._server = _Server(family, address, self._document)
        except OSError as problem:
            raise TransportError(
                f"cannot tell the facts on TCP port {self.port} of {self.listen}: {problem.strerror}; choose another "
                "with --facts-port"
            ) from None
        self.port = self._server.server_address[1]
        if not is_loopback(self.listen):
            _log.warning("the robot's facts are told on %s:%d, which is not loopback", self.listen, self.port)
        self._thread = threading.Thread(
            target=self._server.serve_forever, kwargs={"poll_interval": 0.1}, name="facts-server", daemon=True
        )
        self._thread.start()

    def stop(self) -> None:
        """Close the port. No effect if it is not open."""
        if self._server is None or self._thread is None:
            return
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()
        self._server = self._thread = None


class _Server(socketserver.ThreadingTCPServer):
    daemon_threads = True
    block_on_close = False
    request_queue_size = MAX_CONCURRENT
    allow_reuse_address = True  # a port just closed may be opened again at once; one in use may not

    def __init__(self, family: socket.AddressFamily, address: Any, document: Callable[[], Mapping[str, Any]]) -> None:
        self.address_family = family
        self.document = document
        self._places = threading.BoundedSemaphore(MAX_CONCURRENT)
        super().__init__(address, _Request)

    def get_request(self) -> Any:
        try:
            return super().get_request()
        except OSError:
            time.sleep(_PAUSE_S)  # the connection still waits: without a pause the loop would spin
            raise

    def process_request(self, request: Any, client_address: Any) -> None:
        if not self._places.acquire(blocking=False):
            self.shutdown_request(request)
            return
        try:
            super().process_request(request, client_address)
        except BaseException:  # no thread to be had
            self._places.release()
            raise

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._places.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        _log.debug("facts request of %s", client_address, exc_info=True)


class _Request(socketserver.BaseRequestHandler):
    """One connection: one request, one reply."""

    server: _Server

    def handle(self) -> None:
        try:
            received = self._read_head(time.monotonic() + REQUEST_S)
        except OSError:  # too slow, or gone
            return
        status, body = self._answer(received)
        headers = [
            f"HTTP/1.1 {status.value} {status.phrase}",
            "Content-Type: application/json; charset=utf-8",
            f"Content-Length: {len(body)}",
            "Cache-Control: no-store",
            "Connection: close",
        ]
        if status is HTTPStatus.METHOD_NOT_ALLOWED:
            headers.append("Allow: GET")
        self.request.settimeout(REQUEST_S)
        self.request.sendall("\r\n".join(headers).encode() + _END + body)
        self._drain()

    def _read_head(self, deadline: float) -> bytes:
        """Request line and headers, or as much as came; the deadline holds for all of it."""
        received = b""
        while _END not in received and len(received) <= MAX_REQUEST_BYTES:
            self.request.settimeout(max(0.001, deadline - time.monotonic()))
            chunk = self.request.recv(4096)
            if not chunk:
                break
            received += chunk
        return received

    def _answer(self, received: bytes) -> tuple[HTTPStatus, bytes]:
        head, end, _ = received.partition(_END)
        words = head.split(b"\r\n", 1)[0].split(b" ")
        if len(head) > MAX_REQUEST_BYTES:
            return _refusal(HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE)
        if not end or len(words) != 3 or not words[2].startswith(b"HTTP/1."):
            return _refusal(HTTPStatus.BAD_REQUEST)
        if words[1].split(b"?", 1)[0] != PATH.encode():
            return _refusal(HTTPStatus.NOT_FOUND)
        if words[0] != b"GET":
            return _refusal(HTTPStatus.METHOD_NOT_ALLOWED)
        return HTTPStatus.OK, json.dumps(self.server.document()).encode()

    def _drain(self) -> None:
        """Take what the client still sends, for a while: closing on unread bytes would cost it the reply."""
        deadline = time.monotonic() + DRAIN_S
        with suppress(OSError):
            self.request.shutdown(socket.SHUT_WR)
            while (left := deadline - time.monotonic()) > 0.0:
                self.request.settimeout(left)
                if not self.request.recv(65536):
                    return


def _refusal(status: HTTPStatus) -> tuple[HTTPStatus, bytes]:
    return status, json.dumps({"error": status.phrase}).encode()
