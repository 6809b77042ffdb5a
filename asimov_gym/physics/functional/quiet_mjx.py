"""`mujoco.mjx`, imported without the lines that it prints where warp is missing, as it is on most machines.

Whoever asks for warp gets an error of ours that says what to install.
"""

from __future__ import annotations

import io
from contextlib import redirect_stdout

_MISSING = ("Failed to import warp:", "Failed to import mujoco_warp:")

with redirect_stdout(io.StringIO()) as _printed:
    from mujoco import mjx as _mjx

mjx = _mjx

for _line in _printed.getvalue().splitlines():
    if not _line.startswith(_MISSING):
        print(_line)

__all__ = ["mjx"]
