"""A robot's facts as a client reads them: fetched from its facts endpoint, and checked before anything is sent."""

from __future__ import annotations

import http.client
import json
import re
import socket
import threading
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from asimov_gym.edge.facts import ROBOT_MODEL, ROBOT_OS_VERSION

MAX_BYTES = 4096
"""Facts longer than this are refused."""
PATH = "/api/version"

_NUMBER = r"(?:0|[1-9][0-9]*)"
_VERSION = re.compile(
    rf"({_NUMBER})\.({_NUMBER})\.{_NUMBER}"
    rf"(?:\.dev\.[0-9]{{12}}\.[0-9a-f]{{7,40}}(?:\.dirty\.[0-9]{{12}})?|[-.]?(?:rc|dev|a|b|alpha|beta)\.?{_NUMBER})?"
)
_SUPPORTED_LINE = ROBOT_OS_VERSION.rsplit(".", 1)[0]


def parse_facts(document: bytes | str) -> Mapping[str, Any]:
    """Facts from the robot's JSON, checked: a supported model and version line.

    Raises:
        ConnectionError: they are malformed, or say that this is another robot; the message says which.
    """
    if len(document) > MAX_BYTES:
        raise ConnectionError(f"the robot's facts are longer than {MAX_BYTES} bytes")
    try:
        facts = json.loads(document, object_pairs_hook=_without_doubles)
    except (ValueError, RecursionError):
        raise ConnectionError("the robot's facts are not a JSON object with each key once") from None
    if not isinstance(facts, dict):
        raise ConnectionError("the robot's facts are not a JSON object")
    model, version = facts.get("robot_model"), facts.get("robot_os_version")
    if not isinstance(version, str) or (match := _VERSION.fullmatch(version)) is None:
        raise ConnectionError(f"the robot's facts give robot_os_version {version!r}, which is no version")
    if model != ROBOT_MODEL or ".".join(match.group(1, 2)) != _SUPPORTED_LINE:
        raise ConnectionError(
            f"the robot is a {model!r} with software {version}; supported is {ROBOT_MODEL!r} with {_SUPPORTED_LINE}.x"
        )
    return facts


def fetch_facts(host: str, port: int, timeout: float) -> Mapping[str, Any]:
    """Ask the robot at `host` for its facts, directly: no proxy, no redirect.

    Args:
        host: name or address.
        port: of its facts endpoint.
        timeout: s, for all of it.

    Raises:
        ConnectionError: no answer in time, not the status 200, or facts that `parse_facts` refuses.
    """
    place = f"http://{host}:{port}{PATH}"
    connection = http.client.HTTPConnection(host, port, timeout=timeout)
    deadline = threading.Timer(timeout, _interrupt, (connection,))
    deadline.daemon = True
    try:
        connection.connect()
        deadline.start()
        connection.request("GET", PATH, headers={"Accept": "application/json", "Connection": "close"})
        response = connection.getresponse()
        document = response.read(MAX_BYTES + 1)
    except (OSError, http.client.HTTPException) as problem:
        raise ConnectionError(
            f"no robot answers at {place}: {str(problem) or type(problem).__name__}. Is it running with its UDP lane, "
            "and is this its facts port?"
        ) from None
    finally:
        deadline.cancel()
        connection.close()
    if response.status != 200:
        raise ConnectionError(f"{place} answered {response.status}, not 200: this is no robot's facts endpoint")
    return parse_facts(document)


def _interrupt(connection: http.client.HTTPConnection) -> None:
    """End a reply that trickles: the blocked read sees the end of the stream."""
    with suppress(OSError, AttributeError):  # the socket may be gone
        connection.sock.shutdown(socket.SHUT_RDWR)


def _without_doubles(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    facts = dict(pairs)
    if len(facts) != len(pairs):
        raise ValueError("a key occurs twice")
    return facts
