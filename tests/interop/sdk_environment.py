"""The robot's public Python client in an environment of its own: it needs a newer Python than this project does.

An interpreter is looked for on the path and under pyenv. The environment is made once and kept: in the folder that
`ASIMOV_GYM_SDK_ENV` names, else in the temporary folder.
"""

from __future__ import annotations

import functools
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

REQUIREMENT = "menlo-sdk==0.1.0"
FOLDER_VARIABLE = "ASIMOV_GYM_SDK_ENV"
MINIMUM = (3, 12)
_NEWEST_MINOR = 16
_INSTALL_TIMEOUT_S = 400


def folder() -> Path:
    """Where the environment is, or will be."""
    named = os.environ.get(FOLDER_VARIABLE)
    return Path(named) if named else Path(tempfile.gettempdir()) / f"asimov-gym-menlo-sdk-0.1.0-{os.getuid()}"


def python() -> Path:
    """The environment's interpreter."""
    return folder() / "bin" / "python"


@functools.cache
def missing() -> str | None:
    """Why the environment cannot be used as it is; None when it can."""
    if not python().exists():
        return f"no environment with {REQUIREMENT} in {folder()}"
    check = "import importlib.metadata as m; print(m.version('menlo-sdk'))"
    found = subprocess.run([python(), "-c", check], capture_output=True, text=True, timeout=60)
    if found.stdout.strip() != REQUIREMENT.split("==")[1]:
        return f"the environment in {folder()} does not hold {REQUIREMENT}"
    return None


def make() -> str | None:
    """Make the environment if it is missing; returns why that was not possible, None when it is there."""
    if missing() is None:
        return None
    interpreter = find_interpreter()
    if interpreter is None:
        return f"{REQUIREMENT} needs Python {MINIMUM[0]}.{MINIMUM[1]} or newer: none on the path nor under pyenv"
    place = folder()
    place.mkdir(mode=0o700, parents=True, exist_ok=True)
    if place.stat().st_uid != os.getuid():
        return f"{place} belongs to somebody else: name another folder in {FOLDER_VARIABLE}"
    for step in (
        [interpreter, "-m", "venv", "--clear", place],
        [python(), "-m", "pip", "install", "--quiet", REQUIREMENT],
    ):
        try:
            done = subprocess.run(step, capture_output=True, text=True, timeout=_INSTALL_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            return f"installing {REQUIREMENT} took longer than {_INSTALL_TIMEOUT_S} s"
        if done.returncode != 0:
            last = (done.stderr.strip() or "no message").splitlines()[-1]
            return f"{REQUIREMENT} could not be installed: {last}"
    missing.cache_clear()
    return missing()


def find_interpreter() -> Path | None:
    """A Python new enough for the client, with the module that makes environments; the newest found."""
    newest: tuple[tuple[int, ...], Path] | None = None
    for candidate in _candidates():
        version = _version(candidate)
        if version is not None and version >= MINIMUM and (newest is None or version > newest[0]):
            newest = version, candidate
    return None if newest is None else newest[1]


def _candidates() -> Iterator[Path]:
    yield Path(sys.executable)
    for name in ("python3", *(f"python3.{minor}" for minor in range(MINIMUM[1], _NEWEST_MINOR + 1))):
        found = shutil.which(name)
        if found is not None:
            yield Path(found)
    root = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv"))
    yield from sorted(root.glob("versions/*/bin/python3"))


def _version(candidate: Path) -> tuple[int, ...] | None:
    """Version of an interpreter that runs and can make environments; a pyenv shim of an inactive version does not."""
    check = "import json, sys, venv, ensurepip; print(json.dumps(sys.version_info[:3]))"
    try:
        found = subprocess.run([candidate, "-c", check], capture_output=True, text=True, timeout=30)
        return tuple(json.loads(found.stdout)) if found.returncode == 0 else None
    except (OSError, ValueError, subprocess.TimeoutExpired):
        return None
