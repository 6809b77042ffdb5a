"""Levels of difficulty that grow while episodes last, as pure functions over the array-API standard."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from asimov_gym.robot.array_library import namespace
from asimov_gym.tasks.walk.config import CurriculumConfig


@dataclass(frozen=True)
class Levels:
    """Where a batch stands in its curriculum: floating-point arrays of one shape, scalars or one entry per copy."""

    penalty: Any
    """Factor on the penalties, up to 1."""
    kick: Any
    """Place of the kicks between their first and last strength, 0 to 1."""
    mean_length: Any
    """Running mean of the length of finished episodes, policy steps."""


def after_episodes(levels: Levels, steps: Any, done: Any) -> Levels:
    """Levels after a step in which some episodes ended.

    The mean moves by the share of the copies that finished: it looks back over about one episode of each.

    Args:
        levels: before.
        steps: how long each copy's episode has lasted, policy steps, (N,).
        done: copies whose episode ended, (N,) bool.
    """
    xp = namespace(done)
    real = levels.mean_length.dtype
    count = xp.sum(xp.astype(done, real))
    lengths = xp.sum(xp.where(done, xp.astype(steps, real), xp.zeros(done.shape, dtype=real)))
    finished = lengths / xp.clip(count, 1.0, None)
    return replace(levels, mean_length=levels.mean_length + (finished - levels.mean_length) * (count / done.shape[0]))


def grown(levels: Levels, config: CurriculumConfig) -> Levels:
    """Levels one policy step later: penalties grow while episodes last, then kicks."""
    xp = namespace(levels.penalty)
    lasting = levels.mean_length >= config.long_episode_steps
    harder = xp.clip(levels.penalty * (1.0 + config.penalty_growth), None, 1.0)
    penalty = xp.where(lasting, harder, levels.penalty)
    stronger = xp.clip(levels.kick + config.kick_growth, None, 1.0)
    return replace(levels, penalty=penalty, kick=xp.where(lasting & (penalty >= 1.0), stronger, levels.kick))
