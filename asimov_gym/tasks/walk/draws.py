"""How uniform random numbers become the figures of the walking task."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from asimov_gym.physics import DECIMATION, TIMESTEP, BodyParameters
from asimov_gym.robot.array_library import integer, namespace
from asimov_gym.robot.joints import JOINT_NAMES
from asimov_gym.tasks.walk.config import CommandConfig, KickConfig, RandomisationConfig

_JOINTS = len(JOINT_NAMES)

NEVER = 2**30
"""Policy steps to a kick or shove that does not come: eight months."""
DT = TIMESTEP * DECIMATION
"""Policy step, s."""


def between(draw: Any, interval: tuple[float, float]) -> Any:
    """Numbers in an interval from draws in [0, 1)."""
    return interval[0] + (interval[1] - interval[0]) * draw


def steps_between(draw: Any, seconds: tuple[float, float]) -> Any:
    """Whole policy steps from draws in [0, 1), for a time in an interval of seconds."""
    xp = namespace(draw)
    return xp.astype(xp.round(between(draw, seconds) / DT), integer(xp))


def decided(draw: Any, share: float) -> tuple[Any, Any]:
    """What happens with this chance, (N,) bool, and a fresh draw for where it does not; from draws (N,) in [0, 1)."""
    left = (draw - share) / max(1.0 - share, 1e-6)
    return draw < share, namespace(draw).clip(left, 0.0, 1.0)


def draw_command(config: CommandConfig, draws: Any) -> tuple[Any, Any]:
    """Velocity commands (N, 3) and their lifetimes in policy steps (N,), from draws (N, COMMAND_DRAWS)."""
    xp = namespace(draws)
    axes = (config.vx, config.vy, config.wz)
    command = xp.stack([between(draws[:, i], axis) for i, axis in enumerate(axes)], axis=-1)
    if config.corner_share > 0.0:
        corner = (draws[:, 3] >= config.standing_share) & (draws[:, 3] < config.standing_share + config.corner_share)
        command = xp.where(corner[:, None], _corners(draws[:, 0:3], axes), command)
    standing = draws[:, 3] < config.standing_share
    single = draws[:, 3] > 1.0 - config.single_axis_share
    axis = xp.floor(3.0 * draws[:, 4])
    kept = xp.arange(3, dtype=draws.dtype)[None, :] == axis[:, None]
    command = xp.where(single[:, None] & ~kept, xp.zeros_like(command), command)
    command = xp.where(standing[:, None], xp.zeros_like(command), command)
    return command, steps_between(draws[:, 5], config.interval_s)


def draw_body(config: RandomisationConfig, draws: Any) -> BodyParameters:
    """Body figures (N rows) from draws (N, BODY_DRAWS)."""
    xp = namespace(draws)
    com = xp.stack(
        [between(draws[:, 2], config.torso_com_x), 0.0 * draws[:, 2], between(draws[:, 3], config.torso_com_z)], axis=-1
    )
    return BodyParameters(
        foot_friction=between(draws[:, 0], config.foot_friction),
        torso_mass=between(draws[:, 1], config.torso_mass),
        torso_com=com,
        kp_scale=between(draws[:, 4 : 4 + _JOINTS], config.kp_scale),
        kd_scale=between(draws[:, 4 + _JOINTS :], config.kd_scale),
    )


def draw_kick(config: KickConfig, draws: Any, level: Any) -> tuple[Any, Any]:
    """Changes of the pelvis velocity (N, 6) and steps until the next kick (N,), from draws (N, KICK_DRAWS).

    Args:
        config: how hard, and how often.
        draws: uniform numbers.
        level: place in the curriculum, 0 to 1.
    """
    xp = namespace(draws)
    largest = config.speed[0] + (config.speed[1] - config.speed[0]) * level
    angle = 2.0 * math.pi * draws[:, 0]
    speed = largest * draws[:, 1]
    centred = 2.0 * draws - 1.0
    kick = xp.stack(
        [
            speed * xp.cos(angle),
            speed * xp.sin(angle),
            config.vertical * centred[:, 2],
            config.tilt_rate * centred[:, 3],
            config.tilt_rate * centred[:, 4],
            config.turn_rate * centred[:, 5],
        ],
        axis=-1,
    )
    return kick, steps_between(draws[:, 6], config.interval_s)


def _corners(draws: Any, intervals: Sequence[tuple[float, float]]) -> Any:
    """The least, nothing or the largest of each of K intervals around zero, with the same chance, from draws (N, K)."""
    xp = namespace(draws)
    low, high = (xp.asarray([interval[end] for interval in intervals], dtype=draws.dtype) for end in (0, 1))
    third = xp.floor(3.0 * draws)
    return xp.where(third == 1.0, xp.zeros_like(draws), xp.where(third > 1.0, high, low))
