"""Joint readings that are as old as their turn on the motor bus makes them.

Each bus asks its motors one after the other, so those asked first are the oldest when the policy looks. In whole
physics steps of 5 ms: up to two for slots 0 and 1, up to one for slots 2 and 3, none for the last ones. Policy and bus
have clocks of their own, so the ages differ from look to look; the joints of a group share theirs.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from asimov_gym.physics import Reading
from asimov_gym.robot.array_library import integer, namespace
from asimov_gym.robot.joints import JOINTS

OLDEST = 2
"""Age of the oldest readings, physics steps."""
BUS_DRAWS = OLDEST
"""Uniform numbers per copy that `slot_ages` needs: one for each group that has an age."""
_GROUP = np.array([min(joint.can_slot // 2, OLDEST) for joint in JOINTS])
"""Of each joint: 0 for slots 0 and 1, 1 for slots 2 and 3, 2 for the others."""


def slot_ages(draws: Any) -> Any:
    """Age of each joint's reading, physics steps, (N, 25) int, from draws (N, BUS_DRAWS)."""
    xp = namespace(draws)
    largest = xp.asarray([OLDEST - group for group in range(BUS_DRAWS)], dtype=draws.dtype)
    ages = xp.astype(xp.floor((largest + 1.0) * draws), integer(xp))
    ages = xp.concat([ages, xp.zeros_like(ages[:, :1])], axis=-1)
    return xp.take(ages, xp.asarray(_GROUP), axis=-1)


def aged(reading: Reading, trail: Any, ages: Any) -> Reading:
    """The reading with joint positions and velocities from earlier.

    Args:
        reading: of now.
        trail: positions and velocities of the joints 1 to K physics steps ago, (N, K, 2, 25).
        ages: physics steps, at most K, (N, 25) int.
    """
    xp = namespace(trail)
    position, velocity = reading.joint_position, reading.joint_velocity
    for age in range(1, trail.shape[1] + 1):
        position = xp.where(ages == age, trail[:, age - 1, 0], position)
        velocity = xp.where(ages == age, trail[:, age - 1, 1], velocity)
    return replace(reading, joint_position=position, joint_velocity=velocity)
