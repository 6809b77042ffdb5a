"""What a round of steps is reported by, for every learner and every engine; over the array-API standard."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from asimov_gym.robot.array_library import namespace
from asimov_gym.tasks.walk.task import DT


def step_figures(
    reward: Any, terminated: Any, diverged: Any, command_error: Any, shares: Mapping[str, Any]
) -> dict[str, Any]:
    """Figures of one step of N copies by name, scalars of the arrays' library.

    Args:
        reward: (N,).
        terminated: fallen or diverged, (N,) bool.
        diverged: (N,) bool.
        command_error: running mean velocity less the command after the step, (N, 3): m/s, m/s, rad/s.
        shares: each reward term's weighted value per second, (N,).
    """
    xp = namespace(reward)
    real = reward.dtype
    linear = xp.sqrt(xp.sum(command_error[:, :2] ** 2, axis=1))
    figures = {
        "episode/reward": xp.mean(reward) / DT,
        "episode/falls_per_min": xp.mean(xp.astype(terminated, real)) * (60.0 / DT),
        "error/velocity": xp.mean(linear),
        "error/yaw_rate": xp.mean(xp.abs(command_error[:, 2])),
        "physics/diverged": xp.sum(xp.astype(diverged, real)),
    }
    return figures | {f"reward/{name}": xp.mean(share) for name, share in shares.items()}


def round_figures(
    losses: Mapping[str, float], std: float, learning_rate: float, curriculum: Mapping[str, float]
) -> dict[str, float]:
    """Figures of a round by name.

    Args:
        losses: `value`, `surrogate` and `entropy`, means over the round's minibatches.
        std: mean standard deviation of the exploration.
        learning_rate: after the round.
        curriculum: `penalty`, `kick`, and `mean_length` of an episode in policy steps.
    """
    return {f"loss/{name}": float(value) for name, value in losses.items()} | {
        "policy/std": std,
        "policy/learning_rate": learning_rate,
        "episode/length_s": curriculum["mean_length"] * DT,
        "curriculum/penalty": curriculum["penalty"],
        "curriculum/kick": curriculum["kick"],
    }
