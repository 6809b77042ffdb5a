"""The state of functional environments, in the form that Brax's wrappers and learners expect."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from asimov_gym.physics.functional.engine import register


@dataclass(frozen=True)
class EnvState:
    """N environments after a step. Without a batch (one key given to `reset`), the first axis is missing everywhere."""

    pipeline_state: Any
    """Physics and task: everything the next step depends on but the random key."""
    obs: dict[str, Any]
    """`state` for the actor (N, n), `privileged_state` for the critic (N, m), float32."""
    reward: Any
    """(N,) float32."""
    done: Any
    """1 where an episode ended in the step, (N,) float32."""
    metrics: dict[str, Any]
    """Figures to average over episodes, (N,) float32."""
    info: dict[str, Any]
    """Everything else; see `FunctionalEnv`."""

    def replace(self, **changes: Any) -> EnvState:
        """The state with some fields changed."""
        return replace(self, **changes)


register(EnvState)
