"""What the walking task trains is what the driver does: the same observations and, without delay, the same targets."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from asimov_gym.physics import Reading
from asimov_gym.policy import PolicyDriver, default_contract, load_policy
from asimov_gym.robot.joints import STAND_POSITION
from asimov_gym.tasks.walk import WalkTask
from asimov_gym.tasks.walk.config import WalkConfig
from asimov_gym.tasks.walk.state import RESET_DRAWS

N, STEPS = 4, 60


def readings(steps: int, n: int) -> list[Reading]:
    rng = np.random.default_rng(5)
    still = {"base_quat": np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)), "joint_torque": np.zeros((n, 25))}
    still |= {name: np.zeros((n, 3)) for name in ("base_position", "base_velocity")}
    still |= {f"foot_{name}": np.zeros((n, 2, 3)) for name in ("position", "velocity", "up", "force")}
    return [
        Reading(
            gyro=rng.normal(0.0, 0.5, (n, 3)),
            gravity=np.array([0.0, 0.0, -1.0]) + rng.normal(0.0, 0.05, (n, 3)),
            joint_position=STAND_POSITION + rng.normal(0.0, 0.1, (n, 25)),
            joint_velocity=rng.normal(0.0, 1.0, (n, 25)),
            **still,
        )
        for _ in range(steps)
    ]


@pytest.mark.parametrize("layout", ["asimov-80", "asimov-78"])
def test_driver_does_what_the_task_trains(layout: str, tmp_path, toy) -> None:
    config = WalkConfig(layout=layout)
    task = WalkTask(config)
    contract = default_contract(
        layout,
        action_scale=config.action_scale,
        action_clip=config.action_clip,
        gait_frequency_hz=config.gait_frequency_hz,
        standing_threshold=config.standing_threshold,
        command_ranges=(config.command.vx, config.command.vy, config.command.wz),
    )
    network = toy(80 if layout == "asimov-80" else 78)
    policy = load_policy(network.save(tmp_path / "policy.onnx", contract.to_metadata()))
    driver = PolicyDriver(policy, copies=N)
    state = task.initial_state(np.random.default_rng(6).random((N, RESET_DRAWS)))
    state = replace(state, delay=np.zeros(N, dtype=int), joint_zero=np.zeros((N, 25)))
    commands = np.zeros((2, N, 3))
    commands[0] = np.random.default_rng(7).uniform((-0.6, -0.4, -0.8), (0.8, 0.4, 0.8), (N, 3))
    driver.reset(phase=state.phase)
    for k, reading in enumerate(readings(STEPS, N)):
        # Walk, stand for a while, walk on: the clock must rest and go on alike.
        command = commands[int(STEPS // 3 <= k < STEPS // 2)]
        state = replace(state, command=command, command_left=np.full(N, 10_000))
        seen = task.observe(state, reading)
        state = task.push_action(state, task.clip_action(policy.infer(seen)))
        answer = driver.step(reading.gyro, reading.gravity, command, reading.joint_position, reading.joint_velocity)
        np.testing.assert_array_equal(driver.observation, seen)
        np.testing.assert_allclose(answer, task.targets(state)[:, 0], atol=1e-6)
        state = task.advance(state, np.zeros((N, 6)))
