"""`asimov room`: a small development room on loopback, for people without a LiveKit server."""

from __future__ import annotations

import asyncio
import logging
import signal
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from asimov_gym.room import RoomServer


@dataclass(frozen=True)
class Room:
    """Open a development room on this machine that the public LiveKit client library joins.

    Exit code 0 when it is ended with Ctrl-C, 2 if it cannot be opened.
    """

    port: int = 7880
    """TCP port of signalling and tokens; 0 takes a free one."""
    listen: str = "127.0.0.1"
    """Address to listen on. Only loopback addresses are allowed: this room is never offered to a network."""
    room: str = "robot-sim"
    """Room that tokens are for unless they ask for another."""
    keys: Path | None = None
    """File with the room's secrets, made if it does not exist and readable by its owner alone. With it a room that is
    opened again accepts the tokens of before, and no secret is shown on the terminal."""

    def run(self) -> int:
        """Open the room and serve until interrupted."""
        try:
            from asimov_gym.room import RoomError, RoomKeys, RoomServer

            keys = None if self.keys is None else RoomKeys.from_file(self.keys)
            server = RoomServer(self.listen, self.port, self.room, keys)
        except (ImportError, ValueError, RuntimeError) as error:
            print(f"asimov room: {error}", file=sys.stderr)
            return 2
        handler = logging.StreamHandler(sys.stdout)
        handler.setFormatter(logging.Formatter("%(asctime)s  %(message)s", "%H:%M:%S"))
        log = logging.getLogger("asimov_gym.room")
        log.setLevel(logging.INFO)
        log.addHandler(handler)
        try:
            return asyncio.run(self._serve(server))
        except RoomError as error:
            print(f"asimov room: {error}", file=sys.stderr)
            return 2
        finally:
            log.removeHandler(handler)

    async def _serve(self, server: RoomServer) -> int:
        await server.start()
        done = asyncio.Event()
        for number in (signal.SIGINT, signal.SIGTERM):
            asyncio.get_running_loop().add_signal_handler(number, done.set)
        for line in self._lines(server, sys.stdout.isatty()):
            print(line, flush=True)
        await done.wait()
        await server.stop()
        print("The room is closed.", flush=True)
        return 0

    def _lines(self, server: RoomServer, terminal: bool) -> list[str]:
        """What is said at the start. Secrets are shown on a terminal only, and not if they are in a file."""
        lines = [*server.statement.splitlines(), ""]
        lines += [f"  join   {server.url}  room {server.room}", f"  token  POST {server.token_url}"]
        if self.keys is not None:
            lines.append(f"         Authorization: Bearer, with the credential in {self.keys}")
        elif not terminal:
            lines.append("         The credential is shown on a terminal only: name a file with --keys.")
        else:
            robot = server.token(None, "robot", can_update_own_metadata=True)
            lines += [
                f"         Authorization: Bearer {server.keys.credential}",
                f"  robot  asimov robot --livekit {server.url} --token {robot}",
            ]
        return [*lines, "", "Ctrl-C closes the room."]
