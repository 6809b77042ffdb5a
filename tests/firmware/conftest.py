"""A robot on a step clock, and networks small enough to reason about."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from asimov_gym.firmware import MICROSECONDS, Firmware, FirmwareConfig, FirmwareState, GantryConfig, StepClock
from asimov_gym.physics import CPhysics
from asimov_gym.policy import default_contract

STEP_US = 5_000


class StandInPolicy:
    """A network that always answers the same; zero asks for the standing pose. Keeps what it saw."""

    def __init__(self) -> None:
        self.contract = default_contract(gait_frequency_hz=1.5, command_ranges=((-0.6, 0.8), (-0.4, 0.4), (-0.8, 0.8)))
        self.action = np.zeros(23, dtype=np.float32)
        self.seen: list[np.ndarray] = []
        self.error: Exception | None = None

    def infer(self, observation: np.ndarray) -> np.ndarray:
        self.seen.append(observation[0].copy())
        if self.error is not None:
            raise self.error
        return np.tile(self.action, (len(observation), 1))


class Bench:
    """Firmware, physics and clock, advanced together."""

    def __init__(self, gantry: str, policy: StandInPolicy | None, config: FirmwareConfig) -> None:
        self.clock = StepClock()
        self.physics = CPhysics(1, "evaluation")
        self.policy = policy
        config = replace(config, gantry=replace(config.gantry, mode=gantry))
        self.firmware = Firmware(self.physics, self.clock, policy, config)

    def run(self, seconds: float) -> FirmwareState:
        for _ in range(round(seconds * MICROSECONDS / STEP_US)):
            self.clock.advance(STEP_US)
            self.firmware.tick()
        return self.firmware.snapshot

    def pelvis_height(self) -> float:
        return float(self.physics.read().base_position[0, 2])


@pytest.fixture
def policy() -> StandInPolicy:
    return StandInPolicy()


@pytest.fixture
def make_bench(policy: StandInPolicy) -> Callable[..., Bench]:
    def make(
        gantry: str = "auto", with_policy: bool = True, gantry_config: GantryConfig | None = None, **config: object
    ) -> Bench:
        figures = FirmwareConfig(gantry=gantry_config or GantryConfig(), **config)  # type: ignore[arg-type]
        return Bench(gantry, policy if with_policy else None, figures)

    return make


@pytest.fixture
def bench(make_bench: Callable[..., Bench]) -> Bench:
    return make_bench()


@pytest.fixture
def held(make_bench: Callable[..., Bench]) -> Bench:
    """A robot whose rope never slackens: it can be posed at will."""
    return make_bench("hold")
