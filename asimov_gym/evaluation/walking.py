"""Tracking, standing and pushes: the figures on a policy's card."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from asimov_gym.evaluation.rollout import Trace, roll_out
from asimov_gym.policy import Policy

SETTLE_S = 2.0
"""Tracking is judged after this."""
CYCLE_WITHOUT_CLOCK_S = 0.7
"""Gait cycle assumed for a policy without a clock."""
Progress = Callable[[int, int], None]

COMMAND_GRID: tuple[tuple[float, float, float], ...] = (
    *((vx, 0.0, 0.0) for vx in (-0.4, -0.2, 0.2, 0.4, 0.7)),
    *((0.0, vy, 0.0) for vy in (-0.3, -0.15, 0.15, 0.3)),
    *((0.0, 0.0, wz) for wz in (-0.6, -0.3, 0.3, 0.6)),
    *itertools.product((-0.4, 0.7), (-0.3, 0.3), (-0.6, 0.6)),
)
"""vx, vy (m/s) and yaw rate (rad/s): each axis alone, and the corners of the box."""


def moving_mean(values: np.ndarray, width: int) -> np.ndarray:
    """Mean over a sliding window of `width` rows along the first axis; (T - width + 1, ...)."""
    total = np.cumsum(np.concatenate([np.zeros_like(values[:1]), values]), axis=0)
    return (total[width:] - total[:-width]) / width


def gait_period(policy: Policy) -> float:
    """Length of the policy's gait cycle, s."""
    frequency = policy.contract.gait_frequency_hz
    return CYCLE_WITHOUT_CLOCK_S if frequency is None else 1.0 / frequency


def tracking_error(trace: Trace, period: float) -> tuple[np.ndarray, np.ndarray]:
    """Mean error of each robot's velocity averaged over a gait cycle, after the first two seconds.

    Returns:
        Norm of the planar error, m/s, and absolute yaw rate error, rad/s; (n,) each, NaN for robots that fell.
    """
    first, width = round(SETTLE_S / trace.dt), max(1, round(period / trace.dt))
    error = moving_mean(trace.velocity[first:] - trace.command[first:], width)
    lost = np.where(trace.survived, 0.0, np.nan)
    return np.linalg.norm(error[:, :, :2], axis=2).mean(axis=0) + lost, np.abs(error[:, :, 2]).mean(axis=0) + lost


def tracking_rmse(trace: Trace) -> tuple[np.ndarray, np.ndarray]:
    """The same as root mean squares of the instantaneous error."""
    error = (trace.velocity - trace.command)[round(SETTLE_S / trace.dt) :]
    lost = np.where(trace.survived, 0.0, np.nan)
    planar = np.sqrt((error[:, :, :2] ** 2).sum(axis=2).mean(axis=0))
    return planar + lost, np.sqrt((error[:, :, 2] ** 2).mean(axis=0)) + lost


@dataclass(frozen=True)
class CommandResult:
    """One command of the grid, over all seeds."""

    command: tuple[float, float, float]
    survived: int
    seeds: int
    velocity: tuple[float, float, float]
    """Mean velocity reached: vx, vy, yaw rate."""
    velocity_error: float
    yaw_rate_error: float
    velocity_rmse: float
    yaw_rate_rmse: float


def walk_grid(
    policy: Policy,
    commands: tuple[tuple[float, float, float], ...] = COMMAND_GRID,
    seeds: int = 20,
    seconds: float = 20.0,
    progress: Progress | None = None,
) -> list[CommandResult]:
    """Walk every command with every seed."""
    rows = np.repeat(np.array(commands), seeds, axis=0)
    trace = roll_out(policy, np.tile(np.arange(seeds), len(commands)), seconds, lambda now: rows, progress=progress)
    error, yaw_error = tracking_error(trace, gait_period(policy))
    rmse, yaw_rmse = tracking_rmse(trace)
    reached = trace.velocity[round(SETTLE_S / trace.dt) :].mean(axis=0)
    results = []
    for i, command in enumerate(commands):
        mine = slice(i * seeds, (i + 1) * seeds)
        up = trace.survived[mine]
        mean = reached[mine][up].mean(axis=0) if up.any() else np.full(3, np.nan)
        results.append(
            CommandResult(
                command=command,
                survived=int(up.sum()),
                seeds=seeds,
                velocity=(float(mean[0]), float(mean[1]), float(mean[2])),
                velocity_error=_mean(error[mine]),
                yaw_rate_error=_mean(yaw_error[mine]),
                velocity_rmse=_mean(rmse[mine]),
                yaw_rate_rmse=_mean(yaw_rmse[mine]),
            )
        )
    return results


@dataclass(frozen=True)
class StandingResult:
    """Ten seconds at zero command, over all seeds."""

    survived: int
    seeds: int
    drift: float
    """Largest distance of the pelvis from its place at the start, m, worst seed, whole time."""
    settled_drift: float
    """The same from its place after two seconds, m."""
    lifted: float
    """Largest height of a sole above its resting height after two seconds, m: stepping shows here."""


def stand(policy: Policy, seeds: int = 20, seconds: float = 10.0, progress: Progress | None = None) -> StandingResult:
    """Stand at zero command."""
    zero = np.zeros((seeds, 3))
    trace = roll_out(policy, np.arange(seeds), seconds, lambda now: zero, progress=progress)
    first = round(SETTLE_S / trace.dt)
    away = np.linalg.norm(trace.position[:, :, :2] - trace.start[:, :2], axis=2)
    settled = np.linalg.norm(trace.position[first:, :, :2] - trace.position[first, :, :2], axis=2)
    return StandingResult(
        survived=int(trace.survived.sum()),
        seeds=seeds,
        drift=float(away.max()),
        settled_drift=float(settled.max()),
        lifted=float((trace.foot_height[first:] - trace.foot_height[first]).max()),
    )


@dataclass(frozen=True)
class Push:
    """A short force on a body, as in the published benchmark of the robot's maker: 0.15 s in a world direction."""

    body: str
    direction: tuple[float, float, float]
    force: float
    """N."""
    speed: float
    """Forward command while pushed, m/s; 0 stands."""
    label: str


def _must_pass() -> tuple[Push, ...]:
    front, back, left, right, down = (1.0, 0, 0), (-1.0, 0, 0), (0, 1.0, 0), (0, -1.0, 0), (0, 0, -1.0)
    pelvis, chest = "pelvis_link", "waist_yaw_link"
    shoulders = {"left": "left_shoulder_pitch_link", "right": "right_shoulder_pitch_link"}
    outward = {"left": left, "right": right}
    standing = [
        Push(pelvis, front, 450, 0.0, "pelvis front"),
        Push(pelvis, back, 450, 0.0, "pelvis back"),
        Push(pelvis, left, 450, 0.0, "pelvis lateral"),
        Push(chest, front, 250, 0.0, "chest front"),
        *(Push(b, front, {"left": 225, "right": 175}[s], 0.0, f"{s} shoulder front") for s, b in shoulders.items()),
        *(Push(b, outward[s], 225, 0.0, f"{s} shoulder lateral") for s, b in shoulders.items()),
        *(Push(b, down, 850, 0.0, f"{s} shoulder down") for s, b in shoulders.items()),
    ]
    walking = [
        Push(chest, front, 225, 0.6, "chest front"),
        Push(pelvis, back, 450, 0.6, "pelvis back"),
        *(Push(b, front, 175, 0.6, f"{s} shoulder front") for s, b in shoulders.items()),
        *(Push(b, outward[s], 150, 0.6, f"{s} shoulder lateral") for s, b in shoulders.items()),
        *(Push(b, down, 850, 0.6, f"{s} shoulder down") for s, b in shoulders.items()),
    ]
    return (*standing, *walking)


MUST_PASS_PUSHES = _must_pass()
"""The maker's 18 must-pass pushes."""
PUSH_S = 0.15


@dataclass(frozen=True)
class PushResult:
    """One push, over all seeds."""

    push: Push
    survived: int
    seeds: int


def push(
    policy: Policy,
    pushes: tuple[Push, ...] = MUST_PASS_PUSHES,
    seeds: int = 5,
    at_s: float = 2.0,
    seconds: float = 8.0,
    progress: Progress | None = None,
) -> list[PushResult]:
    """Push every robot once at `at_s` and see whether it is up at the end."""
    n = len(pushes) * seeds
    command = np.zeros((n, 3))
    command[:, 0] = np.repeat([p.speed for p in pushes], seeds)
    forces: dict[str, np.ndarray] = {p.body: np.zeros((n, 6)) for p in pushes}
    for i, p in enumerate(pushes):
        forces[p.body][i * seeds : (i + 1) * seeds, :3] = p.force * np.array(p.direction)

    def wrench(now: float) -> Mapping[str, np.ndarray] | None:
        # Steps are 20 ms: half of the eighth one is pushed at half force, so that the impulse is that of 0.15 s.
        share = min(1.0, max(0.0, (at_s + PUSH_S - now) / 0.02)) if now >= at_s else 0.0
        return {body: share * force for body, force in forces.items()} if share > 0.0 else None

    trace = roll_out(policy, np.tile(np.arange(seeds), len(pushes)), seconds, lambda now: command, wrench, progress)
    survived = trace.survived.reshape(len(pushes), seeds).sum(axis=1)
    return [PushResult(p, int(s), seeds) for p, s in zip(pushes, survived, strict=True)]


def _mean(values: np.ndarray) -> float:
    """Mean of the robots that did not fall; NaN when all fell."""
    up = values[~np.isnan(values)]
    return float(up.mean()) if len(up) else float("nan")
