"""The participants of a room who send commands, as clients of the edge."""

from __future__ import annotations

import hashlib

from asimov_gym.edge.control import Client, Dialect, Source
from asimov_gym.edge.edge import Edge

LONGEST_NAME = 64
UNKNOWN = "room (unknown)"
"""Name of a sender whom the room does not know (any more)."""


def client_name(identity: str) -> str:
    """A client's name for events, logs and recordings, from an identity that somebody chose.

    `room IDENTITY`. An identity that is long or holds characters that are not printable is shortened and cleaned, and
    gets a digest, so that no two clients share a name.
    """
    clean = "".join(character if character.isprintable() else "?" for character in identity[:LONGEST_NAME])
    if clean != identity or not clean or "#" in clean or f"room {clean}" == UNKNOWN:
        clean += "#" + hashlib.blake2b(identity.encode("utf-8", "surrogatepass"), digest_size=6).hexdigest()
    return f"room {clean}"


class RoomSenders:
    """Hands packets of participants to an edge, and tells it when one of them has gone.

    Args:
        edge: takes the commands.
        dialects: that they may speak.
    """

    def __init__(self, edge: Edge, dialects: tuple[Dialect, ...]) -> None:
        self._edge = edge
        self._dialects = dialects
        self._clients: dict[str, Client] = {}

    def packet(self, identity: str | None, data: bytes, streamed: bool = False) -> None:
        """A packet came in; `identity` is None when the room cannot tell from whom.

        A last DAMP often arrives after its sender has left the room. So a packet of an unknown sender is taken, and
        the sender is taken to have left: what lasts, such as a velocity, ends at once.
        """
        if identity is None:
            nobody = Client(Source.LIVEKIT, UNKNOWN, self._dialects)
            self._edge.receive(data, nobody, streamed)
            self._edge.leave(nobody)
            return
        client = self._clients.get(identity)
        if client is None:
            client = self._clients[identity] = Client(Source.LIVEKIT, client_name(identity), self._dialects)
        self._edge.receive(data, client, streamed)

    def left(self, identity: str) -> None:
        """A participant has gone."""
        client = self._clients.pop(identity, None)
        if client is not None:
            self._edge.leave(client)

    def all_left(self) -> None:
        """The room has gone."""
        for identity in list(self._clients):
            self.left(identity)
