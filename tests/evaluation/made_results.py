"""Suite results made up for tests: the shape of a real one, with figures that follow simple rules."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from asimov_gym.evaluation.metrics import METRICS, joint_metric
from asimov_gym.evaluation.results import PushLimit, PushOutcome, ScenarioInfo, SuiteResult, TrialResult
from asimov_gym.robot.joints import JOINT_NAMES

CONDITIONS: dict[str, Any] = {
    "delay": "by_seed",
    "noise": 0.0,
    "payload_kg": 0.0,
    "motor_strength": 1.0,
    "weak_joints": [],
    "foot_friction": 0.6,
    "terrain": "flat",
    "hold_heading": False,
    "initial_joint_error": 0.02,
    "fall": "firmware",
    "physics": "evaluation",
    "limits": None,
}
Events = tuple[PushOutcome, ...]


def scenario(
    name: str,
    command: tuple[float, float, float] = (0.0, 0.0, 0.0),
    repeats: int = 4,
    seconds: float = 60.0,
    **other: Any,
) -> ScenarioInfo:
    """A scenario `<config>/<name>` with one command."""
    config = name.split("/")[0]
    return ScenarioInfo(name, config, f"made up: {name}", seconds, ((0.0, *command),), {**CONDITIONS, **other}, repeats)


def trial(
    info: ScenarioInfo,
    repeat: int,
    metrics: Mapping[str, float | None] | None = None,
    *,
    fall_s: float | None = None,
    events: Events = (),
    error: str | None = None,
    seed: int | None = None,
) -> TrialResult:
    """One repeat; figures that are not given are None."""
    delay = info.conditions["delay"]
    return TrialResult(
        scenario=info.id,
        config=info.config,
        repeat=repeat,
        seed=repeat + 60 * sum(info.id.encode()) if seed is None else seed,
        delay_ms=float(delay) if isinstance(delay, int | float) else (repeat % 6) * 5.0,
        survived=fall_s is None and error is None,
        fall_s=fall_s,
        events=events,
        metrics={**dict.fromkeys(METRICS), **(metrics or {})},
        error=error,
    )


def result(
    scenarios: Iterable[ScenarioInfo], trials: Iterable[TrialResult], limits: Iterable[PushLimit] = (), **other: Any
) -> SuiteResult:
    """A result of a suite called `made`."""
    values: dict[str, Any] = {
        "suite": "made",
        "suite_hash": "5" * 64,
        "policy_name": "made_up.onnx",
        "policy_hash": "a" * 64,
        "contract": {"layout": "asimov-80", "policy_rate_hz": 50.0, "gait_frequency_hz": 1.5},
        "machine": {"system": "Linux", "cores": 2},
        "versions": {"asimov-gym": "0.1.0", "mujoco": "4.0.0"},
        "started": "2026-11-22T18:00:00+00:00",
        "wall_clock_s": 754.0,
        "complete": True,
    }
    return SuiteResult(
        scenarios=tuple(scenarios), trials=tuple(trials), push_limits=tuple(limits), **{**values, **other}
    )


def walking_metrics(rng: np.random.Generator, error: float) -> dict[str, float | None]:
    """Plausible figures of a walk."""
    metrics: dict[str, float | None] = {
        name: float(rng.uniform(0.9, 1.1)) * 0.1 for name in METRICS if not name.startswith(("standing", "sway"))
    }
    metrics |= {
        "velocity_error_m_s": error,
        "yaw_rate_error_rad_s": 1.4 * error,
        "velocity_rmse_m_s": 0.06,
        "yaw_rate_rmse_rad_s": 0.18,
        "gait_frequency_hz": 1.5,
    }
    for place, joint in enumerate(JOINT_NAMES):
        share = 0.1 + 0.02 * place
        metrics[joint_metric("torque_rms_share", joint)] = share * float(rng.uniform(0.95, 1.05))
        metrics[joint_metric("torque_peak_share", joint)] = min(1.0, 2.2 * share)
    return metrics


def push(
    force: float, tier: Any, outcome: Any, body: str = "pelvis_link", direction: Any = (1.0, 0.0, 0.0), at: float = 2.0
):
    """A push and what came of it."""
    return PushOutcome(f"{body} {force:g}", body, direction, force, at, tier, outcome)


def whole_suite(
    folder: Path | None = None, *, repeats: int = 4, error: Callable[[ScenarioInfo], float] | None = None
) -> SuiteResult:
    """A result with every kind of scenario, three falls, one trial with an error and one that is missing.

    Args:
        folder: for the sample traces; none are made when omitted.
        repeats: of every scenario.
        error: velocity error of a scenario.
    """
    rng = np.random.default_rng(3)
    infos, trials = [], []

    def add(info: ScenarioInfo, **other: Any) -> None:
        infos.append(info)
        size = 0.01 + 0.03 * float(np.linalg.norm(info.commands[0][1:])) if error is None else error(info)
        for repeat in range(info.repeats):
            metrics = walking_metrics(rng, size * float(rng.uniform(0.8, 1.2)))
            given = {key: value(repeat) if callable(value) else value for key, value in other.items()}
            metrics |= given.pop("metrics", {})
            trials.append(trial(info, repeat, metrics if given.get("fall_s") is None else {}, **given))

    for vx, vy, wz in itertools.product((-0.5, -0.2, 0.0, 0.4, 0.8), (-0.4, 0.0, 0.4), (-0.8, 0.0, 0.8)):
        fell = (lambda repeat: 31.5 if repeat == 2 else None) if (vx, vy, wz) == (0.8, 0.4, 0.8) else None
        add(scenario(f"grid/{vx:g}_{vy:g}_{wz:g}", (vx, vy, wz), repeats), fall_s=fell)
    add(
        scenario("standing/still", repeats=repeats, seconds=12.0),
        metrics=lambda repeat: {
            "standing_drift_m": 0.02,
            "standing_drift_settled_m": 0.004 + 0.001 * repeat,
            "standing_steps": 0.0,
            "sway_m": 0.0004,
        },
    )
    for delay in (0, 5, 10, 15, 20, 25):
        add(scenario(f"delay/ms_{delay}", (0.6, 0.0, 0.0), repeats, delay=delay), fall_s=8.0 if delay == 25 else None)
    for friction in (0.08, 0.3, 0.6, 1.2):
        fell = (lambda repeat: 4.0 if repeat else None) if friction == 0.08 else None
        add(scenario(f"friction/mu_{friction:g}", (0.5, 0.0, 0.3), repeats, foot_friction=friction), fall_s=fell)
    for degrees in (3, 6, 10):
        add(scenario(f"ground/up_{degrees}", (0.4, 0.0, 0.0), repeats, terrain=f"slope:{degrees}"))
    for height in (0.02, 0.04):
        add(scenario(f"ground/rough_{height:g}", (0.4, 0.0, 0.0), repeats, terrain=f"rough:{height},1"))
    for held in (False, True):
        name = f"distance/square_{'held' if held else 'open'}"
        add(
            scenario(name, (0.6, 0.0, 0.0), repeats, 180.0, hold_heading=held),
            metrics={"drift_final_m": 4.0 if held else 60.0},
        )
    for physics in ("evaluation", "half_step", "cg", "feet_only", "mjx"):
        add(scenario(f"physics/{physics}", (0.8, 0.0, 0.0), repeats, physics=physics))
    left, up = (0.0, 1.0, 0.0), (0.0, 0.0, -1.0)
    for config, speed in (("push_standing", 0.0), ("push_walking", 0.6)):
        for body, force, way in (("pelvis_link", 450.0, left), ("waist_yaw_link", 250.0, (1.0, 0.0, 0.0))):
            second = "failed" if body == "pelvis_link" else "passed"
            events = (
                push(force, "reasonable", "passed", body, way),
                push(force + 100, "beyond", second, body, way, 8.0),
            )
            fell = 8.9 if second == "failed" else None
            add(scenario(f"{config}/{body}", (speed, 0, 0), repeats, 12.0), events=events, fall_s=fell)
        down = (push(850.0, "reasonable", "passed", "left_shoulder_pitch_link", up),)
        add(scenario(f"{config}/down", (speed, 0, 0), repeats, 12.0), events=down)
    infos.append(scenario("noise/broken", (0.5, 0.0, 0.0), 2, noise=1.0))
    trials.append(trial(infos[-1], 0, error="the simulation diverged after 3.20 s"))
    made = result(infos, trials, _limits())
    return made if folder is None else _with_traces(made, folder)


def _limits() -> list[PushLimit]:
    limits = []
    for speed, (body, base), angle in itertools.product(
        (0.0, 0.6), (("pelvis_link", 500.0), ("waist_yaw_link", 300.0)), np.arange(8) * math.pi / 4
    ):
        way = (float(np.cos(angle)), float(np.sin(angle)), 0.0)
        force = 25.0 * round(base * (1.0 - 0.2 * abs(math.sin(angle))) * (0.8 if speed else 1.0) / 25.0)
        name = f"push_limits/{body}_{'walk' if speed else 'stand'}_{round(math.degrees(angle))}"
        limits.append(PushLimit(name, body, way, speed, force, force + 25.0, 25.0, 3))
    return limits


def _with_traces(made: SuiteResult, folder: Path) -> SuiteResult:
    (folder / "traces").mkdir(parents=True, exist_ok=True)
    traces = {}
    for info in made.scenarios:
        if info.id not in ("grid/0.4_0_0", "distance/square_open", "distance/square_held"):
            continue
        name = f"traces/{info.id.replace('/', '_')}.npz"
        np.savez_compressed(folder / name, **walk_trace(square=info.config == "distance", held="held" in info.id))
        traces[info.id] = name
    return SuiteResult(**{**vars(made), "traces": traces})


def walk_trace(seconds: float = 12.0, square: bool = False, held: bool = False) -> dict[str, np.ndarray]:
    """A sample trace, as `Trace.save` writes it: a walk with a clock of 1.5 Hz, straight or round a square."""
    dt, rate = 0.02, 1.5
    t = dt * (1 + np.arange(round((180.0 if square else seconds) / dt)))
    command = np.tile([0.6 if square else 0.4, 0.0, 0.0], (len(t), 1))
    if square:
        command[((t + 2.618) % 44.285) < 2.618] = [0.0, 0.0, 0.6]
    phase = (2.0 * math.pi * rate * t) % (2.0 * math.pi)
    late = phase - 0.4
    swing = np.stack([np.sin(late), np.sin(late + math.pi)], axis=1) > 0.15
    turning = command[:, 2] * (1.0 if held or not square else 0.9)
    heading = np.cumsum(turning) * dt
    position = (
        np.stack([np.cumsum(command[:, 0] * np.cos(heading)), np.cumsum(command[:, 0] * np.sin(heading))], 1) * dt
    )
    force = np.zeros((len(t), 2, 3))
    force[:, :, 2] = np.where(swing, 0.0, 200.0)
    return {
        "time": t,
        "command": command,
        "phase": phase,
        "position": np.concatenate([position, np.full((len(t), 1), 0.7)], axis=1),
        "foot_force": force,
        "foot_height": 0.009 + np.where(swing, 0.05, 0.0),
    }
