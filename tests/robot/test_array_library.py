"""Which array library a function of the robot works in."""

from __future__ import annotations

import numpy as np
import pytest

from asimov_gym.robot.array_library import namespace


def test_plain_arrays_are_numpys_own() -> None:
    assert namespace(np.zeros(3), np.zeros(2, dtype=np.float32)) is np


def test_other_libraries_and_mixtures() -> None:
    torch = pytest.importorskip("torch", reason="torch comes with the training extra")
    assert namespace(torch.zeros(3)).concat([torch.zeros(1), torch.ones(1)]).tolist() == [0.0, 1.0]
    with pytest.raises(TypeError):
        namespace(np.zeros(3), torch.zeros(3))
    with pytest.raises(TypeError):
        namespace([1.0, 2.0])
