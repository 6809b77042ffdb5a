"""Rotations between the world, the body and the heading frame, over the array-API standard.

World frame: x forward at the start, y left, z up. Body frame: the pelvis'. Heading frame: the world frame turned about
z so that x points where the pelvis points. Quaternions are unit (w, x, y, z), body to world. All functions broadcast
over leading axes.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from asimov_gym.robot.array_library import namespace


def rotate_inverse(quat: Any, vector: Any) -> Any:
    """World vector (..., 3) in the body frame of `quat` (..., 4)."""
    xp = namespace(quat, vector)
    w = quat[..., 0:1]
    x, y, z = quat[..., 1], quat[..., 2], quat[..., 3]
    a, b, c = vector[..., 0], vector[..., 1], vector[..., 2]
    # t = 2 (v x q): the cross product of the vector with the quaternion's vector part
    t = 2.0 * _vector(xp, b * z - c * y, c * x - a * z, a * y - b * x)
    tx, ty, tz = t[..., 0], t[..., 1], t[..., 2]
    return vector + w * t + _vector(xp, ty * z - tz * y, tz * x - tx * z, tx * y - ty * x)


def projected_gravity(quat: Any) -> Any:
    """Unit vector towards the ground in the body frame, (..., 3); upright gives (0, 0, -1)."""
    xp = namespace(quat)
    w, x, y, z = quat[..., 0], quat[..., 1], quat[..., 2], quat[..., 3]
    x2, y2 = 2.0 * x, 2.0 * y
    return _vector(xp, w * y2 - x2 * z, -(w * x2 + y2 * z), x * x2 + y * y2 - 1.0)


def heading(quat: Any) -> Any:
    """Angle of the body's x axis about the world's z, (...), rad in (-pi, pi]."""
    xp = namespace(quat)
    w, x, y, z = quat[..., 0], quat[..., 1], quat[..., 2], quat[..., 3]
    return xp.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def to_heading(angle: Any, vector: Any) -> Any:
    """World vector (..., 3) in the frame turned by `angle` (...) about z."""
    xp = namespace(angle, vector)
    c, s = xp.cos(angle), xp.sin(angle)
    x, y = vector[..., 0], vector[..., 1]
    return _vector(xp, c * x + s * y, c * y - s * x, vector[..., 2])


def yaw_rate(gravity: Any, gyro: Any) -> Any:
    """Turning rate about the world's z axis, (...), rad/s, from body-frame gravity and angular velocity."""
    return -(gravity[..., 0] * gyro[..., 0] + gravity[..., 1] * gyro[..., 1] + gravity[..., 2] * gyro[..., 2])


def as_command(quat: Any, velocity: Any, gravity: Any, gyro: Any) -> Any:
    """A robot's motion as a velocity command would ask for it, (..., 3): vx, vy in the heading frame and yaw rate.

    Args:
        quat: of the pelvis, (..., 4).
        velocity: of the pelvis, world frame, (..., 3).
        gravity: projected, (..., 3).
        gyro: angular velocity in the body frame, (..., 3).
    """
    planar = to_heading(heading(quat), velocity)
    return _vector(namespace(quat, velocity), planar[..., 0], planar[..., 1], yaw_rate(gravity, gyro))


def _vector(xp: Any, x: Any, y: Any, z: Any) -> Any:
    """Three components (...) of one shape and type as a vector (..., 3)."""
    if xp is np:  # the same as stack, which for one robot would cost more than the arithmetic before it
        vector = np.empty((*x.shape, 3), x.dtype)
        vector[..., 0], vector[..., 1], vector[..., 2] = x, y, z
        return vector
    return xp.stack([x, y, z], axis=-1)
