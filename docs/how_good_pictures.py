"""The pictures of the page "How good is it", drawn from the card of the shipped policy."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from asimov_gym.evaluation.card import CardFigures
from asimov_gym.evaluation.plot_style import DPI
from asimov_gym.evaluation.plots import draw_error_grid, draw_torques
from asimov_gym.evaluation.push_plot import draw_pushes
from asimov_gym.evaluation.results import plain
from asimov_gym.evaluation.trace_plots import draw_gaits

FOLDER = "how_good"
"""Of the pictures, beside the page."""
NAMES = ("error_grid", "pushes", "gait", "torque")
"""Those of `asimov_gym.evaluation.plots.KINDS` that are on the page."""
_FINGERPRINT = "asimov-data"
"""Text chunk of a picture with the hash of what it shows."""


@dataclass(frozen=True)
class Picture:
    """A picture of the page."""

    name: str
    """Of the file, without ending."""
    data: Any
    """All that it shows, as plain data."""
    draw: Callable[[], Figure | None]
    """None where there is nothing to show."""

    @property
    def fingerprint(self) -> str:
        """Of the data; a picture with another one is out of date."""
        return hashlib.sha256(json.dumps(self.data, sort_keys=True).encode()).hexdigest()

    def is_current(self, path: Path) -> bool:
        """Whether a file shows these data. How they are drawn is not compared: remove the file to draw it anew."""
        return path.is_file() and self.fingerprint.encode() in path.read_bytes()

    def save(self, path: Path) -> None:
        """Write the PNG file."""
        figure = self.draw()
        assert figure is not None
        path.parent.mkdir(parents=True, exist_ok=True)
        FigureCanvasAgg(figure)
        figure.savefig(path, dpi=DPI, metadata={_FINGERPRINT: self.fingerprint}, pil_kwargs={"optimize": True})


def pictures(card: CardFigures | None) -> list[Picture]:
    """Those that a card has the figures for, in the order of the page; none without a card."""
    if card is None:
        return []
    grid = [one for one in card.scenarios if one.config == "grid" and one.trials]
    has_pushes = bool(card.pushes.standing or card.pushes.walking or card.pushes.limits)
    made = (
        (len(grid) > 1, Picture("error_grid", _plain(grid), lambda: draw_error_grid(grid))),
        (has_pushes, Picture("pushes", _plain(card.pushes), lambda: draw_pushes(card.pushes))),
        (bool(card.gaits), Picture("gait", _plain(card.gaits), lambda: draw_gaits(card.gaits))),
        (bool(card.torques.joints), Picture("torque", _plain(card.torques), lambda: draw_torques(card.torques))),
    )
    return [picture for there, picture in made if there]


def _plain(data: Any) -> Any:
    return plain([asdict(one) for one in data] if isinstance(data, list | tuple) else asdict(data))
