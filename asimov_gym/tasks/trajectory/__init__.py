"""Trajectories: follow a reference motion with direct joint targets."""

from asimov_gym.tasks.trajectory.config import TrajectoryConfig
from asimov_gym.tasks.trajectory.motion import Motion, MotionError, load_motion, motion_names, save_motion
from asimov_gym.tasks.trajectory.task import TrajectoryState, TrajectoryTask

__all__ = [
    "Motion",
    "MotionError",
    "TrajectoryConfig",
    "TrajectoryState",
    "TrajectoryTask",
    "load_motion",
    "motion_names",
    "save_motion",
]
