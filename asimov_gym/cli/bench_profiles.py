"""`asimov bench profiles`: what each part of the evaluation physics costs, from that of the training on."""

from __future__ import annotations

import sys
import time
from collections.abc import Generator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING

import numpy as np

from asimov_gym.cli.bench_env import warn_if_busy, write_json
from asimov_gym.cli.machine import cores

if TYPE_CHECKING:
    from asimov_gym.physics import PhysicsProfile

SETTLE_STEPS = 100
"""Policy steps before anything is measured: the robots have begun to walk."""
COMMAND = (0.4, 0.0, 0.3)
"""What they follow: vx, vy (m/s) and yaw rate (rad/s)."""


@dataclass(frozen=True)
class ProfileSpeed:
    """The bare physics under a profile, robots walking with the shipped policy; medians over the rounds."""

    profile: str
    steps_per_s: float
    """Policy steps of one robot per second of physics."""
    slower: float
    """Times the cost of the training profile, measured in turn with it."""
    spread: float
    """Largest less smallest of these ratios."""


@dataclass(frozen=True)
class BenchProfiles:
    """Measure the bare physics under the training profile, and with one part of the evaluation profile after the other
    added to it.

    Exit code 0 when it was measured, 2 when it could not be tried.
    """

    copies: int = 256
    """Robots simulated together."""
    threads: int | None = None
    """Physics threads; one for each core by default."""
    steps: int = 10
    """Policy steps of a round."""
    rounds: int = 7
    """Rounds that are measured of each profile, in turn."""
    json: Path | None = None
    """Write the figures and what machine this is to this file, or into this folder under the machine's name."""

    def run(self) -> int:
        """Measure, print a table."""
        for name in ("copies", "threads", "steps", "rounds"):
            value = getattr(self, name)
            if value is not None and value < 1:
                print(f"asimov bench profiles: --{name} must be at least 1, got {value}", file=sys.stderr)
                return 2
        load = warn_if_busy("profiles")
        speeds = self.speeds()
        _print(speeds, self.copies)
        settings = {"copies": self.copies, "threads": self.threads or cores(), "steps": self.steps}
        write_json(self.json, "profiles", load, settings, {"profiles": [asdict(speed) for speed in speeds]})
        return 0

    def speeds(self) -> list[ProfileSpeed]:
        """Measure every profile of `ladder`."""
        walkers = {name: _walk(profile, self.copies, self.threads) for name, profile in ladder().items()}
        for walker in walkers.values():
            for _ in range(SETTLE_STEPS):
                next(walker)
        rounds = [
            {name: sum(next(walker) for _ in range(self.steps)) for name, walker in walkers.items()}
            for _ in range(self.rounds)
        ]
        (first, *_) = walkers
        speeds = []
        for name in walkers:
            ratios = [times[name] / times[first] for times in rounds]
            per_s = median(self.copies * self.steps / times[name] for times in rounds)
            speeds.append(ProfileSpeed(name, per_s, median(ratios), max(ratios) - min(ratios)))
        for walker in walkers.values():
            walker.close()
        return speeds


def ladder() -> dict[str, PhysicsProfile]:
    """Profiles from that of the training to that of the evaluation, each with one part more."""
    from asimov_gym.physics import PROFILES

    last = PROFILES["evaluation"]
    profile, steps = PROFILES["training"], {"training": PROFILES["training"]}
    for words, fields in (
        ("+ dry joint friction", ("dry_friction",)),
        ("+ solver to its end", ("iterations", "ls_iterations")),
        ("+ elliptic cone", ("elliptic", "impratio")),
        ("+ noslip iterations", ("noslip_iterations",)),
        ("+ all bodies collide: evaluation", ("bodies_collide",)),
    ):
        profile = replace(profile, **{field: getattr(last, field) for field in fields})
        steps[words] = profile
    return steps


def _walk(profile: PhysicsProfile, copies: int, threads: int | None) -> Generator[float, None, None]:
    """Robots that walk for ever under a profile; yields what the physics took for each policy step, s."""
    from asimov_gym.assets import asset_path
    from asimov_gym.physics import DECIMATION, CPhysics, JointTarget
    from asimov_gym.policy import PolicyDriver, load_policy

    driver = PolicyDriver(load_policy(asset_path("policies", "asimov_walk.onnx")), copies)
    physics = CPhysics(copies, profile, threads)
    command, reading = np.tile(COMMAND, (copies, 1)), physics.read()
    try:
        while True:
            target = driver.step(reading.gyro, reading.gravity, command, reading.joint_position, reading.joint_velocity)
            began = time.perf_counter()
            reading = physics.step(JointTarget(target), DECIMATION)
            yield time.perf_counter() - began
    finally:
        physics.close()


def _print(speeds: list[ProfileSpeed], copies: int) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(box=None, pad_edge=False, title=f"Bare physics, {copies} copies", title_justify="left")
    for heading in ("profile", "steps/s", "cost", ""):
        table.add_column(heading, justify="left" if heading == "profile" else "right")
    for speed in speeds:
        table.add_row(speed.profile, f"{speed.steps_per_s:,.0f}", f"x {speed.slower:.2f}", f"± {speed.spread / 2:.2f}")
    Console().print(table)
