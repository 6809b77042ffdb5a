"""Where the files that are not code are: the robot's model, shipped policies and reference motions, and presets.

They lie in `assets/` and `configs/` beside the package in a source checkout, and in `asimov_gym/data/` once installed
from a wheel. Everything else asks here and never builds such a path itself.
"""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parent


def asset_path(*parts: str) -> Path:
    """Path of a shipped asset, such as `asset_path("asimov1.xml")` or `asset_path("policies", "asimov_walk.onnx")`.

    Args:
        parts: path components below `assets/`; none for the folder itself.

    Raises:
        FileNotFoundError: nothing is there; names what was asked for, where, and what that folder holds.
    """
    return _find("assets", parts)


def config_path(*parts: str) -> Path:
    """Path of a shipped preset, such as `config_path("train", "laptop.yaml")`.

    Args:
        parts: path components below `configs/`; none for the folder itself.

    Raises:
        FileNotFoundError: nothing is there; names what was asked for, where, and what that folder holds.
    """
    return _find("configs", parts)


def _find(kind: str, parts: tuple[str, ...]) -> Path:
    root = _root(kind)
    path = root.joinpath(*parts)
    if path.exists():
        return path
    parent = path.parent
    while not parent.is_dir():
        parent = parent.parent
    entries = ", ".join(sorted(entry.name for entry in parent.iterdir())) or "nothing"
    raise FileNotFoundError(f"No {Path(*parts).as_posix()!r} among the {kind} of asimov-gym: {parent} holds {entries}.")


def _root(kind: str) -> Path:
    installed = _PACKAGE / "data" / kind
    if installed.is_dir():
        return installed
    checkout = _PACKAGE.parent / kind
    if checkout.is_dir() and (_PACKAGE.parent / "pyproject.toml").is_file():
        return checkout
    raise FileNotFoundError(
        f"The {kind} of asimov-gym are missing: neither {installed} (installed) nor {checkout} (source checkout) is "
        "there. Reinstall with `pip install --force-reinstall asimov-gym`."
    )
