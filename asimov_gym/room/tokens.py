"""Tokens that open a room: JSON Web Tokens with LiveKit's `video` grants, signed with a secret of this server."""

from __future__ import annotations

import json
import math
import os
import secrets
import stat
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import jwt

from asimov_gym.room.errors import RoomError, TokenError

_NAME_MAX = 128
_LEEWAY_S = 5.0


@dataclass(frozen=True)
class Grants:
    """What a participant may do. The defaults are those of LiveKit for a grant that a token leaves out."""

    can_publish: bool = True
    """Publish audio and video tracks."""
    can_publish_data: bool = True
    """Send data packets (RPC rides on them) and publish data tracks."""
    can_subscribe: bool = True
    """Receive audio, video and data tracks of others."""
    can_update_own_metadata: bool = False
    """Change its own name, metadata and attributes."""


_CLAIMS = {
    "can_publish": "canPublish",
    "can_publish_data": "canPublishData",
    "can_subscribe": "canSubscribe",
    "can_update_own_metadata": "canUpdateOwnMetadata",
}

ROLES: Mapping[str, Grants] = {
    "control": Grants(),
    "observe": Grants(can_publish=False, can_publish_data=False),
    "robot": Grants(can_update_own_metadata=True),
}
"""Grants of the roles that can be asked for at the token endpoint."""


@dataclass(frozen=True)
class Admission:
    """What a verified token says."""

    room: str
    identity: str
    grants: Grants
    expires_at: float
    """Seconds since 1970."""
    name: str = ""
    metadata: str = ""
    attributes: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class RoomKeys:
    """Secrets of a room server. Their representation does not show them.

    A server that is started again with the same keys accepts the tokens issued before.
    """

    secret: str = field(repr=False)
    """Signs the tokens, at least 32 characters."""
    credential: str = field(repr=False)
    """Bearer credential of the token endpoint, at least 16 characters."""
    api_key: str = "asimov-room"
    """Issuer that the tokens name."""

    def __post_init__(self) -> None:
        for name, least in (("secret", 32), ("credential", 16), ("api_key", 1)):
            value = getattr(self, name)
            if not isinstance(value, str) or len(value) < least or not value.isascii() or not value.isprintable():
                raise ValueError(f"{name} is not allowed: at least {least} printable ASCII characters are needed")

    @classmethod
    def generate(cls) -> RoomKeys:
        """New random keys."""
        return cls(secret=secrets.token_urlsafe(36), credential=secrets.token_urlsafe(24))

    @classmethod
    def from_file(cls, path: Path) -> RoomKeys:
        """Keys in a file that only its owner can read; written with new ones if it does not exist.

        Raises:
            RoomError: the file cannot be read or written, others can read it, or it holds something else.
        """
        try:
            handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        except FileExistsError:
            return cls._read(path)
        except OSError as error:
            raise RoomError(f"cannot write the key file {path}: {error.strerror}") from error
        keys = cls.generate()
        with os.fdopen(handle, "w") as file:
            json.dump({"api_key": keys.api_key, "secret": keys.secret, "credential": keys.credential}, file, indent=1)
        return keys

    @classmethod
    def _read(cls, path: Path) -> RoomKeys:
        try:
            if os.name == "posix" and stat.S_IMODE(path.stat().st_mode) & 0o077:
                raise RoomError(f"others can read the key file {path}: run chmod 600 {path}")
            return cls(**json.loads(path.read_text()))
        except OSError as error:
            raise RoomError(f"cannot read the key file {path}: {error.strerror}") from error
        except (ValueError, TypeError) as error:
            # Not the error's own words: they may quote what the file holds.
            raise RoomError(f"{path} is not a key file of `asimov room`: delete it, or name another") from error

    def issue(
        self,
        room: str,
        identity: str,
        grants: Grants | None = None,
        *,
        name: str = "",
        lifetime_s: float = 86_400.0,
        now: float | None = None,
    ) -> str:
        """Sign a token.

        Args:
            room: the room it opens.
            identity: of the participant; a second participant of the same identity evicts the first.
            grants: what it may do.
            name: shown to people.
            lifetime_s: seconds of validity.
            now: seconds since 1970; the wall clock if None.
        """
        check_name("room", room)
        check_name("identity", identity)
        issued = time.time() if now is None else now
        grants = Grants() if grants is None else grants
        video: dict[str, Any] = {"roomJoin": True, "room": room}
        video |= {claim: getattr(grants, attribute) for attribute, claim in _CLAIMS.items()}
        claims = {
            "iss": self.api_key,
            "sub": identity,
            "nbf": int(issued),
            "exp": math.ceil(issued + lifetime_s),
            "video": video,
        }
        if name:
            claims["name"] = name
        return jwt.encode(claims, self.secret, algorithm="HS256")

    def verify(self, token: str) -> Admission:
        """Check signature, issuer, validity and grants.

        Raises:
            TokenError: with the reason, without the token.
        """
        try:
            claims = jwt.decode(
                token,
                self.secret,
                algorithms=["HS256"],
                issuer=self.api_key,
                leeway=_LEEWAY_S,
                options={"require": ["exp", "sub", "iss"]},
            )
        except jwt.ExpiredSignatureError as error:
            raise TokenError("the token has expired") from error
        except jwt.InvalidTokenError as error:
            raise TokenError("the token is not one of this server") from error
        video = claims.get("video")
        if not isinstance(video, dict) or video.get("roomJoin") is not True:
            raise TokenError("the token has no grant to join a room")
        given = {attribute: video[claim] for attribute, claim in _CLAIMS.items() if video.get(claim) is not None}
        if not all(isinstance(value, bool) for value in given.values()):
            raise TokenError("a grant of the token is neither true nor false")
        texts = {key: claims.get(key, "") for key in ("name", "metadata")}
        attributes = claims.get("attributes") or {}
        if not all(isinstance(text, str) for text in texts.values()) or not _is_text_map(attributes):
            raise TokenError("the token's name, metadata or attributes are not text")
        try:
            room = check_name("room", video.get("room"))
            identity = check_name("identity", claims["sub"])
        except ValueError as error:
            raise TokenError(str(error)) from error
        return Admission(room, identity, Grants(**given), float(claims["exp"]), attributes=attributes, **texts)


def check_name(what: str, value: object) -> str:
    """The name of a room or a participant: 1 to 128 printable characters, no blanks around them."""
    if (
        not isinstance(value, str)
        or not 0 < len(value) <= _NAME_MAX
        or not value.isprintable()
        or value != value.strip()
    ):
        raise ValueError(f"{what} is not a name of 1 to {_NAME_MAX} printable characters without blanks around them")
    return value


def _is_text_map(value: object) -> bool:
    return isinstance(value, dict) and all(isinstance(k, str) and isinstance(v, str) for k, v in value.items())
