"""What a policy sees: one layout object for environment, trainer, exporter and firmware.

The actor sees only what telemetry carries (angular velocity, projected gravity, joint positions and velocities), the
velocity command, its own last action and a gait clock. `asimov-80` is the default; `asimov-78` is the same without the
clock, the public full-body layout of the robot's maker.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np

from asimov_gym.robot import mirror
from asimov_gym.robot.array_library import namespace, within
from asimov_gym.robot.joints import (
    JOINT_NAMES,
    JOINTS,
    POLICY_JOINT_NAMES,
    RANGE,
    STAND_POSITION,
    VELOCITY_LIMIT,
    permutation,
)

POLICY_RATE_HZ = 50.0
STANDING_THRESHOLD = 0.05
"""A command whose norm is below this asks to stand: the gait clock rests."""

_SLOTS = {joint.name: joint.can_slot for joint in JOINTS}


def _can_group(*slots: int) -> tuple[str, ...]:
    """Policy joints polled in these bus slots, in policy order."""
    return tuple(name for name in POLICY_JOINT_NAMES if _SLOTS[name] in slots)


CAN_GROUPS: tuple[tuple[str, ...], ...] = (_can_group(0, 1), _can_group(2, 3), _can_group(4, 5))
"""The joints in three groups by their age on the bus, oldest first (9, 8 and 6 joints)."""


@dataclass(frozen=True)
class Term:
    """A block of the observation vector."""

    name: str
    size: int
    scale: float
    """The raw quantity is multiplied by this."""
    bound: float
    """Finite bound of the scaled entries in the observation space; values are clipped to it."""
    joints: tuple[str, ...] = ()
    """Joint names of the entries, for joint terms."""


@dataclass(frozen=True)
class ObservationLayout:
    """Terms of an observation vector in order. Names: `gyro`, `gravity`, `command`, `joint_position_<g>`,
    `joint_velocity_<g>` for CAN group g, `action`, `clock`."""

    name: str
    terms: tuple[Term, ...]

    @cached_property
    def width(self) -> int:
        return sum(term.size for term in self.terms)

    @cached_property
    def slices(self) -> dict[str, slice]:
        """Place of each term in the vector."""
        stops = np.cumsum([term.size for term in self.terms])
        return {t.name: slice(int(stop) - t.size, int(stop)) for t, stop in zip(self.terms, stops, strict=True)}

    @cached_property
    def bounds(self) -> np.ndarray:
        """Symmetric finite bound of each entry, (width,)."""
        return np.concatenate([np.full(term.size, term.bound, dtype=np.float32) for term in self.terms])

    @cached_property
    def scales(self) -> np.ndarray:
        """Scale of each entry, (width,)."""
        return np.concatenate([np.full(term.size, term.scale, dtype=np.float32) for term in self.terms])

    @cached_property
    def has_clock(self) -> bool:
        return "clock" in self.slices

    @cached_property
    def mirror(self) -> mirror.Mirror:
        """Left-right mirror of the whole vector. The clock's mirror is half a cycle later."""
        parts = {
            "gyro": mirror.mirror_axial,
            "gravity": mirror.mirror_polar,
            "command": mirror.mirror_command,
            "action": mirror.mirror_policy,
            "clock": mirror.signs_mirror(-1.0, -1.0),
        }
        return mirror.join([mirror.joint_mirror(t.joints) if t.joints else parts[t.name] for t in self.terms])

    @cached_property
    def _order(self) -> np.ndarray:
        """Place of each entry of the vector in the raw quantities one after the other, joints in joint order."""
        joints, n = self.joint_order, len(JOINT_NAMES)
        head = self.slices["joint_position_0"].start
        tail = np.arange(self.slices["action"].start, self.width) + 2 * (n - len(joints))
        return np.concatenate([np.arange(head), head + joints, head + n + joints, tail])

    @cached_property
    def joint_order(self) -> np.ndarray:
        """Joint of each entry of the joint terms, which stand one after the other: positions, then speeds; (23,)."""
        return np.concatenate([permutation(JOINT_NAMES, group) for group in CAN_GROUPS])

    def observe(self, **quantities: Any) -> Any:
        """The observation vector, (..., width), float32; the arguments are those of `scaled`."""
        return self.bounded(self.scaled(**quantities))

    def bounded(self, vector: Any) -> Any:
        """A vector (..., width) within its bounds."""
        xp = namespace(vector)
        bounds = xp.asarray(self.bounds)
        return within(xp, vector, -bounds, bounds)

    def scaled(
        self,
        *,
        gyro: Any,
        gravity: Any,
        command: Any,
        joint_position: Any,
        joint_velocity: Any,
        action: Any,
        clock: Any,
    ) -> Any:
        """The terms in order and scaled, but not yet within their bounds, (..., width), float32.

        Args:
            gyro: angular velocity in the body frame, (..., 3), rad/s.
            gravity: unit vector to the ground in the body frame, (..., 3).
            command: vx, vy (m/s), yaw rate (rad/s), (..., 3).
            joint_position: rad, joint order, (..., 25).
            joint_velocity: rad/s, joint order, (..., 25).
            action: the last network output after clipping, policy order, (..., 23).
            clock: cos and sin of the gait phase, (0, 0) at rest, (..., 2); ignored by layouts without a clock.
        """
        xp = namespace(gyro)
        offset = joint_position - xp.asarray(STAND_POSITION, dtype=joint_position.dtype)
        blocks = [gyro, gravity, command, offset, joint_velocity, action]
        if self.has_clock:
            blocks.append(clock)
        raw = xp.astype(xp.concat(blocks, axis=-1), xp.float32)
        return xp.take(raw, xp.asarray(self._order), axis=-1) * xp.asarray(self.scales)


def _terms(with_clock: bool) -> tuple[Term, ...]:
    reach = {name: float(np.max(np.abs(RANGE[i] - STAND_POSITION[i]))) for i, name in enumerate(JOINT_NAMES)}
    speed = dict(zip(JOINT_NAMES, VELOCITY_LIMIT, strict=True))
    terms = [Term("gyro", 3, 0.25, 10.0), Term("gravity", 3, 1.0, 1.5), Term("command", 3, 1.0, 3.0)]
    for g, group in enumerate(CAN_GROUPS):
        terms.append(Term(f"joint_position_{g}", len(group), 1.0, 2.0 * max(reach[n] for n in group), group))
    for g, group in enumerate(CAN_GROUPS):
        terms.append(Term(f"joint_velocity_{g}", len(group), 0.1, 0.4 * max(speed[n] for n in group), group))
    terms.append(Term("action", len(POLICY_JOINT_NAMES), 1.0, 100.0))
    if with_clock:
        terms.append(Term("clock", 2, 1.0, 1.0))
    return tuple(terms)


LAYOUTS = MappingProxyType(
    {
        "asimov-80": ObservationLayout("asimov-80", _terms(with_clock=True)),
        "asimov-78": ObservationLayout("asimov-78", _terms(with_clock=False)),
    }
)
"""Known layouts by name."""


def observation_layout(name: str) -> ObservationLayout:
    """Layout by name.

    Raises:
        ValueError: the name is unknown; the message lists the known ones.
    """
    if name not in LAYOUTS:
        raise ValueError(f"layout {name!r} is unknown; known layouts: {', '.join(LAYOUTS)}")
    return LAYOUTS[name]
