"""Velocity: steer the walking robot through waypoints by velocity commands."""

from asimov_gym.tasks.velocity.config import VelocityConfig
from asimov_gym.tasks.velocity.task import VelocityState, VelocityTask

__all__ = ["VelocityConfig", "VelocityState", "VelocityTask"]
