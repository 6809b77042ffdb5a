"""What the walking task remembers of each copy, and how many random numbers its functions take."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from asimov_gym.robot.joints import JOINT_NAMES, POLICY_JOINT_NAMES
from asimov_gym.tasks.walk.shove import SHOVE_DRAWS

_JOINTS = len(JOINT_NAMES)

SENSOR_DRAWS = 3 + 3 + 2 * len(POLICY_JOINT_NAMES)
"""Uniform numbers per copy that `views` needs: one for each sensor in the observation, in its order."""
COMMAND_DRAWS = 6
"""Uniform numbers per copy that `draws.draw_command` needs."""
KICK_DRAWS = 7
"""Uniform numbers per copy that `draws.draw_kick` needs."""
RESET_DRAWS = 2 + _JOINTS + COMMAND_DRAWS + 2
"""Uniform numbers per copy that `initial_state` needs."""
BODY_DRAWS = 4 + 2 * _JOINTS
"""Uniform numbers per copy that `draws.draw_body` needs."""
POSE_DRAWS = 5 + _JOINTS + 6
"""Uniform numbers per copy that `initial_pose` needs."""
STEP_DRAWS: Mapping[str, int] = MappingProxyType(
    {"kick": KICK_DRAWS, "command": COMMAND_DRAWS, "sensors": SENSOR_DRAWS, "shove": SHOVE_DRAWS}
)
"""Uniform numbers per copy that a step takes, by what they are for."""
START_DRAWS: Mapping[str, int] = MappingProxyType(
    {"pose": POSE_DRAWS, "state": RESET_DRAWS, "redraw": 1, "body": BODY_DRAWS}
)
"""Uniform numbers per copy that the start of an episode takes besides; `redraw` decides on a new body."""
PLACE_DRAWS = 2
"""Uniform numbers per copy that `place` needs."""


@dataclass(frozen=True)
class WalkState:
    """What the task remembers of each copy."""

    step: Any
    """Policy steps since reset, (N,)."""
    command: Any
    """(N, 3)."""
    command_left: Any
    """Policy steps until the next command, (N,)."""
    kick_left: Any
    """Policy steps until the next kick, (N,)."""
    phase: Any
    """Gait clock of the left foot, rad, (N,)."""
    action: Any
    """Clipped actions, newest first, (N, 3, 23)."""
    delay: Any
    """Action delay in physics steps, (N,) int."""
    joint_zero: Any
    """Encoder offsets, (N, 25)."""
    mean_velocity: Any
    """Running mean of vx, vy, yaw rate in the heading frame, (N, 3)."""
    shove: Any
    """Forces of the shove that acts, world frame, N, on each body that is ever shoved, (N, B, 3)."""
    shove_left: Any
    """Policy steps that it still lasts, this one included; 0 without one; (N,)."""
    shove_wait: Any
    """Policy steps until the next, (N,)."""
