"""Joining a LiveKit room: the package, the address, and in one line why it did not work."""

from __future__ import annotations

import asyncio
import logging
import re
import traceback
from dataclasses import dataclass, field
from types import ModuleType
from typing import Any
from urllib.parse import urlsplit

CONNECT_TIMEOUT_S = 3.0
"""For one attempt to reach the server; the client library makes four."""
JOIN_TIMEOUT_S = 30.0
"""For joining as a whole. A server that does not answer is given up before that."""
LEAVE_TIMEOUT_S = 3.0

_TOKEN_SHAPE = re.compile(r"\beyJ[\w-]+\.[\w-]+\.[\w-]+")
_NO_DATA = (
    "the server answers, but no data connection comes about. The client library needs a network interface besides "
    "loopback on this machine"
)
_REASONS = (
    (r"connection refused", "nothing listens there. Is the server running? `asimov room` starts one for development"),
    (r"\b(401|403)\b", "the server refuses the token (expired, for another server, or without the right to join?)"),
    (r"\b404\b", "what answers there is no LiveKit server"),
    (r"failed to parse the url|dns|lookup|resolve", "there is no such host"),
    (r"pc_connection|peer ?connection", _NO_DATA),
    (r"timed out|timeout", "no answer"),
)


class JoinError(Exception):
    """The room was not joined; the message is one line without a credential."""


@dataclass(frozen=True)
class RoomAddress:
    """Where a room is, and what opens it.

    Raises:
        ValueError: the URL is none of a LiveKit server, or there is no token.
    """

    url: str
    """`ws://` or `wss://`; the token says which room it is."""
    token: str = field(repr=False)
    """A JWT. It never appears in messages, logs or events."""

    def __post_init__(self) -> None:
        try:
            parts = urlsplit(self.url)
            _ = parts.port
        except ValueError as problem:
            raise ValueError(f"the LiveKit URL is malformed: {problem}") from None
        if parts.username or parts.password or parts.query or parts.fragment:
            raise ValueError("the LiveKit URL must be ws://HOST:PORT or wss://HOST alone; the token is given by itself")
        if parts.scheme not in ("ws", "wss") or not parts.hostname:
            raise ValueError(f"the LiveKit URL must begin with ws:// or wss:// and name a host, got {self.url!r}")
        if not self.token or self.token.strip() != self.token:
            raise ValueError("the LiveKit token is empty or has blanks around it")


def load_rtc() -> ModuleType:
    """The client library's module `livekit.rtc`.

    Raises:
        ImportError: it is not installed; one line that says how to.
    """
    try:
        from livekit import rtc
    except ImportError as problem:
        raise ImportError(
            f"the LiveKit client library is missing ({problem}): pip install 'asimov-gym[livekit]'"
        ) from None
    log = logging.getLogger("livekit")
    if not any(isinstance(known, _HideTokens) for known in log.filters):
        log.addFilter(_HideTokens())
        if log.level == logging.NOTSET:
            # Every step of every attempt is a warning or an error there; what matters of it the lane says in its own
            # words. To see it all: logging.getLogger("livekit").setLevel(logging.INFO), before the room is joined.
            log.setLevel(logging.CRITICAL)
    return rtc


async def join(rtc: ModuleType, room: Any, address: RoomAddress) -> None:
    """Connect a room object, whose handlers are in place.

    Raises:
        JoinError: it did not work.
    """
    options = rtc.RoomOptions(auto_subscribe=False, connect_timeout=CONNECT_TIMEOUT_S)
    try:
        async with asyncio.timeout(JOIN_TIMEOUT_S):
            await room.connect(address.url, address.token, options)
    except TimeoutError:
        raise JoinError(f"cannot join the room at {address.url}: {_NO_DATA}") from None
    except rtc.ConnectError as problem:
        raise JoinError(f"cannot join the room at {address.url}: {_reason(str(problem.message), address)}") from None


async def leave(room: Any) -> None:
    """Disconnect, within a bounded time."""
    try:
        async with asyncio.timeout(LEAVE_TIMEOUT_S):
            await room.disconnect()
    except TimeoutError:
        logging.getLogger(__name__).warning("the room did not confirm that it was left")


def hide_token(text: str, token: str = "") -> str:
    """A text without the token, and without anything else that looks like one."""
    return _TOKEN_SHAPE.sub("(token)", text.replace(token, "(token)") if token else text)


def hidden_traceback(problem: BaseException, token: str) -> str:
    """Where an error came from, for a log."""
    return hide_token("".join(traceback.format_exception(problem)), token)


def _reason(text: str, address: RoomAddress) -> str:
    for pattern, reason in _REASONS:
        if re.search(pattern, text, re.IGNORECASE):
            return reason
    return hide_token(" ".join(text.split()), address.token)[:200]


class _HideTokens(logging.Filter):
    """The library repeats what a server says; should that be a token, it is blotted out."""

    def filter(self, record: logging.LogRecord) -> bool:
        message = record.getMessage()
        hidden = hide_token(message)
        if hidden != message:
            record.msg, record.args = hidden, None
        return True
