"""What the tests of the environments share: one way to make each of them, and a policy that only stands."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from asimov_gym.policy import PolicyContract, default_contract


class StandingPolicy:
    """In place of a walking network: the standing pose, whatever it sees."""

    def __init__(self) -> None:
        self.contract: PolicyContract = default_contract()

    def infer(self, observation: np.ndarray) -> np.ndarray:
        return np.zeros((len(observation), len(self.contract.joint_names)), dtype=np.float32)


@pytest.fixture
def policy() -> StandingPolicy:
    return StandingPolicy()


@pytest.fixture(params=["Asimov-Walk-v0", "Asimov-Trajectory-v0", "Asimov-Velocity-v0"])
def env_id(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture
def arguments(env_id: str, policy: StandingPolicy) -> dict[str, Any]:
    """What has to be said to make `env_id` where no policy is shipped."""
    return {"policy": policy} if env_id == "Asimov-Velocity-v0" else {}
