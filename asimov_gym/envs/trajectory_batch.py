"""A batch of robots that follow reference motions, on C physics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from typing import Any

import mujoco
import numpy as np

from asimov_gym.envs.batch import BatchStep, Info
from asimov_gym.envs.spaces import trajectory_spaces
from asimov_gym.envs.streams import CopyStreams
from asimov_gym.physics import DECIMATION, CPhysics, PhysicsProfile, Reading
from asimov_gym.robot.feet import SOLE_DEPTH
from asimov_gym.robot.joints import JOINT_NAMES
from asimov_gym.tasks.trajectory import TrajectoryConfig, TrajectoryState, TrajectoryTask, telemetry
from asimov_gym.tasks.trajectory.task import DT, START_DRAWS

_US = round(1e6 * DT)
"""A control step in microseconds."""


class TrajectoryBatch:
    """N robots behind the protocol of `asimov_gym.envs.batch`.

    Args:
        copies: N.
        config: the task.
        profile: physics profile.
        threads: size of the physics thread pool.
    """

    option_names: tuple[str, ...] = ()

    def __init__(
        self,
        copies: int,
        config: TrajectoryConfig | None = None,
        profile: str | PhysicsProfile = "evaluation",
        threads: int | None = None,
    ) -> None:
        self.task = TrajectoryTask(config)
        self.copies = copies
        self.physics = CPhysics(copies, profile, threads)
        self._streams = CopyStreams(range(copies))
        self._height = standing_height(self.physics.model, self._pose(self.task.motion.frames[:1]))
        self.state: TrajectoryState = self.task.initial_state(np.zeros((copies, len(JOINT_NAMES))))
        self.observation_space, self.action_space = trajectory_spaces(self.task)

    def _pose(self, joints: np.ndarray) -> np.ndarray:
        """Generalised positions (nq,) of an upright robot at the origin in a pose (1, 25)."""
        return self.physics.configuration(joints, np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0, 0.0]]))[0]

    def seed(self, seeds: Sequence[int]) -> None:
        self._streams = CopyStreams(seeds)

    def restart(self, which: np.ndarray, options: Mapping[str, Any]) -> tuple[dict[str, np.ndarray], Info]:
        joints, heading = self.task.initial_pose(
            self._streams.draw(START_DRAWS, np.flatnonzero(which)).astype(np.float64)
        )
        count = len(joints)
        position, quat = np.zeros((count, 3)), np.zeros((count, 4))
        position[:, 2] = self._height
        quat[:, 0], quat[:, 3] = np.cos(0.5 * heading), np.sin(0.5 * heading)
        velocity = np.zeros((count, self.physics.model.nv))
        self.physics.reset(self.physics.configuration(joints, position, quat), velocity, copies=which)
        fresh = self.task.initial_state(joints)
        values = {f.name: np.array(getattr(self.state, f.name)) for f in fields(TrajectoryState)}
        for name, value in values.items():
            value[which] = getattr(fresh, name)
        self.state = replace(self.state, **values)
        reading = self.physics.read()
        return self.task.observe(self.state, reading), self._info(reading)

    def step(self, action: np.ndarray) -> BatchStep:
        target, clipped = self.task.target(action.astype(np.float64))
        reading = self.physics.step(target, DECIMATION)
        diverged = self.physics.diverged.copy()
        outcome = self.task.conclude(self.state, target, reading, diverged)
        self.state = outcome.state
        info = self._info(reading) | {
            "reward_terms": {name: np.array(share, dtype=np.float32) for name, share in outcome.shares.items()},
            "clipped": clipped,
            "diverged": diverged,
        }
        observation, reward = self.task.observe(self.state, reading), outcome.reward.astype(np.float32)
        return BatchStep(observation, reward, outcome.terminated, outcome.truncated, info)

    def _info(self, reading: Reading) -> Info:
        fallen = self.task.fallen(reading)
        alerts = np.empty(self.copies, dtype=object)
        for copy in range(self.copies):
            alerts[copy] = telemetry.active_alerts(bool(fallen[copy]), self.state.temperature[copy])
        clock = self.state.step * _US
        return {
            "timestamp_us": clock,
            "fw_timestamp_us": clock.copy(),
            "sequence": np.array(self.state.step),
            "fw_age_ms": np.zeros_like(clock),
            "active_alerts": alerts,
        }

    def markers(self, copy: int) -> np.ndarray:
        return np.empty((0, 3))

    def close(self) -> None:
        self.physics.close()


def standing_height(model: mujoco.MjModel, qpos: np.ndarray) -> float:
    """Height of the pelvis, m, at which the lower foot of a robot in a pose (nq,) at the origin touches the ground."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    feet = [data.sensor(f"{side}_foot_position").data[2] for side in ("left", "right")]
    return SOLE_DEPTH - float(min(feet))
