"""Settings of the waypoint task, checked on construction."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from asimov_gym.presets import check_interval, check_range, check_weights

DEFAULT_REWARDS: Mapping[str, float] = {
    "progress": 1.0,
    "reached": 2.0,
    "fall": -5.0,
    "time": -0.01,
    "command_rate": -0.02,
}
"""Weights per step of 0.1 s; `progress` is per metre, `reached` per waypoint."""


@dataclass(frozen=True)
class VelocityConfig:
    """The waypoint task: visit points in order by commanding a walking policy at 10 Hz."""

    waypoints: int = 4
    """How many points there are to visit."""
    distance: tuple[float, float] = (1.0, 2.5)
    """Length of a leg, from one waypoint to the next, m."""
    turn: float = 1.2
    """Largest change of direction from leg to leg, to either side, rad; the first one is against the robot's
    heading."""
    reach: float = 0.25
    """A waypoint is reached within this distance of the pelvis, m."""
    episode_s: float = 60.0
    rewards: Mapping[str, float] = field(default_factory=lambda: dict(DEFAULT_REWARDS))
    """Weight of each reward term."""

    def __post_init__(self) -> None:
        if isinstance(self.waypoints, bool) or not isinstance(self.waypoints, int) or not 1 <= self.waypoints <= 100:
            raise ValueError(f"waypoints must be a whole number in [1, 100], got {self.waypoints!r}")
        check_interval("distance", self.distance, 0.1, 20.0)
        check_range("turn", self.turn, 0.0, 3.1416)
        check_range("reach", self.reach, 0.05, 2.0)
        check_range("episode_s", self.episode_s, 0.5, 1e6)
        from asimov_gym.tasks.velocity.rewards import TERMS

        check_weights("rewards", self.rewards, TERMS)
