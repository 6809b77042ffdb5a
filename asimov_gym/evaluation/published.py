"""What the robot's maker reports of its released policy: read from a file of figures, each with its document."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

from asimov_gym.assets import config_path
from asimov_gym.evaluation.metrics import METRICS
from asimov_gym.evaluation.results import Tier
from asimov_gym.evaluation.rows import MAX_FORCE_N, TIERS
from asimov_gym.evaluation.suite import shipped_rows
from asimov_gym.presets import check_interval, check_range, load

SURVIVAL = "survival"
"""A metric of these files besides those of `metrics`: the share of trials without a fall."""


@dataclass(frozen=True)
class Sweep:
    """One series of pushes with rising force."""

    fails: float | None = None
    """First force that felled the robot, N; None where none did."""
    holds: float | None = None
    """Largest force that was tried, N, where none felled it."""

    def __post_init__(self) -> None:
        if (self.fails is None) == (self.holds is None):
            raise ValueError(f"a sweep has either fails or holds, got fails {self.fails!r} and holds {self.holds!r}")
        if self.fails is not None:
            check_range("fails", self.fails, 1.0, MAX_FORCE_N)
        if self.holds is not None:
            check_range("holds", self.holds, 1.0, MAX_FORCE_N)


@dataclass(frozen=True)
class PublishedPush:
    """How hard a push had to be at one place."""

    rows: tuple[str, ...]
    """Rows of the benchmark that push there."""
    sweeps: tuple[Sweep, ...]
    documents: tuple[str, ...]

    def __post_init__(self) -> None:
        _check_rows("rows", self.rows)
        if not self.rows or not self.sweeps:
            raise ValueError("a push needs at least one row and one sweep")
        if unpushed := [row for row in self.rows if not shipped_rows()[row].events]:
            raise ValueError(f"rows must have a push, {', '.join(unpushed)} has none")


@dataclass(frozen=True)
class PublishedCount:
    """So many pushes passed, of so many."""

    what: str
    passed: int
    of: int
    documents: tuple[str, ...]
    tier: Tier | None = None
    """Of the pushes that are meant; any when None."""
    rows: tuple[str, ...] = ()
    """Rows that are meant; all when empty."""
    force: float | None = None
    """N; any when None."""
    same_test: bool = True
    """False where it cannot be said whether ours is better or worse."""
    note: str = ""

    def __post_init__(self) -> None:
        check_range("of", self.of, 1, 100_000)
        check_range("passed", self.passed, 0, self.of)
        if self.tier not in (None, *TIERS):
            raise ValueError(f"tier must be one of {', '.join(TIERS)} or null, got {self.tier!r}")
        _check_rows("rows", self.rows)


@dataclass(frozen=True)
class PublishedFigure:
    """A figure of one walk."""

    what: str
    scenario: str
    """Row of the benchmark."""
    metric: str
    """`SURVIVAL`, or one of `asimov_gym.evaluation.metrics`."""
    low: float
    """Smallest that is reported."""
    high: float
    """Largest."""
    documents: tuple[str, ...]
    relative_to: str | None = None
    """Row whose figure both are multiples of."""
    same_test: bool = True
    """False where it cannot be said whether ours is better or worse."""
    note: str = ""

    def __post_init__(self) -> None:
        _check_rows("scenario", (self.scenario,))
        _check_rows("relative_to", () if self.relative_to is None else (self.relative_to,))
        if self.metric != SURVIVAL and self.metric not in METRICS:
            raise ValueError(f"metric must be {SURVIVAL} or one of {', '.join(METRICS)}, got {self.metric!r}")
        check_range("low", self.low, 0.0, self.high)


@dataclass(frozen=True)
class Published:
    """All that is reported of one policy."""

    policy: str
    repository: str
    """URL."""
    documents: Mapping[str, str]
    """Path in the repository by the name that the figures use."""
    delay_ms: tuple[float, float]
    """Smallest and largest action delay in the sweeps of pushes."""
    trained_delay_ms: tuple[float, float]
    """Smallest and largest that the policy was trained with."""
    pushes: tuple[PublishedPush, ...] = ()
    counts: tuple[PublishedCount, ...] = ()
    figures: tuple[PublishedFigure, ...] = ()

    def __post_init__(self) -> None:
        check_interval("delay_ms", self.delay_ms, 0.0, 1000.0)
        check_interval("trained_delay_ms", self.trained_delay_ms, 0.0, 1000.0)
        for name in ("pushes", "counts", "figures"):
            for place, entry in enumerate(getattr(self, name)):
                if not entry.documents or (unknown := set(entry.documents) - set(self.documents)):
                    raise ValueError(
                        f"{name}[{place}].documents must name some of {', '.join(self.documents)}, "
                        f"got {', '.join(sorted(unknown)) if entry.documents else 'none'}"
                    )


@cache
def published(policy: str = "model_aug_18_1") -> Published:
    """The figures of a policy.

    Raises:
        FileNotFoundError: there are none of that policy.
        ValueError: the file does not hold what it must; names it.
    """
    return load(Published, config_path("suites", "published", f"{policy}.yaml"))


def _check_rows(field: str, rows: tuple[str, ...]) -> None:
    unknown = sorted(set(rows) - set(shipped_rows()))
    if unknown:
        raise ValueError(f"{field} has unknown rows {', '.join(unknown)}; known: {', '.join(shipped_rows())}")
