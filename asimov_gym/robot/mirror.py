"""The robot's left-right mirror: swap the sides and negate every joint except Neck_Pitch.

Left and right joints of this robot turn about opposite axes, the waist and the neck yaw about the vertical; so
reflecting the machine in its x-z plane negates each of those angles. Neck_Pitch turns about the y axis, which the
reflection keeps. Every mirror here is a signed permutation of a vector's entries, exact and its own inverse.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from asimov_gym.robot.array_library import namespace
from asimov_gym.robot.joints import JOINT_NAMES, POLICY_JOINT_NAMES

_KEEPS_SIGN = frozenset({"neck_pitch_joint"})


@dataclass(frozen=True)
class Mirror:
    """A signed permutation `v -> signs * v[indices]` over the last axis."""

    indices: np.ndarray
    signs: np.ndarray

    def __call__(self, vector: Any) -> Any:
        """Mirror an array of shape (..., n) of any array-API library."""
        xp = namespace(vector)
        taken = xp.take(vector, xp.asarray(self.indices), axis=-1)
        return taken * xp.asarray(self.signs, dtype=vector.dtype)

    @property
    def size(self) -> int:
        return len(self.indices)


def mirror_name(joint: str) -> str:
    """The joint on the other side: `left_knee_joint` for `right_knee_joint`; joints on the middle line stay."""
    if joint.startswith("left_"):
        return "right_" + joint.removeprefix("left_")
    if joint.startswith("right_"):
        return "left_" + joint.removeprefix("right_")
    return joint


def joint_mirror(names: Sequence[str]) -> Mirror:
    """Mirror of a vector whose entries belong to the joints `names`.

    Raises:
        ValueError: the names are not closed under the mirror.
    """
    places = {name: index for index, name in enumerate(names)}
    unpaired = [name for name in names if mirror_name(name) not in places]
    if unpaired:
        raise ValueError(f"joints {unpaired} have no counterpart among {list(names)}")
    indices = np.array([places[mirror_name(name)] for name in names], dtype=np.intp)
    signs = np.array([1.0 if name in _KEEPS_SIGN else -1.0 for name in names])
    return Mirror(indices, signs)


def signs_mirror(*signs: float) -> Mirror:
    """Mirror that only changes signs, for vectors in a fixed frame."""
    return Mirror(np.arange(len(signs)), np.array(signs))


def join(parts: Sequence[Mirror]) -> Mirror:
    """Mirror of the concatenation of vectors."""
    offsets = np.cumsum([0, *(part.size for part in parts)])
    indices = np.concatenate([part.indices + offset for part, offset in zip(parts, offsets, strict=False)])
    return Mirror(indices, np.concatenate([part.signs for part in parts]))


mirror_joints = joint_mirror(JOINT_NAMES)
"""Mirror of a vector in joint order, shape (..., 25)."""
mirror_policy = joint_mirror(POLICY_JOINT_NAMES)
"""Mirror of a vector in policy order, shape (..., 23)."""
mirror_polar = signs_mirror(1.0, -1.0, 1.0)
"""Mirror of a position, velocity, force or direction (x, y, z)."""
mirror_axial = signs_mirror(-1.0, 1.0, -1.0)
"""Mirror of an angular velocity or torque (x, y, z)."""
mirror_command = signs_mirror(1.0, -1.0, -1.0)
"""Mirror of a velocity command (vx, vy, yaw rate)."""
mirror_quaternion = signs_mirror(1.0, -1.0, 1.0, -1.0)
"""Mirror of an orientation (w, x, y, z)."""
