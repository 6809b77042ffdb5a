"""Order of commands that come by two lanes: a reliable one, and a lossy stream beside it."""

from __future__ import annotations

from asimov_gym.edge.control import Client, Dialect

_WRAP = 2**32


class CommandOrder:
    """The last command taken of each client and of each dialect, by the sender's counter."""

    def __init__(self) -> None:
        self._clients: dict[Client, int] = {}
        self._dialects: dict[Dialect, int] = {}

    def is_stale(self, client: Client, sequence: int) -> bool:
        """Whether a client's command is the last one taken, or older. The counter wraps at 2^32."""
        last = self._clients.get(client)
        return last is not None and (sequence - last - 1) % _WRAP >= _WRAP // 2

    def take(self, client: Client, dialect: Dialect, sequence: int) -> None:
        """A command was taken."""
        self._clients[client] = sequence
        self._dialects[dialect] = sequence

    def last_taken(self, dialect: Dialect) -> int:
        """Sequence of the last command taken in a dialect; 0 before the first."""
        return self._dialects.get(dialect, 0)

    def forget(self, client: Client) -> None:
        """A client has gone; its next command starts anew."""
        self._clients.pop(client, None)
