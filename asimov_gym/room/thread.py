"""A room server in a thread of its own, for programs without an event loop."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Coroutine
from types import TracebackType
from typing import Any

from asimov_gym.room.errors import RoomError
from asimov_gym.room.limits import RoomLimits
from asimov_gym.room.server import RoomServer
from asimov_gym.room.tokens import RoomKeys

_PATIENCE_S = 15.0


class RoomThread:
    """Runs a `RoomServer` in a daemon thread. A context manager; the arguments are those of `RoomServer`."""

    def __init__(
        self,
        host: str = "127.0.0.1",
        port: int = 0,
        room: str = "robot-sim",
        keys: RoomKeys | None = None,
        limits: RoomLimits | None = None,
    ) -> None:
        self.server = RoomServer(host, port, room, keys, limits)
        self._loop: asyncio.AbstractEventLoop | None = None
        self._thread: threading.Thread | None = None

    @property
    def url(self) -> str:
        """Where clients join."""
        return self.server.url

    @property
    def token_url(self) -> str:
        """Where clients ask for tokens."""
        return self.server.token_url

    @property
    def port(self) -> int:
        """TCP port."""
        return self.server.port

    def token(self, room: str | None, identity: str, **grants: bool) -> str:
        """A token for a room, the default one if None. `grants` are fields of `Grants`."""
        return self.server.token(room, identity, **grants)

    def start(self) -> None:
        """Start to listen; the port is open when this returns.

        Raises:
            RoomError: the port is in use, or the address is not this machine's.
        """
        if self._thread is not None:
            return
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._run, name="room", daemon=True)
        self._thread.start()
        try:
            self._call(self.server.start())
        except BaseException:
            self._end()
            raise

    def stop(self) -> None:
        """Send everyone away and close. Stopping twice does nothing."""
        if self._thread is None:
            return
        try:
            self._call(self.server.stop())
        finally:
            self._end()

    def restart(self) -> None:
        """Stop, and start again on the same port with the same keys."""
        self.stop()
        self.start()

    def _run(self) -> None:
        assert self._loop is not None
        asyncio.set_event_loop(self._loop)
        self._loop.run_forever()

    def _call(self, work: Coroutine[Any, Any, None]) -> None:
        assert self._loop is not None
        future = asyncio.run_coroutine_threadsafe(work, self._loop)
        try:
            future.result(_PATIENCE_S)
        except TimeoutError as error:
            raise RoomError(f"the room did not answer within {_PATIENCE_S:g} s") from error

    def _end(self) -> None:
        loop, thread = self._loop, self._thread
        self._loop = self._thread = None
        assert loop is not None and thread is not None
        asyncio.run_coroutine_threadsafe(_cancel_others(), loop).result(_PATIENCE_S)
        loop.call_soon_threadsafe(loop.stop)
        thread.join(_PATIENCE_S)
        loop.close()

    def __enter__(self) -> RoomThread:
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()


async def _cancel_others() -> None:
    """Cancel what the connections left behind, and let it end."""
    others = [task for task in asyncio.all_tasks() if task is not asyncio.current_task()]
    for task in others:
        task.cancel()
    await asyncio.gather(*others, return_exceptions=True)
