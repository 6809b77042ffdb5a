"""Each copy of a batch draws from its own stream."""

from __future__ import annotations

import numpy as np
import pytest

from asimov_gym.envs.streams import AHEAD, CopyStreams


def test_a_copy_gets_the_numbers_of_its_own_generator_in_order_whatever_the_others_draw() -> None:
    seeds, rng = [3, 4, 2**40], np.random.default_rng(0)
    streams = CopyStreams(seeds)
    got: list[list[np.ndarray]] = [[] for _ in seeds]
    for _ in range(400):
        width, copies = int(rng.integers(1, 60)), np.flatnonzero(rng.random(3) < 0.7)
        rows = streams.draw(width, copies)
        assert rows.shape == (len(copies), width) and rows.dtype == np.float32
        for copy, row in zip(copies, rows, strict=True):
            got[copy].append(row)
    for seed, rows in zip(seeds, got, strict=True):
        numbers = np.concatenate(rows)
        assert len(numbers) > 2 * AHEAD  # drawn anew more than twice
        np.testing.assert_array_equal(numbers, np.random.default_rng(seed).random(len(numbers), dtype=np.float32))


def test_all_copies_draw_unless_told_otherwise() -> None:
    np.testing.assert_array_equal(CopyStreams([1, 2]).draw(5), CopyStreams([1, 2]).draw(5, np.array([0, 1])))


def test_too_many_numbers_at_once_are_refused() -> None:
    with pytest.raises(ValueError, match=f"width must be at most {AHEAD}, got {AHEAD + 1}"):
        CopyStreams([0]).draw(AHEAD + 1)
