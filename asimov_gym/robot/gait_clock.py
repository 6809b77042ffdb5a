"""The gait clock that a policy with layout `asimov-80` walks to; the same arithmetic in training and firmware.

The phase is the left foot's, in radians; the right foot is half a cycle later. While the phase's sine is positive the
foot swings, otherwise it stands. At rest (a command whose norm is below the standing threshold) the clock neither
advances nor shows: the policy sees (0, 0).
"""

from __future__ import annotations

import math
from typing import Any

from asimov_gym.robot.array_library import namespace


def is_moving(command: Any, threshold: float) -> Any:
    """Whether a command (..., 3) asks to walk, (...) bool: its Euclidean norm reaches `threshold`."""
    vx, vy, wz = command[..., 0], command[..., 1], command[..., 2]
    return vx * vx + vy * vy + wz * wz >= threshold * threshold


def advance(phase: Any, moving: Any, frequency_hz: float, dt: float) -> Any:
    """Phase after `dt` seconds, (...), rad in [0, 2 pi); it stays where `moving` is false."""
    xp = namespace(phase)
    turned = phase + 2.0 * math.pi * frequency_hz * dt
    turned = xp.where(turned >= 2.0 * math.pi, turned - 2.0 * math.pi, turned)
    return xp.where(moving, turned, phase)


def signal(phase: Any, moving: Any) -> Any:
    """What the policy sees: (cos, sin) of the phase, (..., 2); zeros at rest."""
    xp = namespace(phase)
    shown = xp.stack([xp.cos(phase), xp.sin(phase)], axis=-1)
    return xp.where(moving[..., None], shown, xp.zeros_like(shown))
