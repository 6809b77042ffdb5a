"""What the plots draw, as plain data: taken from a result and its traces, or read from a policy's card."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from asimov_gym.evaluation import gait, tracking
from asimov_gym.evaluation.aggregate import Group, PushRow, by_scenario, push_rows, select
from asimov_gym.evaluation.metrics import joint_metric
from asimov_gym.evaluation.results import PushLimit, ScenarioInfo, SuiteResult
from asimov_gym.robot.feet import SOLE_DEPTH
from asimov_gym.robot.joints import JOINT_NAMES

FIGURES = (
    "velocity_error_m_s",
    "yaw_rate_error_rad_s",
    "velocity_rmse_m_s",
    "yaw_rate_rmse_rad_s",
    "drift_final_m",
    "stance_stagger_m",
    "stand_tilt_max_rad",
)
"""Metrics that are kept of each scenario."""
TIERS = ("reasonable", "beyond")
"""Of the pushes on the map; one without a tier is part of another test, or longer."""
GAIT_S = 3.0
"""Length of a gait sample."""
GAITS = 3
"""Most gait samples of a result."""


@dataclass(frozen=True)
class Spread:
    """A figure over the trials that have it."""

    mean: float
    low: float
    """Smallest."""
    high: float
    """Largest."""


@dataclass(frozen=True)
class ScenarioFigures:
    """What came of one scenario, over its trials."""

    id: str
    config: str
    command: tuple[float, ...]
    """The last one: vx, vy (m/s), yaw rate (rad/s)."""
    planned: int
    """Trials that the suite asks for."""
    trials: int
    """Trials that were run."""
    survived: int
    figures: Mapping[str, Spread]
    """By name, of `FIGURES`; those that no trial has are left out."""

    def mean(self, metric: str) -> float | None:
        """Mean of a figure; None where no trial has it."""
        return self.figures[metric].mean if metric in self.figures else None


def scenario_figures(result: SuiteResult) -> tuple[ScenarioFigures, ...]:
    """Every scenario, in the suite's order."""
    return tuple(map(_of_scenario, by_scenario(result)))


def _of_scenario(group: Group) -> ScenarioFigures:
    info = group.scenarios[0]
    _, *command = info.commands[-1]
    spreads = {}
    for name in FIGURES:
        (values,) = group.values(name)
        if values:
            spreads[name] = Spread(sum(values) / len(values), min(values), max(values))
    return ScenarioFigures(
        info.id,
        info.config,
        tuple(value + 0.0 for value in command),  # no -0.0
        info.repeats,
        len(group.trials),
        group.survival.passed,
        spreads,
    )


# -- pushes ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Pushes:
    """Pushes of the robot maker's benchmark, and bisected limits."""

    standing: tuple[PushRow, ...]
    walking: tuple[PushRow, ...]
    limits: tuple[PushLimit, ...]


def pushes(result: SuiteResult) -> Pushes:
    """The pushes of a result that have a tier, and its limits."""
    speeds = {info.id: max(abs(row[1]) for row in info.commands) for info in result.scenarios}
    rows = [row for row in push_rows(result) if row.push.tier in TIERS]
    walking = tuple(row for row in rows if speeds[row.scenario] > 0.0)
    return Pushes(tuple(row for row in rows if speeds[row.scenario] == 0.0), walking, result.push_limits)


# -- joints ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class JointTorque:
    """Torques of a joint as shares of its limit."""

    joint: str
    rms: float
    """Mean over the trials."""
    peak: float
    """Largest of a trial, mean over the trials."""
    largest: float
    """Of the whole suite."""


@dataclass(frozen=True)
class TorqueUse:
    """Torques of every joint."""

    where: str
    """Which trials the means are over."""
    joints: tuple[JointTorque, ...]
    """In joint order; none where no trial has torques."""


def torques(result: SuiteResult) -> TorqueUse:
    """Torques on the command grid, or on all scenarios of a suite without one."""
    group, where = select(result, "grid", lambda info: info.config == "grid"), "command grid"
    everything = select(result, "all", lambda info: True)
    if not group.trials:
        group, where = everything, "all scenarios"
    if group.mean_value(joint_metric("torque_rms_share", JOINT_NAMES[0])) is None:
        return TorqueUse(where, ())
    return TorqueUse(where, tuple(_torque(joint, group, everything) for joint in JOINT_NAMES))


def _torque(joint: str, group: Group, everything: Group) -> JointTorque:
    peak = joint_metric("torque_peak_share", joint)
    return JointTorque(
        joint,
        group.mean_value(joint_metric("torque_rms_share", joint)) or 0.0,
        group.mean_value(peak) or 0.0,
        everything.largest(peak) or 0.0,
    )


# -- gait ------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class GaitSample:
    """A few seconds of a walk, n policy steps; left foot first."""

    scenario: str
    command: tuple[float, ...]
    """vx, vy (m/s), yaw rate (rad/s)."""
    start_s: float
    """Time of the first step's end."""
    dt: float
    carries: tuple[str, ...]
    """Of each foot a text of n characters: `1` where it carries, `0` where not."""
    asked: tuple[str, ...]
    """The same for what the gait clock asks; empty for a policy without a clock."""
    sole_cm: tuple[tuple[float, ...], ...]
    """Height of each sole above the ground, (2, n)."""


def gait_samples(result: SuiteResult, folder: Path) -> tuple[GaitSample, ...]:
    """Up to `GAITS` steady walks, the plainest first.

    Args:
        result: of a suite.
        folder: its run folder, with the traces.

    Raises:
        FileNotFoundError: a trace that the result names is not there.
    """
    walks = traced(result, _is_steady_walk)
    of_grid = [info for info in walks if info.config == "grid"]
    # Straight ahead first, then what differs from it.
    chosen = sorted(of_grid or walks, key=lambda info: (info.commands[-1][1] <= 0.0, _extras(info)))[:GAITS]
    return tuple(_sample(info, load_trace(result, folder, info)) for info in chosen)


def _sample(info: ScenarioInfo, trace: Mapping[str, np.ndarray]) -> GaitSample:
    time, dt = trace["time"], float(np.median(np.diff(trace["time"])))
    begin = min(max(0, len(time) - round(GAIT_S / dt)), round(2.0 * tracking.SETTLE_S / dt))
    rows = slice(begin, begin + round(GAIT_S / dt))
    height = np.round(100.0 * (np.asarray(trace["foot_height"][rows], dtype=np.float64) - SOLE_DEPTH), 2)
    phase = trace["phase"][rows]
    clock = np.stack([np.sin(phase) <= 0.0, np.sin(phase + np.pi) <= 0.0], axis=1)
    return GaitSample(
        info.id,
        info.commands[-1][1:],
        round(float(time[begin]), 6),
        round(dt, 6),
        _marks(gait.contacts(trace["foot_force"][rows, :, 2])),
        _marks(clock) if np.ptp(phase) > 0.0 else (),
        tuple(tuple(float(value) + 0.0 for value in foot) for foot in height.T),
    )


def _marks(mask: np.ndarray) -> tuple[str, ...]:
    return tuple("".join("01"[int(value)] for value in foot) for foot in mask.T)


def traced(result: SuiteResult, wanted: Callable[[ScenarioInfo], bool]) -> list[ScenarioInfo]:
    """The scenarios with a sample trace that a predicate accepts."""
    return [info for info in result.scenarios if info.id in result.traces and wanted(info)]


def load_trace(result: SuiteResult, folder: Path, info: ScenarioInfo) -> dict[str, np.ndarray]:
    """What a plot needs of a scenario's sample trace."""
    with np.load(folder / result.traces[info.id]) as file:
        return {name: file[name] for name in ("time", "command", "phase", "position", "foot_force", "foot_height")}


def _is_steady_walk(info: ScenarioInfo) -> bool:
    """Whether its last command asks to walk for long enough to be seen."""
    t, *command = info.commands[-1]
    return any(command) and info.duration_s - t >= 2.0 * tracking.SETTLE_S


def _extras(info: ScenarioInfo) -> float:
    """How much a command asks for besides walking ahead."""
    _, _, vy, wz = info.commands[-1]
    return abs(vy) + abs(wz)
