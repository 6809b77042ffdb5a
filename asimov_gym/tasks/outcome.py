"""What a control step comes to, for every task: reward, and which episodes end."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from asimov_gym.robot.array_library import namespace


@dataclass(frozen=True)
class Outcome:
    """A step of N copies, before any of them starts anew."""

    state: Any
    """The task's state after the step."""
    reward: Any
    """(N,); zero where the simulation diverged."""
    shares: Mapping[str, Any]
    """Each reward term's weighted value, (N,)."""
    terminated: Any
    """The episode came to its end, or the simulation diverged, (N,) bool."""
    truncated: Any
    """Out of time, (N,) bool; never together with `terminated`."""


def settle(
    state: Any, reward: Any, shares: Mapping[str, Any], ended: Any, diverged: Any, episode_steps: int
) -> Outcome:
    """Outcome of a step.

    Args:
        state: of the task after the step; its `step` counts the episode's steps, (N,) int.
        reward: (N,).
        shares: of the reward's terms.
        ended: copies whose episode has come to its end, (N,) bool.
        diverged: copies whose simulation broke down, (N,) bool; their reward means nothing.
        episode_steps: steps after which an episode is out of time.
    """
    xp = namespace(reward)
    terminated = ended | diverged
    return Outcome(
        state=state,
        reward=xp.where(diverged, xp.zeros_like(reward), reward),
        shares=shares,
        terminated=terminated,
        truncated=(state.step >= episode_steps) & ~terminated,
    )
