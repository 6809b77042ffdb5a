"""Walking: follow a velocity command without falling."""

from asimov_gym.tasks.walk.config import WalkConfig
from asimov_gym.tasks.walk.task import WalkState, WalkTask

__all__ = ["WalkConfig", "WalkState", "WalkTask"]
