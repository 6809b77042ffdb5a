"""Batches that do not fit into memory, told apart from other failures."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

_SIGNS = ("RESOURCE_EXHAUSTED", "out of memory", "OutOfMemory", "bad_alloc")
"""In what JAX, CUDA, torch and MuJoCo say of it."""


def is_out_of_memory(error: BaseException) -> bool:
    """Whether an error says that memory ran out, of the machine or of its accelerator."""
    return isinstance(error, MemoryError) or any(sign.lower() in str(error).lower() for sign in _SIGNS)


@contextmanager
def batch_of(copies: int) -> Iterator[None]:
    """Work on a batch of so many robots.

    Raises:
        MemoryError: the memory does not suffice for it; says what can be done.
    """
    try:
        yield
    except (MemoryError, RuntimeError) as error:
        if not is_out_of_memory(error):
            raise
        first = (str(error).splitlines() or [""])[0]
        raise MemoryError(f"{copies} robots do not fit into memory, use fewer ({first})") from error
