"""A batch that does not fit is said to be that, and nothing else is."""

from __future__ import annotations

import numpy as np
import pytest

from asimov_gym.physics.memory import batch_of, is_out_of_memory


@pytest.mark.parametrize(
    "error",
    [
        MemoryError(),
        RuntimeError("RESOURCE_EXHAUSTED: Out of memory allocating 68719476736 bytes.\nmore"),
        RuntimeError("CUDA out of memory. Tried to allocate 64.00 GiB"),
        RuntimeError("std::bad_alloc"),
    ],
)
def test_lack_of_memory_names_the_batch(error: Exception) -> None:
    assert is_out_of_memory(error)
    with pytest.raises(MemoryError, match="4096 robots do not fit into memory, use fewer") as caught, batch_of(4096):
        raise error
    assert "\n" not in str(caught.value) and caught.value.__cause__ is error


def test_what_numpy_cannot_allocate() -> None:
    with pytest.raises(MemoryError, match="9 robots do not fit"), batch_of(9):
        np.ones(2**55)


def test_other_errors_pass() -> None:
    with pytest.raises(RuntimeError, match=r"^something else$"), batch_of(1):
        raise RuntimeError("something else")
    with pytest.raises(ValueError, match="out of memory"), batch_of(1):
        raise ValueError("out of memory is no longer a word")
