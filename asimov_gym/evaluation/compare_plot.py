"""The plot of a comparison: by how much each figure differs, with its interval."""

from __future__ import annotations

from matplotlib.figure import Figure

from asimov_gym.evaluation.compare import Comparison, Flag, MetricDifference
from asimov_gym.evaluation.metrics import METRICS
from asimov_gym.evaluation.plot_style import BLUE, GREEN, GREY, ORANGE, RED, finish, new_figure
from asimov_gym.evaluation.report import REACHED

COLOURS: dict[Flag, str] = {"better": GREEN, "worse": RED, "different": BLUE, "no difference": GREY}
LEAST = 1e-9
"""A figure of the first policy that is smaller has no per cent."""
LINEAR = 10.0
"""The axis is logarithmic beyond so many per cent, or one wild figure would hide all others."""
_TICKS = (0, 2, 5, 10, 30, 100, 300, 1000, 3000, 10_000)


def difference_plot(comparison: Comparison, config: str) -> Figure | str:
    """The differences of one category in per cent of the first policy's mean, with their 95 % intervals.

    Figures that mean something beside their command alone are left out: their mean over commands may be near zero.

    Args:
        comparison: of two results.
        config: category of scenarios, such as `grid`.

    Returns:
        The figure; a text instead says why there is none.
    """
    rows = [
        row
        for row in comparison.metrics
        if row.config == config and abs(row.first) > LEAST and row.metric not in REACHED
    ]
    if not rows:
        known = ", ".join(dict.fromkeys(row.config for row in comparison.metrics)) or "none"
        return f"the policies share no figure in {config!r}; categories with one: {known}"
    figure = new_figure(9.0, 1.3 + 0.27 * len(rows))
    axis = figure.subplots()
    for place, row in enumerate(rows):
        value, low, high = _percent(row)
        colour = COLOURS[row.flag]
        axis.plot([low, high], [place, place], "-", color=colour, lw=2.2, solid_capstyle="butt")
        axis.plot(value, place, "o", color=colour, ms=5)
    flags = {row.flag for row in rows}
    for flag, colour in COLOURS.items():
        if flag in flags:
            axis.plot([], [], "o-", color=colour, label=flag)
    axis.axvline(0.0, color=ORANGE, lw=1.0, zorder=0)
    reach = max(2.0, *(abs(end) for row in rows for end in _percent(row)))
    axis.set_xscale("symlog", linthresh=LINEAR, linscale=2.0)
    axis.set_xlim(-1.2 * reach, 1.2 * reach)
    ticks = [sign * tick for tick in _TICKS if tick <= reach for sign in ((-1, 1) if tick else (1,))]
    axis.set_xticks(ticks, [f"{tick:+d}" if tick else "0" for tick in ticks])
    axis.minorticks_off()
    axis.set_yticks(range(len(rows)), [METRICS[row.metric].description for row in rows])
    axis.set_ylim(len(rows) - 0.4, -0.6)
    finish(axis, f"{comparison.second} less {comparison.first}, % of the latter's mean", title=f"scenarios: {config}")
    figure.legend(fontsize=8, loc="outside lower center", ncols=4, frameon=False)
    return figure


def _percent(row: MetricDifference) -> tuple[float, float, float]:
    """Difference and the ends of its interval; without an interval all three are one."""
    scale = 100.0 / abs(row.first)
    low = row.difference if row.low is None else row.low
    high = row.difference if row.high is None else row.high
    return scale * row.difference, scale * low, scale * high
