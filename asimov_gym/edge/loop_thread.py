"""A thread with an event loop of its own, for the asyncio library inside programs that have none."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Coroutine
from contextlib import suppress
from typing import Any


class LoopThread:
    """Runs one coroutine to its end, in a thread.

    Args:
        name: of the thread.
        main: makes the coroutine. It must catch what may go wrong: an exception that leaves it is printed, no more.
            It may be cancelled.
    """

    def __init__(self, name: str, main: Callable[[], Coroutine[Any, Any, None]]) -> None:
        self._main = main
        self._loop: asyncio.AbstractEventLoop | None = None
        self._began = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def start(self) -> None:
        """Start; the loop takes calls when this returns."""
        self._thread.start()
        self._began.wait()

    def call(self, function: Callable[..., object], *arguments: object) -> bool:
        """Have the loop call a function soon, from any thread. False if the loop has ended."""
        loop = self._loop
        if loop is None:
            return False
        try:
            loop.call_soon_threadsafe(function, *arguments)
        except RuntimeError:  # closed meanwhile
            return False
        return True

    def cancel(self) -> None:
        """Cancel the coroutine and what it has started, from any thread."""
        self.call(_cancel_all)

    def join(self, timeout: float | None = None) -> bool:
        """Wait for the end; whether it has come. In the thread itself it does not wait, and is true."""
        if self._thread is threading.current_thread():
            return True
        self._thread.join(timeout)
        return not self._thread.is_alive()

    def _run(self) -> None:
        try:
            with suppress(asyncio.CancelledError):
                asyncio.run(self._begin())
        finally:
            self._loop = None
            self._began.set()

    async def _begin(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._began.set()
        await self._main()


def _cancel_all() -> None:
    for task in asyncio.all_tasks():
        task.cancel()
