"""Pictures in memory that two processes share.

The memory has no name: it is a file that exists as long as one of the two holds it open, so nothing can be left behind,
however a process ends.
"""

from __future__ import annotations

import mmap
import os
import sys
import tempfile

import numpy as np

SLOTS = 3
"""Pictures per camera: one being drawn, one on its way, one being looked at."""

_FREE, _TAKEN = 0, 1


def anonymous_file() -> int:
    """A file without a name, as a descriptor that the caller closes."""
    if sys.platform == "linux":
        return os.memfd_create("asimov-frames")
    with tempfile.TemporaryFile() as file:
        return os.dup(file.fileno())


class FrameRing:
    """A few slots for pictures of each camera. One process takes slots and draws, the other looks and gives them back.

    Args:
        file: descriptor of the shared file; it is made as long as needed. It may be closed afterwards.
        cameras: number of cameras.
        width: of the pictures, pixels.
        height: of the pictures, pixels.
    """

    def __init__(self, file: int, cameras: int, width: int, height: int) -> None:
        picture = height * width * 3
        start = mmap.PAGESIZE  # the page before holds one byte a slot: whose it is
        size = start + cameras * SLOTS * picture
        if os.fstat(file).st_size < size:
            os.ftruncate(file, size)
        # Views of the memory keep it mapped; it goes with the last of them.
        memory = np.frombuffer(mmap.mmap(file, size), dtype=np.uint8)
        self._owner = memory[: cameras * SLOTS].reshape(cameras, SLOTS)
        self._pictures = memory[start:].reshape(cameras, SLOTS, height, width, 3)

    def take(self, camera: int) -> int | None:
        """Reserve a free slot of a camera; None where the other process holds all of them."""
        free = np.flatnonzero(self._owner[camera] == _FREE)
        if not len(free):
            return None
        self._owner[camera, free[0]] = _TAKEN
        return int(free[0])

    def release(self, camera: int, slot: int) -> None:
        """Give a slot back."""
        self._owner[camera, slot] = _FREE

    def picture(self, camera: int, slot: int) -> np.ndarray:
        """The picture in a slot, (height, width, 3) uint8, in place."""
        return self._pictures[camera, slot]
