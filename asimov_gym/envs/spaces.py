"""Observation and action spaces of one robot at each task."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np

from asimov_gym.robot.joints import JOINT_NAMES, POLICY_JOINT_NAMES
from asimov_gym.tasks.trajectory import TrajectoryTask, telemetry
from asimov_gym.tasks.velocity.task import COMMAND_LIMIT, OBSERVATION_BOUND
from asimov_gym.tasks.walk import WalkTask


def walk_spaces(task: WalkTask) -> tuple[gym.spaces.Box, gym.spaces.Box]:
    """Observation and action of the walking task."""
    bound, clip = task.layout.bounds, np.float32(task.config.action_clip)
    actions = gym.spaces.Box(-clip, clip, (len(POLICY_JOINT_NAMES),), np.float32)
    return gym.spaces.Box(-bound, bound, dtype=np.float32), actions


def trajectory_spaces(task: TrajectoryTask) -> tuple[gym.spaces.Dict, gym.spaces.Box]:
    """Observation and action of the trajectory task; the order of the observation's keys is that of this mapping."""
    config = task.config
    spaces: dict[str, gym.Space[Any]] = {
        name: gym.spaces.Box(f.low.astype(np.float32), f.high.astype(np.float32), dtype=np.float32)
        for name, f in telemetry.measured_fields(config.ankle).items()
    }
    spaces["fw_mode"] = gym.spaces.Discrete(3)
    spaces["error_flags"] = gym.spaces.Box(0, 2**17 - 1, (1,), np.int64)
    spaces["alert_count"] = gym.spaces.Box(0, 1 + 2 * len(JOINT_NAMES), (1,), np.int64)
    low, high = (np.tile(b, (len(config.ahead), 1)).astype(np.float32) for b in task.motor_range.T)
    spaces["reference"] = gym.spaces.Box(low - 1e-3, high + 1e-3, dtype=np.float32)
    spaces["phase"] = gym.spaces.Box(-1.0, 1.0, (2,), np.float32)
    low, high = task.action_low.astype(np.float32), task.action_high.astype(np.float32)
    return gym.spaces.Dict(spaces), gym.spaces.Box(low, high, dtype=np.float32)


def velocity_spaces() -> tuple[gym.spaces.Box, gym.spaces.Box]:
    """Observation and action of the waypoint task."""
    bound, limit = OBSERVATION_BOUND.astype(np.float32), COMMAND_LIMIT.astype(np.float32)
    return gym.spaces.Box(-bound, bound, dtype=np.float32), gym.spaces.Box(-limit, limit, dtype=np.float32)
