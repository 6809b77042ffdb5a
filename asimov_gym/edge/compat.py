"""The import path of the published samples, `edge.generated.edge_cloud_pb2`, on request.

    import asimov_gym.edge.compat

    asimov_gym.edge.compat.install()
    from edge.generated.edge_cloud_pb2 import CloudCommand, Mode, ModeCommand

The names lead to this project's own messages, which have the same bytes. Nothing is installed unless it is asked for:
the name `edge` belongs to others as well.
"""

from __future__ import annotations

import importlib.machinery
import importlib.util
import itertools
import sys
from types import ModuleType

from asimov_gym.edge.wire import cloud_pb2

PATH = ("edge", "edge.generated", "edge.generated.edge_cloud_pb2")
"""Modules that are made."""

_MARK = "__asimov_gym_compat__"


def install() -> None:
    """Make the path importable, in this process. Doing so again does nothing.

    Raises:
        ImportError: there is another package of that name; says where.
    """
    if installed():
        return
    for name in PATH:
        if name in sys.modules:
            raise _taken(sys.modules[name].__spec__)
    other = importlib.util.find_spec(PATH[0])
    if other is not None and other.origin is not None:  # a mere folder called `edge` has no origin
        raise _taken(other)
    modules = [_module(name) for name in PATH]
    for parent, child in itertools.pairwise(modules):
        setattr(parent, child.__name__.rpartition(".")[2], child)
    messages = modules[-1]
    messages.__dict__.update({name: item for name, item in vars(cloud_pb2).items() if not name.startswith("_")})
    sys.modules.update(zip(PATH, modules, strict=True))


def installed() -> bool:
    """Whether the path is there, and ours."""
    return all(getattr(sys.modules.get(name), _MARK, False) for name in PATH)


def uninstall() -> None:
    """Take the path away again; what was imported from it goes on working. No effect on another package."""
    for name in PATH:
        if getattr(sys.modules.get(name), _MARK, False):
            del sys.modules[name]


def _module(name: str) -> ModuleType:
    module = ModuleType(name, f"Stands for `{name}` of the published samples; see {__name__}.")
    is_package = name != PATH[-1]
    module.__spec__ = importlib.machinery.ModuleSpec(name, loader=None, is_package=is_package)
    if is_package:
        module.__path__ = []
    setattr(module, _MARK, True)
    return module


def _taken(spec: importlib.machinery.ModuleSpec | None) -> ImportError:
    place = "its place is unknown" if spec is None or spec.origin is None else f"it is {spec.origin}"
    return ImportError(
        f"there is another package {PATH[0]!r} ({place}): remove it, or import asimov_gym.edge.wire.cloud_pb2 in place "
        "of edge.generated.edge_cloud_pb2"
    )
