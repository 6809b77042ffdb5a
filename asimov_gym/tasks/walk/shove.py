"""Shoves: forces on single bodies for a fraction of a second, drawn at random. They teach recovery from pushes.

A kick changes the velocity of the whole robot at once. A shove acts where a person would touch the robot: it turns the
robot as well, and presses the feet into the ground when it comes from above.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from asimov_gym.robot.array_library import namespace
from asimov_gym.tasks.walk.config import ShoveConfig
from asimov_gym.tasks.walk.draws import steps_between

if TYPE_CHECKING:
    from asimov_gym.tasks.walk.state import WalkState

SHOVE_DRAWS = 6
"""Uniform numbers per copy that `shoved` needs."""


def shoved(config: ShoveConfig, state: WalkState, draws: Any, level: Any) -> WalkState:
    """State with shoves begun where they are due and ended where their time is up.

    Args:
        config: bodies, forces and times.
        state: before the step.
        draws: (N, SHOVE_DRAWS); they matter where a shove is due.
        level: place in the curriculum, 0 to 1.
    """
    xp = namespace(draws)
    due = state.shove_wait <= 0
    lasting = state.shove_left > 1
    force, duration, wait = _draw_shove(config, draws, level)
    running = xp.where(lasting[:, None, None], state.shove, xp.zeros_like(state.shove))
    force = xp.where(due[:, None, None], xp.astype(force, state.shove.dtype), running)
    left = xp.where(due, duration, xp.clip(state.shove_left - 1, 0, None))
    return replace(state, shove=force, shove_left=left, shove_wait=xp.where(due, duration + wait, state.shove_wait))


def pace(config: ShoveConfig, state: WalkState, moving: Any) -> Any:
    """Policy steps by which the next shove comes nearer in a step, (N,) or one number: more at rest, unless one acts.

    Args:
        config: its `pace_at_rest` counts.
        state: of the step.
        moving: copies that are asked to walk, (N,) bool.
    """
    if config.pace_at_rest == 1:
        return 1
    xp = namespace(state.shove_wait)
    one = xp.ones_like(state.shove_wait)
    return xp.where(moving | (state.shove_left > 0), one, config.pace_at_rest * one)


def _draw_shove(config: ShoveConfig, draws: Any, level: Any) -> tuple[Any, Any, Any]:
    """Forces (N, B, 3), N, and how long they last and until when none follows, policy steps (N,)."""
    xp = namespace(draws)
    bodies = config.bodies
    along = xp.asarray([config.horizontal.get(name, 0.0) for name in bodies], dtype=draws.dtype)
    down = xp.asarray([config.downward.get(name, 0.0) for name in bodies], dtype=draws.dtype)
    chosen = xp.floor(len(bodies) * draws[:, 0])[:, None] == xp.arange(len(bodies), dtype=draws.dtype)[None, :]
    strongest = config.first + (1.0 - config.first) * level
    size = (strongest * (config.mildest + (1.0 - config.mildest) * draws[:, 1]))[:, None]
    # A body with both kinds is pressed down in a third of its shoves.
    vertical = (draws[:, 2:3] < xp.where(along > 0.0, 1.0 / 3.0, 1.0)) & (down > 0.0)
    angle = 2.0 * math.pi * draws[:, 3:4]
    none = xp.zeros_like(size * along)
    flat = xp.where(vertical, none, size * along)
    force = xp.stack([flat * xp.cos(angle), flat * xp.sin(angle), xp.where(vertical, -size * down, none)], axis=-1)
    force = xp.where(chosen[:, :, None], force, xp.zeros_like(force))
    return force, steps_between(draws[:, 4], config.duration_s), steps_between(draws[:, 5], config.interval_s)
