"""Policies that need no file, for tests of what drives them."""

from __future__ import annotations

import numpy as np

from asimov_gym.evaluation.rows import Command, Push
from asimov_gym.evaluation.scenario import Conditions, Scenario, Trial
from asimov_gym.policy import PolicyContract, default_contract

FIXED = Conditions(delay=0.0)


class Statue:
    """Always asks for the standing pose."""

    name = "statue"
    sha256 = "0" * 64

    def __init__(self, contract: PolicyContract | None = None) -> None:
        self.contract = contract or default_contract()

    def infer(self, observation: np.ndarray) -> np.ndarray:
        return np.zeros((*observation.shape[:-1], 23), dtype=np.float32)


class Spy(Statue):
    """A statue that keeps what it saw."""

    def __init__(self) -> None:
        super().__init__()
        self.seen: list[np.ndarray] = []

    def infer(self, observation: np.ndarray) -> np.ndarray:
        self.seen.append(observation.copy())
        return super().infer(observation)


def trials(
    seconds: float,
    command: tuple[float, float, float] = (0.0, 0.0, 0.0),
    *,
    pushes: tuple[Push, ...] = (),
    conditions: Conditions = FIXED,
    repeats: int = 1,
    name: str = "test/walk",
) -> list[Trial]:
    """The repeats of one scenario, suite seed 0."""
    scenario = Scenario(
        id=name,
        config=name.split("/")[0],
        duration_s=seconds,
        commands=(Command(0.0, *command),),
        pushes=pushes,
        conditions=conditions,
        repeats=repeats,
    )
    return [Trial.of(scenario, repeat, 0) for repeat in range(repeats)]
