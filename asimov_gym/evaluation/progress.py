"""How far a run of a suite is, in lines: for logs, notebooks and whatever else has no terminal."""

from __future__ import annotations

from collections.abc import Callable


class PrintedProgress:
    """Says each time that another part of a stage is done; the `progress` of a `SuiteRun`.

    Args:
        parts: lines for each stage.
        say: takes them.

    Raises:
        ValueError: `parts` is not within 1 and 100.
    """

    def __init__(self, parts: int = 10, say: Callable[[str], object] = print) -> None:
        if not 1 <= parts <= 100:
            raise ValueError(f"parts must lie in [1, 100], got {parts!r}")
        self._parts, self._say = parts, say
        self._done: dict[str, int] = {}

    def __call__(self, stage: str, done: float, whole: float) -> None:
        """Robot-seconds of a stage that are simulated, and those in all."""
        part = int(self._parts * done / whole) if whole else self._parts
        if part > self._done.get(stage, 0):
            self._done[stage] = part
            self._say(f"{stage}: {100 * part / self._parts:.0f} %")
