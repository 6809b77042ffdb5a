"""One look for all plots: colours that the colour-blind can tell apart, sizes, and how a figure is saved."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

BLUE, ORANGE, GREEN, PINK, SKY, RED = "#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00"
"""From the palette of M. Okabe and K. Ito (2008)."""
LEFT, RIGHT = BLUE, ORANGE
"""Sides of the robot."""
GREY, PALE = "#555555", "#e6e6e6"
SEQUENTIAL = "viridis_r"
"""Colour map of errors: dark is large."""
DPI = 110


@dataclass(frozen=True)
class Plot:
    """A picture of a report, or why there is none."""

    name: str
    """Of the file, without ending."""
    title: str
    caption: str
    """What is seen, in a sentence or two."""
    path: Path | None
    """PNG file; None where what it shows was not measured."""
    missing: str = ""
    """Why there is none."""


def new_figure(width: float, height: float) -> Figure:
    """An empty white figure, in inches."""
    return Figure(figsize=(width, height), layout="constrained", facecolor="white")


def save(figure: Figure, path: Path) -> Path:
    """Write a figure as PNG, without asking for a display."""
    FigureCanvasAgg(figure)
    figure.savefig(path, dpi=DPI)
    return path


def finish(axis: Axes, x: str = "", y: str = "", title: str = "") -> None:
    """Labels with units, a faint grid and no frame at the top and right."""
    axis.set_xlabel(x, fontsize=9)
    axis.set_ylabel(y, fontsize=9)
    if title:
        axis.set_title(title, fontsize=10)
    axis.tick_params(labelsize=8)
    axis.grid(color=PALE, lw=0.7)
    axis.set_axisbelow(True)
    for side in ("top", "right"):
        axis.spines[side].set_visible(False)
