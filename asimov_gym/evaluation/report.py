"""All figures of a policy in one report: as data, and as tables for a terminal or a policy's card."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np

from asimov_gym.evaluation.walking import CommandResult, PushResult, StandingResult, push, stand, walk_grid
from asimov_gym.policy import Policy

StageProgress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Report:
    """Tracking, standing and pushes of one policy under the evaluation conditions."""

    grid: list[CommandResult]
    standing: StandingResult
    pushes: list[PushResult]

    @property
    def falls(self) -> int:
        """Robots that fell on the grid."""
        return sum(result.seeds - result.survived for result in self.grid)

    @property
    def walks(self) -> int:
        """Robots on the grid."""
        return sum(result.seeds for result in self.grid)

    def mean(self, name: str) -> float:
        """Mean over the grid of a field of `CommandResult`; NaN if any command has none because all fell."""
        return float(np.mean([getattr(result, name) for result in self.grid]))

    @property
    def pushes_passed(self) -> int:
        """Pushes that every seed survived."""
        return sum(result.survived == result.seeds for result in self.pushes)

    def to_json(self) -> dict[str, Any]:
        """Plain data; figures that do not exist are null."""
        return _plain(
            {
                "summary": {
                    "walks": self.walks,
                    "falls": self.falls,
                    "velocity_error": self.mean("velocity_error"),
                    "yaw_rate_error": self.mean("yaw_rate_error"),
                    "velocity_rmse": self.mean("velocity_rmse"),
                    "yaw_rate_rmse": self.mean("yaw_rate_rmse"),
                    "standing_drift": self.standing.drift,
                    "pushes_passed": self.pushes_passed,
                    "pushes": len(self.pushes),
                },
                "grid": [asdict(result) for result in self.grid],
                "standing": asdict(self.standing),
                "pushes": [asdict(result) for result in self.pushes],
            }
        )

    def summary(self) -> str:
        """The figures that matter, a line each."""
        lines = [
            f"walks without a fall   {self.walks - self.falls} of {self.walks}",
            f"velocity error         {self.mean('velocity_error'):.3f} m/s over a gait cycle, "
            f"{self.mean('velocity_rmse'):.3f} m/s RMS at each instant",
            f"turning error          {self.mean('yaw_rate_error'):.3f} rad/s over a gait cycle, "
            f"{self.mean('yaw_rate_rmse'):.3f} rad/s RMS at each instant",
            f"standing               {self.standing.survived} of {self.standing.seeds} up, drift "
            f"{100 * self.standing.drift:.2f} cm ({100 * self.standing.settled_drift:.2f} cm once settled)",
        ]
        if self.pushes:
            lines.append(f"pushes                 {self.pushes_passed} of {len(self.pushes)} survived by every seed")
        return "\n".join(lines)

    def markdown(self) -> str:
        """Tables of the grid and the pushes."""
        lines = [
            "| asked vx, vy, wz | no fall | got vx, vy, wz | error m/s | error rad/s |",
            "|---|---|---|---|---|",
        ]
        for r in self.grid:
            asked, got = (", ".join(f"{v:+.2f}" for v in values) for values in (r.command, r.velocity))
            errors = f"{r.velocity_error:.3f} | {r.yaw_rate_error:.3f}"
            lines.append(f"| {asked} | {r.survived}/{r.seeds} | {got} | {errors} |")
        if self.pushes:
            lines += ["", "| push, 0.15 s | N | while | survived |", "|---|---|---|---|"]
            for r in self.pushes:
                doing = f"walking {r.push.speed:g} m/s" if r.push.speed else "standing"
                lines.append(f"| {r.push.label} | {r.push.force:g} | {doing} | {r.survived}/{r.seeds} |")
        return "\n".join(lines)


def evaluate(
    policy: Policy,
    seeds: int = 20,
    seconds: float = 20.0,
    pushes: bool = True,
    progress: StageProgress | None = None,
) -> Report:
    """Walk the command grid, stand and be pushed.

    Args:
        policy: the network.
        seeds: robots per command; a seed fixes the start and the action delay, (seed mod 6) * 5 ms.
        seconds: length of each walk.
        pushes: also try the must-pass pushes of the robot maker's benchmark.
        progress: called with the stage's name, the steps done and the steps in all.

    Raises:
        ValueError: `seeds` or `seconds` is too small.
    """
    if seeds < 1:
        raise ValueError(f"seeds must be at least 1, got {seeds}")
    if not seconds >= 4.0:
        raise ValueError(f"seconds must be at least 4 (tracking is judged after 2), got {seconds}")

    def stage(name: str) -> Callable[[int, int], None] | None:
        return None if progress is None else partial(progress, name)

    return Report(
        grid=walk_grid(policy, seeds=seeds, seconds=seconds, progress=stage("walking")),
        standing=stand(policy, seeds=seeds, progress=stage("standing")),
        pushes=push(policy, progress=stage("pushes")) if pushes else [],
    )


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
