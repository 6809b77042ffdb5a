"""Which OpenGL backend can draw here, found by trying each in a process of its own.

A backend has to be chosen by the environment variable `MUJOCO_GL` before MuJoCo is imported, and a broken one can end
the process; so each is tried elsewhere, and programs that draw are started with `environment()`.
"""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import dataclass

HEADLESS_BACKENDS: tuple[str, ...] = ("cgl",) if sys.platform == "darwin" else ("egl", "osmesa")
"""Backends that need no display, preferred first."""

INSTALL_LINES = {
    "egl": "apt-get install libegl1 libegl-mesa0 libgl1",
    "osmesa": "apt-get install libosmesa6",
    "glfw": "a window needs a display (run it on a desktop, or with X forwarding)",
}
"""How to get a backend that does not work."""

_DRAW = """
import mujoco
model = mujoco.MjModel.from_xml_string(
    "<mujoco><worldbody><light pos='0 0 3'/><geom type='sphere' size='0.2'/></worldbody></mujoco>"
)
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
with mujoco.Renderer(model, 48, 64) as renderer:
    renderer.update_scene(data)
    assert renderer.render().max() > 0, "the picture is black"
"""


@dataclass(frozen=True)
class Probe:
    """Outcome of trying a backend."""

    backend: str
    works: bool
    detail: str
    """The last line of the error; empty if it works."""


def probe(backend: str, timeout: float = 60.0) -> Probe:
    """Draw a sphere with `backend` (`egl`, `osmesa`, `glfw`, `cgl`) in a process of its own.

    Args:
        backend: value for `MUJOCO_GL`.
        timeout: seconds after which the backend counts as broken.
    """
    if backend == "glfw" and sys.platform.startswith("linux") and not has_display():
        return Probe(backend, False, "DISPLAY and WAYLAND_DISPLAY are unset")
    command = [sys.executable, "-c", _DRAW]
    try:
        done = subprocess.run(
            command, env=environment(backend), capture_output=True, text=True, timeout=timeout, check=False
        )
    except subprocess.TimeoutExpired:
        return Probe(backend, False, f"no picture within {timeout:.0f} s")
    if done.returncode == 0:
        return Probe(backend, True, "")
    lines = [line.strip() for line in done.stderr.splitlines() if line.strip()]
    return Probe(backend, False, lines[-1] if lines else f"exit code {done.returncode}")


def has_display() -> bool:
    """Whether a display is named in the environment (X11 or Wayland)."""
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def headless_backend() -> str | None:
    """The first backend that draws without a display; None where none does.

    A headless backend that the user chose by `MUJOCO_GL` is tried first.
    """
    chosen = os.environ.get("MUJOCO_GL", "")
    backends = sorted(HEADLESS_BACKENDS, key=lambda name: name != chosen)
    return next((backend for backend in backends if probe(backend).works), None)


def environment(backend: str) -> dict[str, str]:
    """Environment of a process that draws with `backend`."""
    # PyOpenGL reads its own variable, and an inherited one for another platform would win over MuJoCo's choice.
    inherited = {name: value for name, value in os.environ.items() if name != "PYOPENGL_PLATFORM"}
    return inherited | {"MUJOCO_GL": backend}


def install_line() -> str:
    """What to install where `headless_backend` found nothing."""
    cure = INSTALL_LINES.get(HEADLESS_BACKENDS[0], "OpenGL is not available in this session")
    return f"no headless renderer: {cure}"
