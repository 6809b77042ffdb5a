"""The waypoint task: state, observation, reward and end of an episode as pure functions of batched arrays."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from asimov_gym.physics import DECIMATION, TIMESTEP, Reading
from asimov_gym.robot import frames
from asimov_gym.robot.array_library import integer, namespace
from asimov_gym.robot.joints import RANGE, STAND_POSITION, VELOCITY_LIMIT
from asimov_gym.robot.safety_limits import has_fallen
from asimov_gym.tasks.outcome import Outcome, settle
from asimov_gym.tasks.velocity import rewards
from asimov_gym.tasks.velocity.config import VelocityConfig

POLICY_STEPS = 5
"""Steps of the walking policy per command: 50 Hz against 10 Hz."""
DT = TIMESTEP * DECIMATION * POLICY_STEPS
"""Time between commands, s."""
COMMAND_LIMIT = np.array([2.0, 1.0, 2.0])
"""Largest vx, vy (m/s) and yaw rate (rad/s) that the robot's interface takes."""
COMMAND_LIMIT.setflags(write=False)
_FAR = 10.0
"""Waypoints further away than this are shown as if they were this far, along each axis, m."""

_GYRO_SCALE, _VELOCITY_SCALE = 0.25, 0.1
_BLOCKS = (
    # name, finite bound of the entries
    ("gyro", np.full(3, 10.0)),
    ("gravity", np.full(3, 1.0)),
    ("joint_position", 2.0 * np.abs(RANGE - STAND_POSITION[:, None]).max(axis=1)),
    ("joint_velocity", 4.0 * _VELOCITY_SCALE * VELOCITY_LIMIT),
    ("waypoint", np.full(2, _FAR)),
    ("command", COMMAND_LIMIT),
)
OBSERVATION_BOUND = np.concatenate([bound for _, bound in _BLOCKS])
"""Symmetric finite bound of each entry of the observation, (61,)."""
OBSERVATION_BOUND.setflags(write=False)
_STOPS = np.cumsum([len(bound) for _, bound in _BLOCKS])
OBSERVATION_SLICES = {
    name: slice(int(stop) - len(bound), int(stop)) for (name, bound), stop in zip(_BLOCKS, _STOPS, strict=True)
}
"""Place of each quantity in the observation."""


@dataclass(frozen=True)
class VelocityState:
    """What the task remembers of each copy."""

    step: Any
    """Commands since the start, (N,)."""
    waypoint: Any
    """World frame, m, (N, W, 2)."""
    aim: Any
    """Which waypoint comes next, (N,) int; W when all are reached."""
    command: Any
    """Commands within the interface's limits, newest first, (N, 2, 3)."""


class VelocityTask:
    """The waypoint task under a configuration."""

    def __init__(self, config: VelocityConfig | None = None) -> None:
        self.config = VelocityConfig() if config is None else config
        self.episode_steps = max(1, round(self.config.episode_s / DT))
        self.start_draws = 1 + 2 * self.config.waypoints
        """Uniform numbers per copy that `initial_state` needs."""

    def initial_state(self, draws: Any) -> tuple[VelocityState, Any]:
        """State of fresh copies that stand at the origin, and their headings (N,), rad, from draws (N, start_draws)."""
        xp = namespace(draws)
        n, c = draws.shape[0], self.config
        heading = math.pi * (2.0 * draws[:, 0] - 1.0)
        turns = c.turn * (2.0 * draws[:, 1 : 1 + c.waypoints] - 1.0)
        lengths = c.distance[0] + (c.distance[1] - c.distance[0]) * draws[:, 1 + c.waypoints :]
        direction = heading[:, None] + xp.cumulative_sum(turns, axis=-1)
        legs = xp.stack([lengths * xp.cos(direction), lengths * xp.sin(direction)], axis=-1)
        state = VelocityState(
            step=xp.zeros(n, dtype=integer(xp)),
            waypoint=xp.cumulative_sum(legs, axis=1),
            aim=xp.zeros(n, dtype=integer(xp)),
            command=xp.zeros((n, 2, 3), dtype=draws.dtype),
        )
        return state, heading

    def push_command(self, state: VelocityState, action: Any) -> VelocityState:
        """State with a new command (N, 3) in front, kept within the interface's limits."""
        xp = namespace(action)
        limit = xp.asarray(COMMAND_LIMIT, dtype=action.dtype)
        command = xp.clip(action, -limit, limit)
        return replace(state, command=xp.stack([command, state.command[:, 0]], axis=1))

    def offset(self, state: VelocityState, reading: Reading) -> Any:
        """From the pelvis to the next waypoint, world frame, m, (N, 2); the last one's when all are reached."""
        xp = namespace(reading.gyro)
        last = self.config.waypoints - 1
        aim = xp.clip(state.aim, 0, last)
        chosen = xp.arange(self.config.waypoints)[None, :] == aim[:, None]
        target = xp.sum(xp.where(chosen[:, :, None], state.waypoint, xp.zeros_like(state.waypoint)), axis=1)
        return target - reading.base_position[:, 0:2]

    def distance(self, state: VelocityState, reading: Reading) -> Any:
        """To the next waypoint, m, (N,)."""
        xp = namespace(reading.gyro)
        offset = self.offset(state, reading)
        return xp.sqrt(xp.sum(offset * offset, axis=-1))

    def advance(
        self, state: VelocityState, before: Reading, after: Reading, fallen: Any
    ) -> tuple[VelocityState, rewards.Advance]:
        """State after a step from one reading to another, and what the step did.

        Args:
            fallen: copies that fell on the way, (N,) bool; they reach nothing.
        """
        distance = self.distance(state, after)
        reached = (distance < self.config.reach) & ~fallen & (state.aim < self.config.waypoints)
        advance = rewards.Advance(
            before=self.distance(state, before),
            after=distance,
            reached=reached,
            fallen=fallen,
            command=state.command,
        )
        xp = namespace(distance)
        return replace(state, step=state.step + 1, aim=state.aim + xp.astype(reached, state.aim.dtype)), advance

    def conclude(self, state: VelocityState, before: Reading, after: Reading, fallen: Any, diverged: Any) -> Outcome:
        """Outcome of a step from one reading to another.

        Args:
            state: during the step, with its command in front.
            before: at its start.
            after: at its end.
            fallen: copies that fell on the way, (N,) bool.
            diverged: copies whose simulation broke down on the way, (N,) bool.
        """
        state, advance = self.advance(state, before, after, fallen | diverged)
        reward, shares = self.reward(advance)
        return settle(state, reward, shares, fallen | self.finished(state), diverged, self.episode_steps)

    def reward(self, advance: rewards.Advance) -> tuple[Any, dict[str, Any]]:
        """Reward of the step, (N,), and the share of each term."""
        return rewards.total(advance, self.config.rewards)

    def fallen(self, reading: Reading) -> Any:
        """Copies on the ground, (N,) bool: tilted beyond 60 degrees or the pelvis below 0.35 m."""
        return has_fallen(reading.gravity, reading.base_position[:, 2])

    def finished(self, state: VelocityState) -> Any:
        """Copies that have reached all waypoints, (N,) bool."""
        return state.aim >= self.config.waypoints

    def observe(self, state: VelocityState, reading: Reading) -> Any:
        """The observation, (N, 61) float32, within `OBSERVATION_BOUND`."""
        xp = namespace(reading.gyro)
        offset = self.offset(state, reading)
        flat = xp.concat([offset, xp.zeros_like(offset[:, 0:1])], axis=-1)
        ahead = frames.to_heading(frames.heading(reading.base_quat), flat)
        blocks = {
            "gyro": _GYRO_SCALE * reading.gyro,
            "gravity": reading.gravity,
            "joint_position": reading.joint_position - xp.asarray(STAND_POSITION, dtype=reading.gyro.dtype),
            "joint_velocity": _VELOCITY_SCALE * reading.joint_velocity,
            "waypoint": ahead[:, 0:2],
            "command": state.command[:, 0],
        }
        vector = xp.concat([xp.astype(blocks[name], xp.float32) for name, _ in _BLOCKS], axis=-1)
        bound = xp.asarray(OBSERVATION_BOUND, dtype=xp.float32)
        return xp.clip(vector, -bound, bound)
