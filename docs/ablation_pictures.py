"""The pictures of the page of ablation studies: learning curves, a panel for each variant beside the base."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict

import numpy as np
from how_good_pictures import Picture
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from asimov_gym.evaluation.plot_style import BLUE, GREY, finish, new_figure
from asimov_gym.evaluation.results import plain
from train.ablation_result import AblationResult, TrainingResult, VariantResult

FOLDER = "ablations"
"""Of the results and the pictures, beside the page."""
_COLUMNS = 4
_FEWEST_FALLS = 0.1
"""Falls per minute that are drawn as the least."""


def pictures(results: Mapping[str, AblationResult]) -> list[Picture]:
    """One for each study with a training."""
    return [
        Picture(name, _data(result), lambda result=result: draw_curves(result))
        for name, result in results.items()
        if result.variants
    ]


def _data(result: AblationResult) -> list[list[object]]:
    return plain([[one.name, [asdict(run)["curve"] for run in one.trainings]] for one in result.variants])


def draw_curves(result: AblationResult) -> Figure:
    """Velocity error and falls per minute over the samples of each variant, the base in grey behind it."""
    variants = [one for one in result.variants if one is not result.base] or list(result.variants)
    columns = min(_COLUMNS, len(variants))
    rows = math.ceil(len(variants) / columns)
    figure = new_figure(2.9 * columns + 0.4, 3.3 * rows + 0.2)
    highest = _highest(result)
    cells = figure.subfigures(rows, columns, squeeze=False).flat
    for place, variant in enumerate(variants):
        above, below = cells[place].subplots(2, 1, sharex=True, height_ratios=(3, 2))
        for axis, name in ((above, "velocity_error_m_s"), (below, "falls_per_min")):
            if result.base is not None:
                _draw(axis, result.base, name, GREY, 1.0)
            if variant is not result.base:
                _draw(axis, variant, name, BLUE, 1.6)
        first = place % columns == 0
        finish(above, y="error, m/s" if first else "", title=variant.name.replace("_", " "))
        above.set_ylim(0.0, highest)
        finish(below, x="million samples", y="falls/min" if first else "")
        below.set_yscale("log")
        below.set_ylim(_FEWEST_FALLS, 150.0)
        below.set_yticks([0.1, 1, 10, 100], ["≤ 0.1", "1", "10", "100"])
        below.minorticks_off()
    return figure


def _draw(axis: Axes, variant: VariantResult, name: str, colour: str, width: float) -> None:
    for training in variant.trainings:
        samples, values = _curve(training, name)
        if name == "falls_per_min":
            values = np.maximum(values, _FEWEST_FALLS)
        axis.plot(samples / 1e6, values, color=colour, lw=width)


def _curve(training: TrainingResult, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Samples and values; what was not finite is left out of the line."""
    return tuple(np.array(training.curve[key], dtype=float) for key in ("samples", name))  # type: ignore[return-value]


def _highest(result: AblationResult) -> float:
    """Upper end of the axis of errors: one for all panels."""
    found = [np.nanmax(_curve(run, "velocity_error_m_s")[1]) for one in result.variants for run in one.trainings]
    return 1.05 * float(max(found))
