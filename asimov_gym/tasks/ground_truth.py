"""What only a simulator knows of the robot's motion: for critics, never for actors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from asimov_gym.physics import Reading
from asimov_gym.robot import frames
from asimov_gym.robot.array_library import namespace
from asimov_gym.robot.feet import SOLE_DEPTH
from asimov_gym.robot.terrain import FLAT, Terrain

_WEIGHT = 316.0
"""The robot's weight, N; scale of contact forces."""
_BOUND = 20.0
"""Bound of each entry, so that one hard impact cannot spoil a critic's normaliser."""


def ground_truth(reading: Reading, terrain: Terrain = FLAT) -> dict[str, Any]:
    """Blocks of a critic's observation by name, scaled to the order of one.

    `velocity` of the pelvis in the heading frame (N, 3), its `height` (N, 1), and of the feet, left before right,
    `foot_height`, `foot_force` (vertical, in body weights) and `foot_speed` (vertical), each (N, 2). Heights are those
    above the terrain.
    """
    return {
        "velocity": frames.to_heading(frames.heading(reading.base_quat), reading.base_velocity),
        "height": 10.0 * (above_ground(reading.base_position[:, None], terrain) - 0.6),
        "foot_height": 10.0 * (above_ground(reading.foot_position, terrain) - SOLE_DEPTH),
        "foot_force": reading.foot_force[:, :, 2] / _WEIGHT,
        "foot_speed": reading.foot_velocity[:, :, 2],
    }


def above_ground(position: Any, terrain: Terrain) -> Any:
    """Height above the ground below, m, (N, M), of positions in the world (N, M, 3)."""
    height = position[:, :, 2]
    return height if terrain.is_flat else height - terrain.height(position[:, :, 0], position[:, :, 1])


def critic_view(actor: Any, known: Sequence[Any]) -> Any:
    """A critic's observation: the actor's (N, width), float32, and blocks (N, n) besides, within their bound."""
    xp = namespace(actor)
    blocks = xp.concat([xp.astype(block, xp.float32) for block in known], axis=-1)
    return xp.concat([actor, xp.clip(blocks, -_BOUND, _BOUND)], axis=-1)
