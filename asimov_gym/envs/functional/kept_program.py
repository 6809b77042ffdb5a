"""Environments that start at once the second time: what JAX has traced is kept on disk beside what it has compiled.

Of a second start with the compile cache, tracing takes most: it is Python, and a robot's step has twenty thousand
operations. So the traced program is kept too (`jax.export`). Its name is a digest of everything that tracing can
depend on: the environment with all it holds, the source of this package, the versions of what it calls, the settings of
JAX, the shapes of the arguments. Where any of that cannot be told for certain, nothing is kept and JAX traces as ever.
"""

from __future__ import annotations

import hashlib
import io
import logging
import os
import pickle
import sys
from collections.abc import Callable
from functools import cache, cached_property
from pathlib import Path
from types import CellType, FunctionType, MappingProxyType
from typing import Any

import gymnasium as gym
import jax
import numpy as np
from jax import export

import asimov_gym
from asimov_gym.physics.functional.runtime import keep_what_is_compiled
from asimov_gym.versions import installed_versions

_log = logging.getLogger(__name__)

KEPT = 64
"""Programs that are kept; beyond these the ones not used for longest are removed."""
_PACKAGES = ("gymnasium", "jax", "jaxlib", "mujoco", "mujoco-mjx", "numpy", "onnx")
"""Distributions whose code an environment may hold or call."""
_MODULES = {"asimov_gym", "gymnasium", "jax", "jaxlib", "mujoco", "numpy", "onnx", *sys.stdlib_module_names}
"""Modules whose code an identity covers, by their version or their source."""


class KeptProgram:
    """A pure function of an environment; compiled at the first call, for arguments of those shapes.

    Args:
        function: made by `jax.jit`, such as `env.compiled_step`.
        name: tells apart the functions of an environment.
        identity: digest of the environment, see `identity`; nothing is read or written when None.
    """

    def __init__(self, function: jax.stages.Wrapped, name: str, identity: str | None) -> None:
        self._function, self._name, self._identity = function, name, identity
        self._program: Callable[..., Any] | None = None

    def __call__(self, *arguments: Any) -> Any:
        """The function's result."""
        if self._program is None:
            self._program = self._prepared(arguments)
        return self._program(*arguments)

    def _prepared(self, arguments: tuple[Any, ...]) -> Callable[..., Any]:
        """The function as read from disk; where it is not there yet, traced and written."""
        folder = _folder()
        if self._identity is None or folder is None:
            return self._function
        path = folder / f"{self._name}-{_digest(self._identity, _signature(arguments))}.jax"
        try:
            exported = export.deserialize(bytearray(path.read_bytes()))
            os.utime(path)
            _prepare_linear_algebra()
        except FileNotFoundError:
            exported = self._traced(arguments, path)
        except Exception as error:  # a damaged file may fail in any way, and tracing is always right
            _log.warning("%s cannot be read and is made anew: %s", path, error)
            exported = self._traced(arguments, path)
        return self._function if exported is None else jax.jit(exported.call)

    def _traced(self, arguments: tuple[Any, ...], path: Path) -> export.Exported | None:
        try:
            exported = export.export(self._function)(*arguments)
            data = exported.serialize()
        except (NotImplementedError, ValueError) as error:
            _log.debug("%s is not kept: %s", self._name, error)
            return None
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            # Another process may be at the same; each replaces the file by a whole one.
            part = path.with_suffix(f".{os.getpid()}.part")
            part.write_bytes(data)
            part.replace(path)
            _remove_oldest(path.parent)
        except OSError as error:
            _log.warning("%s cannot be written, the next start takes as long as this one: %s", path, error)
        return exported


def identity(env: Any) -> str | None:
    """Digest of all that tracing an environment's functions can depend on, except their arguments.

    Returns:
        None where that cannot be told, or the program cannot be kept: the environment runs on another engine than MJX's
        jax backend, holds code from outside this package, or something that cannot be written to a file.
    """
    if env.engine.name != "mjx" or _folder() is None:
        return None
    settings = {k: v for k, v in jax.config.values.items() if "cache" not in k and "log" not in k and "dump" not in k}
    parts = (env, sorted((name, repr(value)) for name, value in settings.items()))
    stream = io.BytesIO()
    pickler = _Content(stream)
    # Without a memo: whether two equal strings are one object must not matter.
    pickler.fast = True
    try:
        pickler.dump(parts)
    except (pickle.PicklingError, TypeError, AttributeError, RecursionError, ValueError) as error:
        _log.debug("programs of %s are not kept: %s", type(env).__name__, error)
        return None
    device = jax.devices()[0]
    return _digest(_code(), device.platform, device.device_kind, stream.getvalue())


class _Content(pickle.Pickler):
    """Writes what objects hold, to be compared and never to be read."""

    def reducer_override(self, obj: Any) -> Any:
        if isinstance(obj, type | FunctionType):
            module = obj.__module__ or ""
            if module.partition(".")[0] not in _MODULES:
                raise pickle.PicklingError(f"{module}.{obj.__qualname__} is code from outside")
            if isinstance(obj, FunctionType):
                held = (obj.__closure__, obj.__defaults__, obj.__kwdefaults__)
                return tuple, ((module, obj.__qualname__, *held),)
        if isinstance(obj, CellType):
            return tuple, ((obj.cell_contents,),)
        if isinstance(obj, MappingProxyType):
            return dict, (dict(obj),)
        if isinstance(obj, gym.Space):  # which draws its samples from a generator of its own
            return tuple, ((type(obj), {name: value for name, value in vars(obj).items() if name != "_np_random"}),)
        if type(obj).__module__.startswith("asimov_gym.") and type(obj).__dictoffset__:
            return tuple, ((type(obj), _own(obj)),)
        if isinstance(obj, jax.Array):
            return tuple, ((np.asarray(obj), obj.aval.weak_type),)
        return NotImplemented


def _own(obj: Any) -> dict[str, Any]:
    """Attributes of an object without those that follow from the others, and are there or not yet."""
    derived = {n for cls in type(obj).__mro__ for n, value in vars(cls).items() if isinstance(value, cached_property)}
    return {name: value for name, value in vars(obj).items() if name not in derived}


@cache
def _code() -> str:
    """Digest of this package's source and data, and of the versions of what it calls."""
    root = Path(asimov_gym.__file__).parent
    files = sorted(path for suffix in ("py", "yaml", "json", "xml") for path in root.rglob(f"*.{suffix}"))
    sources = [part for path in files for part in (path.relative_to(root).as_posix(), path.read_bytes())]
    versions = [f"{name} {version}" for name, version in installed_versions(_PACKAGES).items()]
    return _digest(sys.version, *versions, *sources)


def _signature(arguments: tuple[Any, ...]) -> str:
    leaves, tree = jax.tree.flatten(arguments)
    return f"{tree} {[(np.shape(leaf), str(jax.numpy.result_type(leaf))) for leaf in leaves]}"


def _digest(*parts: str | bytes) -> str:
    whole = hashlib.sha256()
    for part in parts:
        data = part.encode() if isinstance(part, str) else part
        whole.update(len(data).to_bytes(8, "little"))
        whole.update(data)
    return whole.hexdigest()[:40]


def _folder() -> Path | None:
    """Where programs are kept; None where nothing is."""
    folder = keep_what_is_compiled()
    return None if folder is None else folder / "programs"


@cache
def _prepare_linear_algebra() -> None:
    """Let JAX find LAPACK, as it does on the CPU when it traces linear algebra. Older versions do not when they read a
    program, and crash in it."""
    jax.jit(jax.numpy.linalg.cholesky).lower(jax.ShapeDtypeStruct((2, 2), jax.numpy.float32))


def _remove_oldest(folder: Path) -> None:
    programs = sorted(folder.glob("*.jax"), key=lambda path: path.stat().st_mtime)
    for path in programs[:-KEPT]:
        path.unlink(missing_ok=True)
