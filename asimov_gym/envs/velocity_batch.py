"""A batch of robots that walk by a policy and are steered by velocity commands, on C physics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from asimov_gym.assets import asset_path
from asimov_gym.envs.batch import BatchStep, Info
from asimov_gym.envs.spaces import velocity_spaces
from asimov_gym.envs.streams import CopyStreams
from asimov_gym.physics import DECIMATION, BodyParameters, CPhysics, JointTarget, PhysicsProfile
from asimov_gym.policy import Policy, PolicyDriver, joint_gains, load_policy
from asimov_gym.robot.observation import POLICY_RATE_HZ
from asimov_gym.tasks.velocity import VelocityConfig, VelocityState, VelocityTask
from asimov_gym.tasks.velocity.task import POLICY_STEPS

_SHIPPED = ("policies", "asimov_walk.onnx")


class VelocityBatch:
    """N robots behind the protocol of `asimov_gym.envs.batch`.

    Args:
        copies: N.
        config: the task.
        policy: the walking network: a file, or a loaded one; the shipped one when None.
        profile: physics profile.
        threads: size of the physics thread pool.

    Raises:
        FileNotFoundError: there is no such policy file.
        ValueError: the policy is not one that this robot can walk by.
    """

    option_names: tuple[str, ...] = ()

    def __init__(
        self,
        copies: int,
        config: VelocityConfig | None = None,
        policy: str | Path | Policy | None = None,
        profile: str | PhysicsProfile = "evaluation",
        threads: int | None = None,
    ) -> None:
        self.task = VelocityTask(config)
        self.copies = copies
        runner = _loaded(policy)
        self._driver = PolicyDriver(runner, copies)
        body = BodyParameters.with_gains(*joint_gains(runner.contract), copies)
        self.physics = CPhysics(copies, profile, threads, body)
        self._streams = CopyStreams(range(copies))
        self._standing = self.physics.standing()[0]
        self.state: VelocityState = self.task.initial_state(np.zeros((copies, self.task.start_draws)))[0]
        self.reading = self.physics.read()
        self.observation_space, self.action_space = velocity_spaces()

    def seed(self, seeds: Sequence[int]) -> None:
        self._streams = CopyStreams(seeds)

    def restart(self, which: np.ndarray, options: Mapping[str, Any]) -> tuple[np.ndarray, Info]:
        draws = self._streams.draw(self.task.start_draws, np.flatnonzero(which)).astype(np.float64)
        fresh, heading = self.task.initial_state(draws)
        qpos = np.tile(self._standing, (len(heading), 1))
        qpos[:, 3:7] = 0.0
        qpos[:, 3], qpos[:, 6] = np.cos(0.5 * heading), np.sin(0.5 * heading)
        self.physics.reset(qpos, np.zeros((len(heading), self.physics.model.nv)), copies=which)
        self._driver.reset(which)
        values = {f.name: np.array(getattr(self.state, f.name)) for f in fields(VelocityState)}
        for name, value in values.items():
            value[which] = getattr(fresh, name)
        self.state = replace(self.state, **values)
        self.reading = self.physics.read()
        return self.task.observe(self.state, self.reading), self._info()

    def step(self, action: np.ndarray) -> BatchStep:
        self.state = self.task.push_command(self.state, action.astype(np.float64))
        before = self.reading
        fallen, diverged = np.zeros(self.copies, dtype=bool), np.zeros(self.copies, dtype=bool)
        for _ in range(POLICY_STEPS):
            reading = self.reading
            target = self._driver.step(
                gyro=reading.gyro,
                gravity=reading.gravity,
                command=self.state.command[:, 0],
                joint_position=reading.joint_position,
                joint_velocity=reading.joint_velocity,
            )
            self.reading = self.physics.step(JointTarget(target), DECIMATION)
            diverged |= self.physics.diverged
            fallen |= self.task.fallen(self.reading)
        outcome = self.task.conclude(self.state, before, self.reading, fallen, diverged)
        self.state = outcome.state
        info = self._info() | {
            "applied_command": self._driver.command.astype(np.float32),
            "reward_terms": {name: np.array(share, dtype=np.float32) for name, share in outcome.shares.items()},
            "clipped": (np.abs(action) > self.action_space.high).sum(axis=1),
            "success": self.task.finished(self.state),
            "diverged": diverged,
        }
        observation, reward = self.task.observe(self.state, self.reading), outcome.reward.astype(np.float32)
        return BatchStep(observation, reward, outcome.terminated, outcome.truncated, info)

    def _info(self) -> Info:
        return {
            "waypoints_reached": np.array(self.state.aim),
            "distance": self.task.distance(self.state, self.reading).astype(np.float32),
        }

    def markers(self, copy: int) -> np.ndarray:
        """The waypoints still to visit, just above the ground."""
        ahead = self.state.waypoint[copy, int(self.state.aim[copy]) :]
        return np.concatenate([ahead, np.full((len(ahead), 1), 0.06)], axis=1)

    def close(self) -> None:
        self.physics.close()


def _loaded(policy: str | Path | Policy | None) -> Policy:
    policy = shipped_policy() if policy is None else policy
    return check_policy(load_policy(policy) if isinstance(policy, str | Path) else policy)


def shipped_policy() -> Path:
    """File of the shipped walking policy.

    Raises:
        FileNotFoundError: it is missing; says how to get one.
    """
    try:
        return asset_path(*_SHIPPED)
    except FileNotFoundError as error:
        raise FileNotFoundError(
            f"policy: none was given, and the shipped walking policy is missing. {error} "
            "Train one with `python -m train ppo` and pass policy='.../policy.onnx'."
        ) from error


def check_policy(policy: Any) -> Policy:
    """Raise ValueError unless it is a policy that runs at the robot's rate."""
    if not isinstance(policy, Policy):
        raise ValueError(f"policy must be a path to an ONNX file or a loaded policy, got {policy!r}")
    rate = policy.contract.policy_rate_hz
    if rate != POLICY_RATE_HZ:
        raise ValueError(f"policy: its policy_rate_hz must be {POLICY_RATE_HZ:g}, got {rate!r}")
    return policy
