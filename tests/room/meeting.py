"""Clients of the public LiveKit library that meet in a room."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING, Any

from asimov_gym.room import RoomThread

if TYPE_CHECKING:
    from livekit import rtc

RATE = 48_000
"""Samples of sound per second, Hz."""


async def until(condition: Callable[[], object], seconds: float = 10.0) -> None:
    """Wait until the condition holds."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, f"it did not come about within {seconds:g} s"
        await asyncio.sleep(0.01)


@asynccontextmanager
async def clients(server: RoomThread, *identities: str, room: str | None = None) -> AsyncIterator[list[rtc.Room]]:
    """Clients that have joined and see each other."""
    from livekit import rtc

    rooms = [rtc.Room() for _ in identities]
    try:
        for client, identity in zip(rooms, identities, strict=True):
            await client.connect(server.url, server.token(room, identity, can_update_own_metadata=True))
        await until(lambda: all(len(client.remote_participants) == len(rooms) - 1 for client in rooms))
        yield rooms
    finally:
        for client in rooms:
            await client.disconnect()


def collect(client: rtc.Room, event: str) -> list[Any]:
    """What a client reports under an event from now on."""
    reports: list[Any] = []
    client.on(event, lambda *report: reports.append(report[0] if len(report) == 1 else report))
    return reports


@asynccontextmanager
async def clients_later(server: RoomThread, identity: str) -> AsyncIterator[rtc.Room]:
    """A client that joins a room where others are."""
    from livekit import rtc

    client = rtc.Room()
    await client.connect(server.url, server.token(None, identity))
    try:
        yield client
    finally:
        await client.disconnect()
