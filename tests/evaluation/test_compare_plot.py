"""The plot of a comparison: the right figures, in the right colours."""

from __future__ import annotations

import numpy as np
from matplotlib.colors import same_color
from matplotlib.figure import Figure

from asimov_gym.evaluation.compare import Comparison, compare
from asimov_gym.evaluation.compare_plot import COLOURS, difference_plot
from asimov_gym.evaluation.metrics import METRICS
from asimov_gym.evaluation.results import SuiteResult
from tests.evaluation.made_results import result, scenario, trial

INFO = scenario("grid/one", (0.5, 0.0, 0.0), 10)
ERROR, SLIP = "velocity_error_m_s", "slip_m_s"


def made(error: float, name: str) -> SuiteResult:
    trials = [trial(INFO, k, {ERROR: error + 0.001 * k, SLIP: 0.02 + 0.01 * (k % 2)}) for k in range(10)]
    return result([INFO], trials, policy_name=name)


def pair() -> Comparison:
    return compare(made(0.04, "a"), made(0.06, "b"))


def test_each_figure_has_its_difference_in_per_cent_and_the_colour_of_its_flag() -> None:
    figure = difference_plot(pair(), "grid")
    assert isinstance(figure, Figure)
    (axis,) = figure.axes
    assert [label.get_text() for label in axis.get_yticklabels()] == [METRICS[n].description for n in (ERROR, SLIP)]
    marks = [line for line in axis.get_lines() if line.get_marker() == "o" and line.get_linestyle() == "None"]
    worse, same = marks
    # Means 0.0445 and 0.0645; every other figure is the same.
    assert np.allclose(worse.get_xdata(), 100.0 * 0.02 / 0.0445) and same_color(worse.get_color(), COLOURS["worse"])
    assert np.allclose(same.get_xdata(), 0.0) and same_color(same.get_color(), COLOURS["no difference"])


def test_a_category_without_figures_is_named_with_those_that_have_some() -> None:
    assert difference_plot(pair(), "ground") == "the policies share no figure in 'ground'; categories with one: grid"
