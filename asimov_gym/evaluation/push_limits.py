"""The largest push that a policy survives, by body, direction and speed, found by bisection.

That a robot which survives a push survives every smaller one is assumed, not checked.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

from asimov_gym.evaluation.results import PushLimit
from asimov_gym.evaluation.rows import MAX_FORCE_N, Command, Push, body_names
from asimov_gym.evaluation.scenario import Conditions, Scenario
from asimov_gym.presets import check_range

PUSH_AT_S = 2.0
PUSH_S = 0.15
"""As in the robot maker's benchmark."""
AFTER_S = 4.0
"""A robot that is up so long after the push has survived it."""
CONFIG = "push_limit"


@dataclass(frozen=True)
class PushLimitSearch:
    """What is pushed, from where, and how finely the limit is sought."""

    body: str
    direction_deg: float
    """About the vertical: 0 pushes to the front, 90 to the left."""
    speed: float
    """Forward command, m/s; 0 stands."""
    repeats: int = 3
    """All must survive."""
    conditions: Conditions = field(default_factory=Conditions)
    max_n: float = 1200.0
    """Largest force that is tried."""
    resolution_n: float = 25.0

    def __post_init__(self) -> None:
        if self.body not in body_names():
            raise ValueError(f"push_limits.bodies has unknown body {self.body!r}; known: {', '.join(body_names())}")
        check_range("push_limits.directions_deg", self.direction_deg, -360.0, 360.0)
        check_range("push_limits.resolution_n", self.resolution_n, 1.0, 500.0)
        check_range("push_limits.max_n", self.max_n, self.resolution_n, MAX_FORCE_N)
        self.scenario(0.0)  # checks the rest

    @property
    def id(self) -> str:
        """Its scenario's, at every force: the seeds are the same for all forces."""
        return f"{CONFIG}/{self.body}_vx{self.speed:.2f}_{self.direction_deg:g}deg"

    @property
    def direction(self) -> tuple[float, float, float]:
        """World frame, unit vector."""
        angle = math.radians(self.direction_deg)
        return (round(math.cos(angle), 12), round(math.sin(angle), 12), 0.0)

    @property
    def levels(self) -> int:
        """Forces that may be tried, as multiples of the resolution."""
        return int(self.max_n / self.resolution_n + 1e-9)

    @property
    def rounds(self) -> int:
        """Most batches that the search takes."""
        return max(1, math.ceil(math.log2(self.levels + 1)))

    def scenario(self, force: float) -> Scenario:
        """One push of a force, N; none where it is 0."""
        push = Push(PUSH_AT_S, PUSH_S, force, self.direction, self.body)
        return Scenario(
            id=self.id,
            config=CONFIG,
            duration_s=PUSH_AT_S + PUSH_S + AFTER_S,
            commands=(Command(0.0, self.speed, 0.0, 0.0),),
            pushes=(push,) if force > 0.0 else (),
            conditions=self.conditions,
            repeats=self.repeats,
        )


Survives = Callable[[Sequence[tuple[PushLimitSearch, float]]], Sequence[bool]]
"""Whether every repeat of each search survives a force, N."""


@dataclass(frozen=True)
class _Bracket:
    """A limit is at `low` or above, and below `high`, in steps of the resolution. Level 0 is no push."""

    search: PushLimitSearch
    low: int
    high: int
    failed: bool = False
    """Whether the robot fell at `high`; else it is beyond what is tried."""

    @property
    def middle(self) -> int:
        return (self.low + self.high) // 2

    def after(self, level: int, survived: bool) -> _Bracket:
        if survived:
            return replace(self, low=max(self.low, level))
        return replace(self, high=min(self.high, level), low=min(self.low, max(level - 1, 0)), failed=True)

    def limit(self) -> PushLimit:
        s, step = self.search, self.search.resolution_n
        return PushLimit(
            scenario=s.id,
            body=s.body,
            direction=s.direction,
            speed=s.speed,
            largest_survived_n=self.low * step,
            smallest_failed_n=self.high * step if self.failed else None,
            resolution_n=step,
            repeats=s.repeats,
        )


def find_push_limits(searches: Sequence[PushLimitSearch], survives: Survives) -> tuple[PushLimit, ...]:
    """The limits of all searches, a batch of forces at a time.

    Args:
        searches: in any number; each round tries one force for each that is not done, and no push at all in the first.
        survives: tries forces.
    """
    brackets = [_Bracket(search, 0, search.levels + 1) for search in searches]
    up = survives([(search, 0.0) for search in searches]) if searches else []
    brackets = [b if stays else b.after(0, False) for b, stays in zip(brackets, up, strict=True)]
    while open_ := [i for i, b in enumerate(brackets) if b.high - b.low > 1]:
        tried = [(brackets[i].search, brackets[i].middle * brackets[i].search.resolution_n) for i in open_]
        for i, survived in zip(open_, survives(tried), strict=True):
            brackets[i] = brackets[i].after(brackets[i].middle, survived)
    return tuple(bracket.limit() for bracket in brackets)
