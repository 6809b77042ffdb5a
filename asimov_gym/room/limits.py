"""Bounds of a room server: how many, how large, how long."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any

_RANGES: dict[str, tuple[float, float]] = {
    "rooms": (1, 100),
    "participants": (2, 64),
    "tracks": (1, 32),
    "data_tracks": (1, 256),
    "signal_bytes": (16_384, 4_194_304),
    "body_bytes": (256, 65_536),
    "packet_bytes": (1024, 65_536),
    "metadata_bytes": (256, 65_536),
    "backlog_bytes": (65_536, 67_108_864),
    "ping_interval_s": (1, 60),
    "ping_timeout_s": (2, 120),
    "join_timeout_s": (2, 120),
    "token_lifetime_s": (10, 604_800),
}


@dataclass(frozen=True)
class RoomLimits:
    """Bounds of a room server. A participant that goes beyond one is refused or dropped; nothing grows without end."""

    rooms: int = 8
    """Rooms open at once. A room opens with its first participant and closes with its last."""
    participants: int = 16
    """Participants of one room."""
    tracks: int = 8
    """Audio and video tracks of one participant."""
    data_tracks: int = 32
    """Data tracks of one participant."""
    signal_bytes: int = 262_144
    """Largest signalling message."""
    body_bytes: int = 4096
    """Largest body of a request for a token."""
    packet_bytes: int = 65_536
    """Largest data packet, also announced to clients."""
    metadata_bytes: int = 16_384
    """Metadata, and attributes in total, of one participant."""
    backlog_bytes: int = 4_194_304
    """Reliable data waiting for a participant that reads too slowly; beyond it, it is dropped from the room."""
    ping_interval_s: int = 5
    """How often a client is asked to send a ping."""
    ping_timeout_s: int = 15
    """Silence of its signalling after which a participant is gone."""
    join_timeout_s: float = 20.0
    """Time from joining to an open data connection."""
    token_lifetime_s: float = 86_400.0
    """How long a token issued here is valid."""

    def __post_init__(self) -> None:
        for field in fields(self):
            low, high = _RANGES[field.name]
            check_range(field.name, getattr(self, field.name), low, high, whole=field.type == "int")
        if self.ping_timeout_s <= self.ping_interval_s:
            raise ValueError(
                f"ping_timeout_s is {self.ping_timeout_s}; allowed: above ping_interval_s = {self.ping_interval_s}"
            )


def check_range(name: str, value: Any, low: float, high: float, whole: bool = False) -> None:
    """Raise a ValueError that names the setting if the value is no number within low..high."""
    number = isinstance(value, int if whole else (int, float)) and not isinstance(value, bool)
    if not (number and math.isfinite(value) and low <= value <= high):
        kind = "whole numbers" if whole else "numbers"
        raise ValueError(f"{name} is {value!r}; allowed: {kind} from {low:g} to {high:g}")
