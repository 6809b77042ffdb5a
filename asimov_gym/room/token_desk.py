"""`POST /api/livekit/token`: a token for a room, in exchange for the server's bearer credential."""

from __future__ import annotations

import hmac
import json
import re
import secrets
import time
from typing import Any

from aiohttp import web

from asimov_gym.room.limits import RoomLimits
from asimov_gym.room.tokens import ROLES, RoomKeys, check_name

PATH = "/api/livekit/token"
_FIELDS = ("label", "identity", "role", "room")


class TokenDesk:
    """Answers requests for tokens.

    The request's body is a JSON object, or nothing. `label`, `identity`, `role` (`control`, `observe` or `robot`) and
    `room` are optional texts; other keys are ignored. The reply names `url`, `room`, `token`, `identity`, `role` and
    `expires_at` (seconds since 1970). Every error is an object with `error` and a status that is not 200: 401 for the
    credential, 413 for a body that is too large, 400 for one that cannot be used.

    Args:
        keys: of the server.
        limits: of the server.
        room: the room that a token is for if the request names none.
    """

    def __init__(self, keys: RoomKeys, limits: RoomLimits, room: str) -> None:
        self._keys, self._limits, self._room = keys, limits, room

    async def answer(self, request: web.Request) -> web.Response:
        """Answer one request."""
        given = bearer(request)
        if given is None or not hmac.compare_digest(given.encode(), self._keys.credential.encode()):
            return _error(401, "the bearer credential is missing or wrong", {"WWW-Authenticate": "Bearer"})
        try:
            wanted = _read(await request.read(), self._limits.body_bytes)
        except web.HTTPRequestEntityTooLarge:
            return _error(413, f"the body is larger than {self._limits.body_bytes} bytes")
        except ValueError as error:
            return _error(400, str(error))
        role = wanted.get("role", "control")
        if role not in ROLES:
            return _error(400, f"role is {role!r}; allowed: {', '.join(ROLES)}")
        label = re.sub(r"[^A-Za-z0-9._-]+", "-", wanted.get("label", "")).strip("-")[:64] or "client"
        try:
            identity = check_name("identity", wanted.get("identity", f"{label}-{secrets.token_hex(3)}"))
            room = check_name("room", wanted.get("room", self._room))
        except ValueError as error:
            return _error(400, str(error))
        lifetime, now = self._limits.token_lifetime_s, time.time()
        token = self._keys.issue(
            room, identity, ROLES[role], name=wanted.get("label", "")[:128], lifetime_s=lifetime, now=now
        )
        reply = {
            "url": f"ws://{request.host}",
            "room": room,
            "token": token,
            "identity": identity,
            "role": role,
            "expires_at": int(now + lifetime),
        }
        return web.json_response(reply, headers={"Cache-Control": "no-store"})


def bearer(request: web.Request) -> str | None:
    """What follows `Bearer` in the request's Authorization header."""
    scheme, _, value = request.headers.get("Authorization", "").partition(" ")
    return value.strip() if scheme.lower() == "bearer" and value.strip() else None


def _read(body: bytes, most: int) -> dict[str, str]:
    if len(body) > most:
        raise web.HTTPRequestEntityTooLarge(most, len(body))
    if not body.strip():
        return {}
    try:
        wanted: Any = json.loads(body)
    except (ValueError, RecursionError) as error:
        raise ValueError("the body is not JSON") from error
    if not isinstance(wanted, dict):
        raise ValueError("the body is not a JSON object")
    for name in _FIELDS:
        if not isinstance(wanted.get(name, ""), str):
            raise ValueError(f"{name} is not a text")
    return {name: wanted[name] for name in _FIELDS if wanted.get(name)}


def _error(status: int, message: str, headers: dict[str, str] | None = None) -> web.Response:
    return web.json_response({"error": message}, status=status, headers=headers)
