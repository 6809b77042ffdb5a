"""A table as data, and as Markdown; the report's page draws the same tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

MISSING = "–"
"""Shown where a figure has no meaning or was not measured."""


@dataclass(frozen=True)
class Table:
    """Text in rows and columns."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""
    """A line below the title."""

    def __post_init__(self) -> None:
        for number, row in enumerate(self.rows):
            if len(row) != len(self.columns):
                raise ValueError(f"rows[{number}] must have {len(self.columns)} cells, got {len(row)}: {row}")

    def markdown(self, level: int = 3) -> str:
        """Title, note and rows; `level` is that of the heading."""
        lines = [f"{'#' * level} {self.title}", ""]
        if self.note:
            lines += [self.note, ""]
        return "\n".join([*lines, self.markdown_rows()])

    def _repr_markdown_(self) -> str:
        """How a notebook shows it."""
        return self.markdown(level=4)

    def markdown_rows(self) -> str:
        """The rows alone."""
        rows = [self.columns, ("---",) * len(self.columns), *self.rows]
        return "\n".join("| " + " | ".join(map(_cell, row)) + " |" for row in rows)


def number(value: float | None, digits: int = 3, unit: str = "") -> str:
    """A figure with so many decimals, and its unit; a dash where there is none."""
    if value is None:
        return MISSING
    text = f"{value:.{digits}f}"
    if float(text) == 0.0:
        text = text.removeprefix("-")
    return f"{text} {unit}".rstrip()


def figure(value: float | None, digits: int = 3) -> str:
    """A figure of any size with so many significant digits; a dash where there is none."""
    if value is None:
        return MISSING
    return np.format_float_positional(value + 0.0, digits, unique=False, fractional=False, trim="-")


def percent(value: float | None, digits: int = 1) -> str:
    """A share in per cent; 100 only where it is the whole."""
    if value is None:
        return MISSING
    shown = f"{100.0 * value:.{digits}f}"
    whole = f"{100.0:.{digits}f}"
    if value < 1.0 and shown == whole:
        shown = f"> {100.0 - 10.0**-digits:.{digits}f}"
    return ("100" if value == 1.0 else shown) + " %"


def counted(count: int, noun: str) -> str:
    """So many of something: `1 trial`, `2 trials`."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def between(low: float | None, high: float | None, digits: int = 3) -> str:
    """An interval, such as `0.021 … 0.034`."""
    if low is None or high is None:
        return MISSING
    return f"{number(low, digits)} … {number(high, digits)}"


def vector(values: Sequence[float], digits: int = 2) -> str:
    """Numbers with signs, such as `+0.50, -0.20, +0.00`."""
    return ", ".join(f"{round(value, digits) + 0.0:+.{digits}f}" for value in values)


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ")
