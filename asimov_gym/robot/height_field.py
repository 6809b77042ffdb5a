"""Rough ground: a grid of random heights."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from asimov_gym.presets import check_range
from asimov_gym.robot.array_library import integer, namespace


@dataclass(frozen=True)
class HeightField:
    """Random ground: a square grid of independent heights with flat triangles between them, level with the floor at its
    rim.

    Raises:
        ValueError: a figure is out of range.
    """

    amplitude: float
    """Highest point above the floor, m; heights lie between 0 and this."""
    seed: int = 0
    cells: int = 160
    """Along each side."""
    cell: float = 0.15
    """Side of a cell, m."""

    def __post_init__(self) -> None:
        check_range("height field: amplitude", self.amplitude, 0.001, 0.2)
        check_range("height field: seed", self.seed, 0, 2**31 - 1)
        check_range("height field: cells", self.cells, 4, 1000)
        check_range("height field: cell", self.cell, 0.02, 2.0)

    @property
    def half_side(self) -> float:
        """m."""
        return 0.5 * self.cells * self.cell

    @cached_property
    def heights(self) -> np.ndarray:
        """At the corners of the cells, rows along y, columns along x, both ascending, m, (cells + 1, cells + 1)."""
        inner = np.random.default_rng(self.seed).random((self.cells - 1, self.cells - 1), dtype=np.float32)
        heights = np.pad(inner * np.float32(self.amplitude / inner.max()), 1)
        heights.flags.writeable = False
        return heights

    def height(self, x: Any, y: Any) -> Any:
        """At points of any one shape, m; 0 outside. A cell's two triangles meet on the diagonal from its lowest x and y
        to its highest, as MuJoCo splits it."""
        xp = namespace(x, y)
        column, row = (x + self.half_side) / self.cell, (y + self.half_side) / self.cell
        inside = (column >= 0.0) & (column <= self.cells) & (row >= 0.0) & (row <= self.cells)
        first_column, first_row = (xp.clip(xp.floor(place), 0.0, self.cells - 1.0) for place in (column, row))
        u, v = column - first_column, row - first_row
        corner = xp.astype(first_row * (self.cells + 1) + first_column, integer(xp))
        near, far = self._at(corner, x), self._at(corner + self.cells + 2, x)
        # The third corner of the point's triangle: beside `near` along x where u > v, along y elsewhere.
        right = u > v
        third = self._at(corner + xp.where(right, 1, self.cells + 1), x)
        larger, smaller = xp.where(right, u, v), xp.where(right, v, u)
        height = near + larger * (third - near) + smaller * (far - third)
        return xp.where(inside, height, xp.zeros_like(height))

    def _at(self, corner: Any, like: Any) -> Any:
        xp = namespace(corner)
        flat = xp.asarray(self.heights.reshape(-1), dtype=like.dtype)
        return xp.reshape(xp.take(flat, xp.reshape(corner, (-1,))), corner.shape)
