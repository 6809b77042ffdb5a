"""A plot of commanded against measured velocity over time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from asimov_gym.cli.tracking import Tracking

LABELS = ("forward, m/s", "left, m/s", "turn, rad/s")


def save(path: Path, tracking: Tracking, phases: Sequence[tuple[float, float, str]], title: str) -> None:
    """Write the plot as a PNG file.

    Args:
        path: file to write.
        tracking: the samples.
        phases: start and stop (s) and name of each phase, shaded by turns and named above the plot.
        title: heading.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    # The object interface, without pyplot: no display is asked for and no global state is left behind.
    figure = Figure(figsize=(10, 6.5), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(3, 1, sharex=True)
    smoothed = tracking.smoothed()
    for channel, (axis, label) in enumerate(zip(axes, LABELS, strict=True)):
        for index, (start, stop, name) in enumerate(phases):
            if index % 2 == 0:
                axis.axvspan(start, stop, color="0.95", lw=0)
            if channel == 0:
                at = ((start + stop) / 2, 1.02)
                axis.annotate(name, at, xycoords=("data", "axes fraction"), ha="center", va="bottom", fontsize=8)
        axis.plot(tracking.time, tracking.velocity[:, channel], color="#b9c6d6", lw=0.8, label="each instant")
        axis.plot(tracking.time, smoothed[:, channel], color="#1f5a99", lw=2, label="mean over one gait period")
        axis.plot(tracking.time, tracking.command[:, channel], color="#d9822b", lw=1.6, ls="--", label="commanded")
        axis.set_ylabel(label)
        axis.grid(color="0.9")
        axis.set_axisbelow(True)
    # A common scale makes a straight walk look straight: without it the noise of an idle channel fills its axis.
    bound = max(0.5, 1.1 * float(abs(tracking.velocity).max(initial=0.0)))
    for axis in axes:
        axis.set_ylim(-bound, bound)
    axes[-1].set_xlabel("simulated time, s")
    axes[-1].set_xlim(0.0, float(tracking.time[-1]))
    axes[-1].legend(loc="lower right", ncols=3, fontsize=8)
    figure.suptitle(title)
    figure.savefig(path, dpi=110)
