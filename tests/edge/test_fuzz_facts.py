"""The facts endpoint under malformed HTTP and clients that dawdle: an answer or a closed connection, and no remains."""

from __future__ import annotations

import errno
import json
import os
import random
import resource
import socket
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress

import pytest

from asimov_gym.edge.facts import facts
from asimov_gym.edge.transports import facts_server as module
from asimov_gym.edge.transports.facts_server import MAX_CONCURRENT, FactsServer
from tests.footprint import Footprint, eventually

REQUEST = b"GET /api/version HTTP/1.1\r\nHost: robot\r\nAccept: application/json\r\n\r\n"
ALLOWED = {200, 400, 404, 405, 431}
_STUFF = (b"\r\n", b"\r\n\r\n", b"\x00", b" ", b"GET", b"HTTP/1.1", b"/" * 300, b"Content-Length: -1\r\n", b"\xff" * 40)


def requests(count: int, seed: int) -> Iterator[bytes]:
    """A sound request with bytes changed, cut out, put in and doubled; some far too long."""
    dice = random.Random(seed)
    for _ in range(count):
        request = bytearray(REQUEST)
        for _ in range(dice.choice((0, 1, 1, 2, 5, 20))):
            place = dice.randrange(len(request) + 1)
            match dice.randrange(5):
                case 0:
                    request[place : place + 1] = dice.randbytes(1)
                case 1:
                    del request[place : place + dice.randrange(30)]
                case 2:
                    request[place:place] = dice.choice(_STUFF)
                case 3:
                    request[place:place] = dice.randbytes(dice.randrange(1, 20))
                case _:
                    request += request[place:]
        if dice.random() < 0.03:
            request[dice.randrange(len(request) + 1) :] = dice.randbytes(1) * dice.choice((9_000, 100_000))
        yield bytes(request)


def ask(port: int, request: bytes, whole: bool = True) -> bytes:
    """Send a request and return all that comes back before the connection is closed."""
    reply = b""
    with socket.create_connection(("127.0.0.1", port), timeout=10.0) as connection:
        try:
            connection.sendall(request)
            if whole:
                connection.shutdown(socket.SHUT_WR)
            while chunk := connection.recv(65_536):
                reply += chunk
        except OSError as error:  # closed while we sent: that is an answer, too
            if not isinstance(error, ConnectionError) and error.errno != errno.ENOTCONN:
                raise
    return reply


def status(reply: bytes) -> int:
    """Status code of a reply, whose form is checked; 0 for none."""
    if not reply:
        return 0
    head, _, body = reply.partition(b"\r\n\r\n")
    lines = head.decode("ascii").split("\r\n")
    version, code, _ = lines[0].split(" ", 2)
    assert version == "HTTP/1.1"
    assert f"Content-Length: {len(body)}" in lines
    document = json.loads(body)
    assert (document == facts()) == (code == "200")
    return int(code)


def test_malformed_requests_are_answered_or_refused() -> None:
    before = Footprint.now()
    with FactsServer(port=0) as server:
        seen = Counter(status(ask(server.port, request)) for request in requests(1500, seed=21))
        # The mutations must reach every answer, or they test nothing. None is only due when the sender was cut off.
        assert seen.keys() >= ALLOWED and seen.keys() <= ALLOWED | {0}, seen
        assert seen[200] > 100 and seen[0] < 50, seen
        assert status(ask(server.port, REQUEST)) == 200
    eventually(lambda: threading.active_count() == len(before.threads), "every request's thread has ended")
    assert Footprint.now().files == before.files


def test_a_crowd_of_dawdlers_passes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Half requests, silent clients, and clients that never take their reply: they are cut off, others get through."""
    monkeypatch.setattr(module, "REQUEST_S", 0.3)
    monkeypatch.setattr(module, "DRAIN_S", 0.1)
    before = Footprint.now()
    dice = random.Random(22)
    with FactsServer(port=0) as server:
        crowd = []
        for _ in range(3 * MAX_CONCURRENT):
            dawdler = socket.create_connection(("127.0.0.1", server.port), timeout=10.0)
            with suppress(ConnectionError):  # it may be one too many
                dawdler.sendall(REQUEST[: dice.choice((0, 5, 30, len(REQUEST)))])
            crowd.append(dawdler)
        assert threading.active_count() <= len(before.threads) + MAX_CONCURRENT + 1

        def served() -> bool:
            return status(ask(server.port, REQUEST)) == 200

        eventually(served, "a client is served again")
        for dawdler in crowd:
            dawdler.close()
        assert served()
    eventually(lambda: threading.active_count() == len(before.threads), "every request's thread has ended")
    assert Footprint.now().files == before.files


def test_without_file_descriptors_it_waits_and_does_not_spin() -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    taken: list[int] = []
    with FactsServer(port=0) as server, socket.socket() as client:
        resource.setrlimit(resource.RLIMIT_NOFILE, (client.fileno() + 20, hard))
        try:
            with suppress(OSError):
                while True:
                    taken.append(os.dup(client.fileno()))
            client.connect(("127.0.0.1", server.port))
            began = time.process_time()
            time.sleep(0.5)
            used_s = time.process_time() - began
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
            for file in taken:
                os.close(file)
        assert used_s < 0.1
        client.sendall(REQUEST)
        assert client.recv(4096).startswith(b"HTTP/1.1 200 ")
