"""The figures that the variants of a study are compared by: from a suite's result and the curves of the training."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from asimov_gym.evaluation.aggregate import push_rows, select
from asimov_gym.evaluation.intervals import Share
from asimov_gym.evaluation.metrics import METRICS, Better
from asimov_gym.evaluation.results import ScenarioInfo, SuiteResult, Tier

POINTS = 60
"""Of a curve that is kept."""
ROUNDS = 10
"""Rounds in a row that must keep a mark before it counts as reached."""
LONG_EPISODE_S, CLOSE_M_S = 15.0, 0.25
"""Marks of the training: mean length of an episode, and error of the mean velocity."""
FEWEST = 2
"""Shares that differ by so many trials or fewer do not differ."""
CURVES = {
    "episode_length_s": "episode/length_s",
    "falls_per_min": "episode/falls_per_min",
    "velocity_error_m_s": "error/velocity",
}
"""Curves that are kept, with their names in a run's curves."""


@dataclass(frozen=True)
class Value:
    """A figure of one training."""

    value: float | None
    """None where nothing has it: the drift of robots that all fell, a mark that was never reached."""
    count: int
    """Trials that have it; of a share, those that passed."""
    whole: int
    """Trials that were run."""


Curves = Mapping[str, np.ndarray]
"""Samples and value, (n, 2) each, by the name in a run's curves."""


@dataclass(frozen=True)
class Figure:
    """What a figure says, and which difference counts."""

    title: str
    unit: str
    """`%` for shares, which are 0 to 1; `M` for samples."""
    better: Better
    bound: float
    """A smaller difference does not count; in the figure's unit."""
    measure: Callable[[SuiteResult, Curves], Value | None]
    """None where the suite does not ask for it."""
    relative: float = 0.0
    """A difference smaller than this share of the base's figure does not count either."""

    @property
    def is_share(self) -> bool:
        """Whether it says how many trials of those that were run passed."""
        return self.unit == "%" and self.better == "higher"


# -- of the suite ------------------------------------------------------------------------------------------------------

Measure = Callable[[SuiteResult, Curves], Value | None]


def _is(config: str) -> Callable[[ScenarioInfo], bool]:
    """Scenarios of a category; not the rows of the robot maker's benchmark, which have their own rule of falls."""
    return lambda info: info.config == config and info.conditions.get("fall") == "firmware"


def _survival(config: str) -> Measure:
    def measure(result: SuiteResult, curves: Curves) -> Value | None:
        group = select(result, config, _is(config))
        return _share(group.survival) if group.scenarios else None

    return measure


def _mean(metric: str, config: str = "grid") -> Measure:
    """Mean over the trials that have the figure; errors and drifts of robots that fell have none."""

    def measure(result: SuiteResult, curves: Curves) -> Value | None:
        group = select(result, config, _is(config))
        if not group.scenarios:
            return None
        count = sum(map(len, group.values(metric)))
        return Value(_rounded(group.mean_value(metric)), count, len(group.trials))

    return measure


def _pushes(tier: Tier) -> Measure:
    def measure(result: SuiteResult, curves: Curves) -> Value | None:
        rows = [row for row in push_rows(result) if row.push.tier == tier]
        passed, whole = (sum(getattr(row.outcomes, name) for row in rows) for name in ("passed", "whole"))
        return _share(Share(passed, whole)) if rows else None

    return measure


def _largest_push(result: SuiteResult, curves: Curves) -> Value | None:
    forces = [limit.largest_survived_n for limit in result.push_limits]
    return Value(_rounded(float(np.mean(forces))), len(forces), len(forces)) if forces else None


def _share(share: Share) -> Value:
    return Value(_rounded(share.value), share.passed, share.whole)


def _rounded(value: float | None) -> float | None:
    return None if value is None else float(f"{value:.5g}")


# -- of the training ---------------------------------------------------------------------------------------------------


def reached(curve: np.ndarray, keeps: Callable[[np.ndarray], np.ndarray], rounds: int = ROUNDS) -> float | None:
    """Samples after which a mark was kept for so many rounds in a row; None where it never was.

    Args:
        curve: samples and value of each round, (n, 2).
        keeps: whether values keep the mark, (n,) bool.
        rounds: in a row.
    """
    kept = keeps(curve[:, 1])
    streaks = np.convolve(kept, np.ones(rounds), "valid") if len(kept) >= rounds else np.zeros(0)
    first = np.flatnonzero(streaks >= rounds - 0.5)
    return float(curve[first[0], 0]) if len(first) else None


def _mark(name: str, keeps: Callable[[np.ndarray], np.ndarray]) -> Measure:
    def measure(result: SuiteResult, curves: Curves) -> Value | None:
        samples = reached(curves[name], keeps)
        return Value(samples, int(samples is not None), 1)

    return measure


def kept_curves(curves: Curves, points: int = POINTS) -> dict[str, tuple[float, ...]]:
    """The curves of `CURVES` and their `samples`, each averaged down to so many points or fewer."""
    rounds = curves[CURVES["episode_length_s"]][:, 0]
    parts = np.array_split(np.arange(len(rounds)), min(points, len(rounds)))
    kept = {"samples": _averaged(rounds, parts, 9)}
    return kept | {name: _averaged(curves[where][:, 1], parts, 4) for name, where in CURVES.items()}


def _averaged(values: np.ndarray, parts: Sequence[np.ndarray], digits: int) -> tuple[float, ...]:
    return tuple(float(f"{values[part].mean():.{digits}g}") for part in parts)


# -- all of them -------------------------------------------------------------------------------------------------------

FIGURES: Mapping[str, Figure] = MappingProxyType(
    {
        "survival_grid": Figure("survival on the grid", "%", "higher", 0.03, _survival("grid")),
        "velocity_error": Figure("velocity error", "m/s", "lower", 0.01, _mean("velocity_error_m_s")),
        "yaw_rate_error": Figure("yaw rate error", "rad/s", "lower", 0.01, _mean("yaw_rate_error_rad_s")),
        "velocity_rmse": Figure("RMS velocity error", "m/s", "lower", 0.01, _mean("velocity_rmse_m_s")),
        "yaw_rate_rmse": Figure("RMS yaw rate error", "rad/s", "lower", 0.03, _mean("yaw_rate_rmse_rad_s")),
        "standing_drift": Figure(
            "drift while standing", "m", "lower", 0.01, _mean("standing_drift_settled_m", "standing")
        ),
        "must_pass_pushes": Figure("must-pass pushes", "%", "higher", 0.05, _pushes("reasonable")),
        "stretch_pushes": Figure("stretch pushes", "%", "higher", 0.05, _pushes("beyond")),
        "largest_push": Figure("largest push", "N", "higher", 50.0, _largest_push),
        "survival_friction": Figure("survival on other friction", "%", "higher", 0.05, _survival("friction")),
        "survival_ground": Figure("survival on slopes and rough ground", "%", "higher", 0.05, _survival("ground")),
        "survival_delay": Figure("survival with action delays", "%", "higher", 0.05, _survival("delay")),
        "survival_noise": Figure("survival with sensor noise", "%", "higher", 0.05, _survival("noise")),
        "cost_of_transport": Figure("cost of transport", "", "lower", 0.0, _mean("cost_of_transport"), 0.1),
        "rated_torque": Figure("torque as a share of the rating", "%", "lower", 0.03, _mean("rated_torque_share")),
        "action_jerk": Figure("action jerk", METRICS["action_jerk"].unit, "lower", 0.0, _mean("action_jerk"), 0.2),
        "foot_clearance": Figure("foot clearance", "m", "higher", 0.01, _mean("foot_clearance_m")),
        "samples_to_stay_up": Figure(
            f"samples until episodes last {LONG_EPISODE_S:g} s",
            "M",
            "lower",
            0.0,
            _mark(CURVES["episode_length_s"], lambda seconds: seconds >= LONG_EPISODE_S),
            0.2,
        ),
        "samples_to_follow": Figure(
            f"samples until the error is below {CLOSE_M_S:g} m/s",
            "M",
            "lower",
            0.0,
            _mark(CURVES["velocity_error_m_s"], lambda error: error < CLOSE_M_S),
            0.2,
        ),
    }
)
"""The figures by name, in the order of the page."""


def figures(result: SuiteResult, curves: Curves) -> dict[str, Value]:
    """Those that a suite asks for, of one training."""
    measured = {name: figure.measure(result, curves) for name, figure in FIGURES.items()}
    return {name: value for name, value in measured.items() if value is not None}
