"""The facts endpoint, and the client that reads it."""

from __future__ import annotations

import http.client
import json
import socket
import threading
import time
from collections.abc import Iterator

import pytest

from asimov_gym.edge.clients.robot_facts import fetch_facts, parse_facts
from asimov_gym.edge.facts import facts
from asimov_gym.edge.transports import TransportError
from asimov_gym.edge.transports import facts_server as module
from asimov_gym.edge.transports.facts_server import FactsServer


@pytest.fixture
def server() -> Iterator[FactsServer]:
    with FactsServer(port=0) as server:
        yield server


def ask(port: int, method: str = "GET", path: str = "/api/version") -> tuple[http.client.HTTPResponse, bytes]:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=5.0)
    connection.request(method, path, headers={"Accept": "application/json"})
    response = connection.getresponse()
    body = response.read()
    connection.close()
    return response, body


def raw(port: int, request: bytes) -> bytes:
    with socket.create_connection(("127.0.0.1", port), timeout=5.0) as connection:
        connection.sendall(request)
        reply = b""
        while chunk := connection.recv(4096):
            reply += chunk
        return reply


def test_facts_are_told_as_the_public_client_needs_them(server) -> None:
    response, body = ask(server.port)
    assert response.status == 200 and response.version == 11
    assert response.getheader("Content-Type").startswith("application/json")
    assert int(response.getheader("Content-Length")) == len(body) <= 4096
    document = json.loads(body)
    assert document == facts()
    assert (document["robot_model"], document["robot_os_version"]) == ("asimov_1", "0.2.0")
    assert document["simulator"].startswith("asimov-gym ")


def test_other_paths_and_methods_are_refused(server) -> None:
    assert ask(server.port, path="/")[0].status == 404
    assert ask(server.port, path="/api/version/more")[0].status == 404
    response, _ = ask(server.port, method="POST")
    assert response.status == 405 and response.getheader("Allow") == "GET"


@pytest.mark.parametrize(
    ("request_bytes", "status"),
    [
        (b"nonsense\r\n\r\n", 400),
        (b"GET /api/version\r\n\r\n", 400),
        (b"\x00\xff\r\n\r\n", 400),
        (b"GET /api/version HTTP/1.1\r\nX: " + b"a" * 10_000 + b"\r\n\r\n", 431),
    ],
)
def test_malformed_requests_get_an_error(server, request_bytes: bytes, status: int) -> None:
    assert raw(server.port, request_bytes).startswith(b"HTTP/1.1 %d " % status)
    assert ask(server.port)[0].status == 200


def test_slow_clients_are_cut_off_and_hold_nobody_up(server, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "REQUEST_S", 0.3)
    with socket.create_connection(("127.0.0.1", server.port), timeout=5.0) as slow:
        began = time.monotonic()
        slow.sendall(b"GET /api/ver")
        assert ask(server.port)[0].status == 200
        # A byte now and then must not buy more time: the deadline is for the whole request.
        for _ in range(3):
            time.sleep(0.1)
            slow.sendall(b"s")
        assert slow.recv(100) == b""
        assert time.monotonic() - began < 2.0


def test_too_many_at_once_are_turned_away_until_one_leaves(server, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "REQUEST_S", 30.0)
    # The server accepts in order, so all of these have their place before the next one comes.
    crowd = [socket.create_connection(("127.0.0.1", server.port), timeout=5.0) for _ in range(module.MAX_CONCURRENT)]
    with pytest.raises(ConnectionError):
        ask(server.port)
    for one in crowd:
        one.close()
    end = time.monotonic() + 5.0
    while True:
        try:
            assert ask(server.port)[0].status == 200
            break
        except ConnectionError:
            assert time.monotonic() < end, "the places were not given back"
            time.sleep(0.02)


def test_busy_and_impossible_ports_are_named(server) -> None:
    with pytest.raises(TransportError, match=rf"TCP port {server.port} of 127\.0\.0\.1.*--facts-port"):
        FactsServer(port=server.port).start()
    with pytest.raises(TransportError, match="--facts-port must be from 0 to 65535, got 70000"):
        FactsServer(port=70_000)


def test_start_and_stop_may_be_repeated() -> None:
    server = FactsServer(port=0)
    server.start()
    server.start()
    port = server.port
    assert server.connect_line == f"http://127.0.0.1:{port}/api/version"
    server.stop()
    server.stop()
    with pytest.raises(ConnectionRefusedError):
        ask(port)
    server.start()
    assert ask(port)[0].status == 200
    server.stop()


# -- the client ------------------------------------------------------------------------------------


def test_client_reads_the_facts(server) -> None:
    assert fetch_facts("127.0.0.1", server.port, timeout=5.0) == facts()


@pytest.mark.parametrize("version", ["0.2.0", "0.2.17", "0.2.0rc1", "0.2.0-dev.1", "0.2.0.dev.202611220130.abcdef0"])
def test_versions_of_the_supported_line_are_taken(version: str) -> None:
    document = json.dumps({"robot_model": "asimov_1", "robot_os_version": version, "other": [1]})
    assert parse_facts(document)["robot_os_version"] == version


@pytest.mark.parametrize(
    ("document", "complaint"),
    [
        ('{"robot_model": "asimov_1", "robot_os_version": "0.3.0"}', "software 0.3.0"),
        ('{"robot_model": "asimov_1_sim", "robot_os_version": "0.2.0"}', "'asimov_1_sim'"),
        ('{"robot_model": "asimov_1", "robot_os_version": "v0.2.0"}', "no version"),
        ('{"robot_model": "asimov_1", "robot_os_version": "0.2.0+sim"}', "no version"),
        ('{"robot_model": "asimov_1", "robot_os_version": "0.2"}', "no version"),
        ('{"robot_model": "asimov_1"}', "None"),
        ('{"robot_model": "asimov_1", "robot_os_version": "0.2.0", "robot_model": "x"}', "each key once"),
        ("[]", "not a JSON object"),
        ("<html>", "not a JSON object"),
        ('{"a": "' + "x" * 5000 + '"}', "longer than 4096"),
    ],
)
def test_other_robots_and_other_servers_are_refused(document: str, complaint: str) -> None:
    with pytest.raises(ConnectionError, match=complaint):
        parse_facts(document)


def test_client_says_where_no_robot_answers() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))  # bound but not listening: refused
        port = taken.getsockname()[1]
        with pytest.raises(ConnectionError, match=rf"no robot answers at http://127\.0\.0\.1:{port}/api/version"):
            fetch_facts("127.0.0.1", port, timeout=2.0)


def test_client_does_not_wait_longer_than_its_timeout_for_a_trickle() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def trickle() -> None:
            connection, _ = listener.accept()
            with connection:
                try:
                    for byte in b"HTTP/1.1 200 OK\r\n" + b"X: y\r\n" * 1000:
                        connection.sendall(bytes([byte]))
                        time.sleep(0.05)
                except OSError:
                    return

        threading.Thread(target=trickle, daemon=True).start()
        began = time.monotonic()
        with pytest.raises(ConnectionError):
            fetch_facts("127.0.0.1", listener.getsockname()[1], timeout=0.4)
        assert time.monotonic() - began < 2.0


@pytest.mark.parametrize("status", [b"301 Moved\r\nLocation: http://127.0.0.1/", b"404 Not Found", b"204 No Content"])
def test_client_refuses_another_status_and_follows_nowhere(status: bytes) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def answer() -> None:
            connection, _ = listener.accept()
            with connection:
                connection.recv(4096)
                connection.sendall(b"HTTP/1.1 " + status + b"\r\nContent-Length: 0\r\n\r\n")

        threading.Thread(target=answer, daemon=True).start()
        with pytest.raises(ConnectionError, match=f"answered {int(status[:3])}, not 200"):
            fetch_facts("127.0.0.1", listener.getsockname()[1], timeout=2.0)
