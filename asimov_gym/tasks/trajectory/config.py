"""Settings of the trajectory task, checked on construction."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from asimov_gym.presets import check_range, check_weights
from asimov_gym.robot.ankle import FORMS, Form

DEFAULT_REWARDS: Mapping[str, float] = {
    "track_position": 2.0,
    "track_velocity": 0.5,
    "upright": 0.5,
    "alive": 0.5,
    "target_rate": -0.2,
    "effort": -0.2,
}
"""Weights per second."""


@dataclass(frozen=True)
class TrajectoryConfig:
    """The trajectory task: follow a reference motion with direct joint targets at 50 Hz."""

    motion: str = "squat"
    """Name of a shipped motion, or path to a YAML file of keyframes or an NPZ file of samples; it repeats until the
    episode ends."""
    episode_s: float = 12.0
    ahead: tuple[int, ...] = (0, 1, 5, 10, 25)
    """Which reference targets are observed, in steps of 20 ms from now; the one at 1 is where the next step should
    end."""
    gains: bool = False
    """Whether actions carry position and damping gains."""
    ankle: Form = "linear"
    """Form of the ankle linkage between motors and joints."""
    start_noise: float = 0.02
    """Half-width of the disturbance of the joints at the start, rad."""
    rewards: Mapping[str, float] = field(default_factory=lambda: dict(DEFAULT_REWARDS))
    """Weight of each reward term."""

    def __post_init__(self) -> None:
        check_range("episode_s", self.episode_s, 0.1, 1e6)
        if not self.ahead or any(
            isinstance(k, bool) or not isinstance(k, int) or not 0 <= k <= 500 for k in self.ahead
        ):
            raise ValueError(f"ahead must be whole numbers in [0, 500], at least one, got {self.ahead!r}")
        if not isinstance(self.gains, bool):
            raise ValueError(f"gains must be True or False, got {self.gains!r}")
        if self.ankle not in FORMS:
            raise ValueError(f"ankle must be one of {', '.join(FORMS)}, got {self.ankle!r}")
        check_range("start_noise", self.start_noise, 0.0, 0.2)
        from asimov_gym.tasks.trajectory.rewards import TERMS

        check_weights("rewards", self.rewards, TERMS)
