"""One thing that a policy is asked to do, under stated conditions, and the repeats that it is asked to do it in."""

from __future__ import annotations

import hashlib
import math
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from asimov_gym.evaluation.results import ScenarioInfo
from asimov_gym.evaluation.rows import (
    AXES,
    COMMAND_BOUNDS,
    MAX_DURATION_S,
    MAX_FORCE_N,
    MAX_FRICTION,
    Command,
    Push,
    Row,
    body_names,
)
from asimov_gym.evaluation.variants import variant_named
from asimov_gym.presets import check_range
from asimov_gym.robot.joints import JOINT_NAMES
from asimov_gym.robot.observation import POLICY_RATE_HZ
from asimov_gym.robot.safety_limits import FALL_GRAVITY_Z, FALL_HEIGHT
from asimov_gym.robot.terrain import terrain_named

BY_SEED, DRAWN = "by_seed", "drawn"
DELAY_STEP_MS = 5.0
DELAYS = 6
"""Distinct delays of `by_seed` and `drawn`: 0 to 25 ms."""
MAX_DELAY_MS = 40.0
FOOT_FRICTION = 0.6
"""Of the robot's own soles."""


@dataclass(frozen=True)
class FallRule:
    """When a robot counts as fallen."""

    gravity_z: float
    """Body-frame gravity's z above this: tilted too far."""
    height: float
    """Pelvis above the ground below it, m: lower than this."""


FALL_RULES = {
    "firmware": FallRule(FALL_GRAVITY_Z, FALL_HEIGHT),
    "vendor": FallRule(-math.cos(math.radians(78.5)), 0.35),
}
"""The robot's own rule, a tilt of 60 degrees, and that of its maker's benchmark, 78.5 degrees."""


@dataclass(frozen=True)
class Conditions:
    """Everything about a trial but the commands and pushes. The defaults are the evaluation conditions."""

    delay: float | str = BY_SEED
    """Action delay: in ms, `by_seed` ((seed mod 6) times 5 ms) or `drawn` (0 to 25 ms in steps of 5, from the seed)."""
    noise: float = 0.0
    """Sensor noise and encoder offsets as a multiple of the training's."""
    payload_kg: float = 0.0
    """Added to the torso at its centre of mass."""
    motor_strength: float = 1.0
    """Share of the torque limits that the motors still have."""
    weak_joints: tuple[str, ...] = ()
    """Joints that `motor_strength` acts on; all when empty."""
    foot_friction: float = FOOT_FRICTION
    """Sliding friction of the soles."""
    terrain: str = "flat"
    """See `asimov_gym.robot.terrain`."""
    hold_heading: bool = False
    """The yaw rate command is corrected so that the robot keeps the heading that its commands add up to."""
    initial_joint_error: float = 0.02
    """Half-width of the uniform error of every joint at the start, rad."""
    fall: str = "firmware"
    """One of `FALL_RULES`."""
    physics: str = "evaluation"
    """One of `asimov_gym.evaluation.variants.VARIANTS`."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "weak_joints", tuple(self.weak_joints))
        variant = variant_named(self.physics)
        if isinstance(self.delay, str):
            if self.delay not in (BY_SEED, DRAWN):
                raise ValueError(
                    f"conditions.delay must be {BY_SEED!r}, {DRAWN!r} or 0 to {MAX_DELAY_MS:g} ms, got {self.delay!r}"
                )
        else:
            check_range("conditions.delay", self.delay, 0.0, MAX_DELAY_MS)
            steps = self.delay / (1000.0 * variant.timestep)
            if abs(steps - round(steps)) > 1e-6:
                raise ValueError(
                    f"conditions.delay must be whole physics steps of {1000.0 * variant.timestep:g} ms, "
                    f"got {self.delay!r} ms"
                )
        check_range("conditions.noise", self.noise, 0.0, 10.0)
        check_range("conditions.payload_kg", self.payload_kg, -5.0, 20.0)
        check_range("conditions.motor_strength", self.motor_strength, 0.05, 1.0)
        unknown = sorted(set(self.weak_joints) - set(JOINT_NAMES))
        if unknown:
            raise ValueError(f"conditions.weak_joints has unknown joints {unknown}; known: {', '.join(JOINT_NAMES)}")
        if self.weak_joints and self.motor_strength == 1.0:
            raise ValueError("conditions.weak_joints needs a motor_strength below 1, got 1")
        check_range("conditions.foot_friction", self.foot_friction, 1e-3, MAX_FRICTION)
        check_range("conditions.initial_joint_error", self.initial_joint_error, 0.0, 0.3)
        if self.fall not in FALL_RULES:
            raise ValueError(f"conditions.fall must be one of {', '.join(FALL_RULES)}, got {self.fall!r}")
        terrain_named(self.terrain)
        if variant.engine != "c" and (self.terrain != "flat" or self.motor_strength != 1.0):
            raise ValueError(
                f"conditions.physics {self.physics!r} takes flat terrain and full motor_strength, "
                f"got {self.terrain!r} and {self.motor_strength:g}"
            )


@dataclass(frozen=True)
class Scenario:
    """Velocity commands and pushes under conditions, in some repeats."""

    id: str
    """`<config>/<name>`."""
    config: str
    """Category, as `grid` or `push_standing`."""
    duration_s: float
    commands: tuple[Command, ...]
    pushes: tuple[Push, ...] = ()
    conditions: Conditions = field(default_factory=Conditions)
    repeats: int = 5
    limits: tuple[tuple[str, tuple[float, float]], ...] = ()
    """Range of commands by axis, taken instead of the one that the policy was trained for."""
    gait_symmetry: bool = False
    """Straight steady walking, of which the symmetry of the gait means something."""
    stand_at_s: float | None = None
    """From then on the mode STAND has the joints, as in the firmware, on the ground and without a gantry; the policy is
    asked no more. None: it has them to the end."""
    description: str = ""

    def __post_init__(self) -> None:
        if self.id.split("/")[0] != self.config or self.id.count("/") != 1 or self.id.endswith("/"):
            raise ValueError(f"scenario id must read '{self.config}/<name>', got {self.id!r}")
        check_range(f"{self.id}: duration_s", self.duration_s, 1.0 / POLICY_RATE_HZ, MAX_DURATION_S)
        if isinstance(self.repeats, bool) or not isinstance(self.repeats, int) or not 1 <= self.repeats <= 10_000:
            raise ValueError(f"{self.id}: repeats must be a whole number from 1 to 10000, got {self.repeats!r}")
        if not self.commands:
            raise ValueError(f"{self.id}: commands must hold at least one command")
        for command in self.commands:
            check_range(f"{self.id}: command t", command.t, 0.0, self.duration_s)
            for axis in AXES:
                check_range(f"{self.id}: {axis}", getattr(command, axis), -COMMAND_BOUNDS[axis], COMMAND_BOUNDS[axis])
        if self.stand_at_s is not None:
            step = 1.0 / POLICY_RATE_HZ
            check_range(f"{self.id}: stand_at_s", self.stand_at_s, step, self.duration_s - step)
            late = [command.t for command in self.commands if command.t >= self.stand_at_s]
            if late:
                raise ValueError(
                    f"{self.id}: commands must come before stand_at_s {self.stand_at_s:g}, got {late[0]:g}"
                )
        for push in self.pushes:
            if push.body not in body_names():
                raise ValueError(f"{self.id}: push on unknown body {push.body!r}; known: {', '.join(body_names())}")
            check_range(f"{self.id}: push force", push.force, 0.0, MAX_FORCE_N)
            check_range(f"{self.id}: push t", push.t, 0.0, self.duration_s)
            check_range(f"{self.id}: push end", push.t + push.duration, push.t, self.duration_s + 1e-9)
        if self.pushes and variant_named(self.conditions.physics).engine != "c":
            raise ValueError(f"{self.id}: pushes need physics on the C engine, got {self.conditions.physics!r}")

    @property
    def steps(self) -> int:
        """Policy steps."""
        return max(1, round(self.duration_s * POLICY_RATE_HZ))

    @property
    def stand_step(self) -> int:
        """First policy step that STAND has; `steps` where the policy has all."""
        return self.steps if self.stand_at_s is None else math.ceil(self.stand_at_s * POLICY_RATE_HZ - 1e-6)

    @property
    def stands(self) -> bool:
        """Whether every command is zero."""
        return all((c.vx, c.vy, c.wz) == (0.0, 0.0, 0.0) for c in self.commands)

    def command_rows(self) -> np.ndarray:
        """The command of each policy step: vx, vy (m/s), yaw rate (rad/s), (steps, 3); zero before the first one."""
        rows = np.zeros((self.steps, 3))
        for command in self.commands:
            # A command that comes between two policy steps acts from the later one.
            rows[math.ceil(command.t * POLICY_RATE_HZ - 1e-6) :] = (command.vx, command.vy, command.wz)
        rows[self.stand_step :] = 0.0
        return rows

    def info(self) -> ScenarioInfo:
        """What is written into a result."""
        conditions: dict[str, Any] = {
            k: list(v) if isinstance(v, tuple) else v for k, v in asdict(self.conditions).items()
        }
        conditions["limits"] = {axis: list(pair) for axis, pair in self.limits} or None
        return ScenarioInfo(
            id=self.id,
            config=self.config,
            description=self.description,
            duration_s=self.duration_s,
            commands=tuple((c.t, c.vx, c.vy, c.wz) for c in self.commands),
            conditions=conditions,
            repeats=self.repeats,
            stand_at_s=self.stand_at_s,
        )


def scenario_of_row(row: Row, conditions: Conditions | None = None, repeats: int = 5) -> Scenario:
    """A row of the benchmark as a scenario.

    Args:
        row: the row; its friction and terrain replace those of the conditions.
        conditions: everything else; the benchmark's own when omitted (delay drawn, its fall rule).
        repeats: of the row.

    Raises:
        ValueError: the row's terrain is unknown.
    """
    conditions = conditions or Conditions(delay=DRAWN, fall="vendor")
    if row.foot_friction is not None:
        conditions = replace(conditions, foot_friction=row.foot_friction)
    if row.terrain is not None:
        conditions = replace(conditions, terrain=row.terrain)
    return Scenario(
        id=row.id,
        config=row.config,
        duration_s=row.duration,
        commands=row.commands,
        pushes=row.events,
        conditions=conditions,
        repeats=repeats,
        limits=row.limits,
        gait_symmetry=row.gait_symmetry,
        description=row.description or row.name,
    )


@dataclass(frozen=True)
class Trial:
    """One repeat of a scenario. All that is random in it follows from `seed`."""

    scenario: Scenario
    repeat: int
    seed: int

    @classmethod
    def of(cls, scenario: Scenario, repeat: int, suite_seed: int) -> Trial:
        """The trial whose seed is that of suite seed, scenario and repeat."""
        return cls(scenario, repeat, trial_seed(suite_seed, scenario.id, repeat))

    @property
    def delay_ms(self) -> float:
        """Action delay."""
        delay = self.scenario.conditions.delay
        if delay == BY_SEED:
            return (self.seed % DELAYS) * DELAY_STEP_MS
        if delay == DRAWN:
            return int(self.generator("delay").integers(DELAYS)) * DELAY_STEP_MS
        return float(delay)

    def generator(self, use: str) -> np.random.Generator:
        """Random numbers for one use; those of another use do not depend on how many were drawn."""
        return np.random.default_rng([self.seed, int.from_bytes(use.encode()[:8], "big")])


def trial_seed(suite_seed: int, scenario: str, repeat: int) -> int:
    """A seed that is the same on every machine, below 2^53 so that JSON keeps it.

    Its remainder by 6 is the repeat's, so that the delays of `by_seed` are spread evenly over the repeats.
    """
    digest = hashlib.blake2b(f"{suite_seed}/{scenario}/{repeat}".encode(), digest_size=6).digest()
    return int.from_bytes(digest, "big") * DELAYS + repeat % DELAYS
