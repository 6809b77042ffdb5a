"""What the room refuses, each in one line for people to read."""

from __future__ import annotations


class RoomError(RuntimeError):
    """The room cannot be opened: a busy port, an address that is not loopback, an unreadable key file."""


class TokenError(ValueError):
    """A token that opens nothing here. The message never repeats the token."""


class SessionDescriptionError(ValueError):
    """An offer or answer of WebRTC that this room cannot take."""
