"""Plots: drawn where there is something to draw, else left out with a reason; and what they draw."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path

import imageio.v3
import numpy as np
import pytest
from matplotlib.patches import Rectangle
from matplotlib.projections.polar import PolarAxes

from asimov_gym.evaluation.plots import draw_plots, error_grid, sweeps, torque_use
from asimov_gym.evaluation.push_plot import push_map
from asimov_gym.evaluation.results import SuiteResult
from asimov_gym.evaluation.trace_plots import gait_diagram, square_paths
from tests.evaluation.made_results import result, scenario, trial, walk_trace, whole_suite


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[SuiteResult, Path]:
    """A whole result and its folder."""
    folder = tmp_path_factory.mktemp("run")
    return whole_suite(folder), folder


def texts(figure) -> list[str]:
    """All words of a figure."""
    return [text.get_text() for text in figure.findobj(lambda artist: hasattr(artist, "get_text"))]


def test_every_plot_of_a_whole_result_is_a_picture(made: tuple[SuiteResult, Path]) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        plots = draw_plots(*made)
    assert [plot.name for plot in plots] == ["error_grid", "pushes", "gait", "torque", "sweeps", "square"]
    for plot in plots:
        assert plot.path is not None and plot.missing == ""
        image = imageio.v3.imread(plot.path)
        assert image.shape[0] > 200 and image.shape[1] > 400
        assert 20.0 < image[..., :3].mean() < 254.5, f"{plot.name} is blank"


def test_what_was_not_measured_is_left_out_with_a_reason(tmp_path: Path) -> None:
    info = scenario("standing/still", repeats=1)
    plots = draw_plots(result([info], [trial(info, 0)]), tmp_path)
    assert all(plot.path is None and plot.missing for plot in plots)
    assert not list(tmp_path.iterdir())


def test_the_grid_shows_every_command_and_its_falls(made: tuple[SuiteResult, Path]) -> None:
    figure = error_grid(*made)
    assert not isinstance(figure, str)
    words = texts(figure)
    assert words.count("✕ 1 of 4") == 2  # in both maps
    assert {"vy = -0.4 m/s", "vy = 0", "vy = +0.4 m/s"} <= set(words)
    maps = [axis.images[0].get_array() for axis in figure.axes if axis.images]
    assert [values.shape for values in maps] == [(5, 3)] * 6
    commands = {info.id: info.commands[0][1:] for info in made[0].scenarios if info.config == "grid"}
    (name,) = [name for name, command in commands.items() if command == (0.4, -0.4, 0.8)]
    errors = [t.metrics["velocity_error_m_s"] for t in made[0].trials_of(name)]
    assert maps[0][3, 2] == pytest.approx(np.mean(errors))  # vx rises upwards, yaw rate to the right


def test_torques_are_those_of_the_grid(made: tuple[SuiteResult, Path]) -> None:
    figure = torque_use(*made)
    assert not isinstance(figure, str)
    assert "knee" in texts(figure) and "command grid" in " ".join(texts(figure))
    bars = [bar for bar in figure.axes[0].patches if isinstance(bar, Rectangle)]
    row = [label.get_text() for label in figure.axes[0].get_yticklabels()].index("knee")
    of_left_knee = [bar.get_width() for bar in bars if -0.3 < bar.get_y() + 0.5 * bar.get_height() - row < 0.0]
    trials = [t.metrics for t in made[0].trials if t.config == "grid" and t.survived]
    for name in ("torque_rms_share/left_knee", "torque_peak_share/left_knee"):
        assert 100.0 * np.mean([metrics[name] for metrics in trials]) == pytest.approx(of_left_knee.pop())


def test_sweeps_take_each_value_of_a_condition(made: tuple[SuiteResult, Path]) -> None:
    figure = sweeps(*made)
    assert not isinstance(figure, str)
    by_label = {axis.get_xlabel(): axis for axis in figure.axes if axis.get_xlabel()}
    assert set(by_label) == {"action delay, ms", "foot friction", "slope, degrees", "rough ground, cm"}
    survival = figure.axes[0].lines[0]
    points = np.array([survival.get_xdata(), survival.get_ydata()], dtype=float)
    np.testing.assert_allclose(points, [[0, 5, 10, 15, 20, 25], [100, 100, 100, 100, 100, 0]])


def test_pushes_are_drawn_where_the_force_goes(made: tuple[SuiteResult, Path]) -> None:
    figure = push_map(*made)
    assert not isinstance(figure, str)
    standing, walking = (axis for axis in figure.axes if axis.name == "polar")
    assert (standing.get_title(), walking.get_title()) == ("standing", "walking")
    outline = max(standing.lines, key=lambda line: len(line.get_xdata()))
    angles, forces = np.array(outline.get_xdata()), np.array(outline.get_ydata())
    assert forces[0] == 500.0 and angles[0] == 0.0  # to the front
    assert forces[2] == 400.0 and angles[2] == pytest.approx(np.pi / 2)  # to the left
    words = texts(figure)
    assert "left shoulder down\nstanding" in words and "pelvis" in words and "chest" in words
    assert isinstance(standing, PolarAxes)
    assert standing.get_theta_offset() == pytest.approx(np.pi / 2)  # the front is at the top
    assert standing.get_theta_direction() == 1  # and the left on the left


def test_gait_diagram_compares_contacts_with_the_clock(made: tuple[SuiteResult, Path]) -> None:
    figure = gait_diagram(*made)
    assert not isinstance(figure, str)
    bars = figure.axes[0]
    spans = [path.get_extents().width for path in bars.collections[1].get_paths()]
    trace = walk_trace()
    carries = trace["foot_force"][200:350, 0, 2] > 5.0
    assert sum(spans) == pytest.approx(carries.sum() * 0.02)
    assert len(bars.collections) == 4  # clock and contact of both feet
    no_clock = {**trace, "phase": np.zeros_like(trace["phase"])}
    np.savez(made[1] / "no_clock.npz", **no_clock)
    without = gait_diagram(replace(made[0], traces={"grid/0.4_0_0": "no_clock.npz"}), made[1])
    assert not isinstance(without, str) and len(without.axes[0].collections) == 2


def test_square_shows_drift_and_a_fall(made: tuple[SuiteResult, Path], tmp_path: Path) -> None:
    figure = square_paths(*made)
    assert not isinstance(figure, str)
    words = " ".join(texts(figure))
    assert "heading held: 0.0 m off at the end" in words and "open loop: 11.2 m off" in words
    short = {name: values[:5000] for name, values in walk_trace(square=True).items()}
    np.savez(tmp_path / "short.npz", **short)
    fell = square_paths(replace(made[0], traces={"distance/square_open": "short.npz"}), tmp_path)
    assert not isinstance(fell, str) and "fell after 100 s" in " ".join(texts(fell))
