"""What both dialects do to the numbers of a command: clamps, defaults, and the way from the wire to the joints."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from asimov_gym.edge.dialect import DialectRules
from asimov_gym.edge.verdict import Dropped, DropReason, Note
from asimov_gym.firmware import Linkage, Trajectory, Velocity
from asimov_gym.robot.joints import JOINT_NAMES, RANGE, joint_index

_ANKLE_LIMIT_PLACES = np.array(
    [[joint_index(f"{side}_ankle_{axis}_joint") for axis in ("pitch", "roll")] for side in ("left", "right")]
)
_ROUNDING = 1e-5
"""A telemetry sample sent straight back comes as 32-bit floats through the linkage: that is no clamp worth a note."""


def limited_velocity(
    wanted: tuple[float, float, float], rules: DialectRules, timeout_s: float | None
) -> tuple[Velocity, list[Note]]:
    """A velocity within the dialect's range.

    Raises:
        Dropped: a value is not finite.
    """
    vector = np.array(wanted)
    if not np.isfinite(vector).all():
        raise Dropped(DropReason.VELOCITY_NOT_FINITE)
    limit = np.array(rules.velocity_limit)
    limited = np.clip(vector, -limit, limit)
    # The limits are 32-bit floats on the wire: 0.4 arrives as 0.4000000059.
    notes = [Note.VELOCITY_CLAMPED] if np.abs(limited - vector).max() > _ROUNDING else []
    return Velocity(*(float(value) for value in limited), timeout_s=timeout_s), notes


def joint_position(wire: np.ndarray, rules: DialectRules, linkage: Linkage, notes: list[Note]) -> np.ndarray:
    """Joint targets within their range, rad, (25,), joint order, from a dialect's 25 entries.

    Args:
        wire: finite, rad, (25,), in the dialect's order and meaning.
        rules: of the dialect.
        linkage: of the ankles.
        notes: takes a note if something was clamped.
    """
    ordered = rules.to_joint_order(wire)
    if rules.ankle_entries == "motors":
        wanted = limited = linkage.joint_position(ordered)
    else:
        wanted, limited = ordered, ordered.copy()
        if rules.ankle_limit is not None:
            bound = np.array(rules.ankle_limit)
            limited[_ANKLE_LIMIT_PLACES] = np.clip(ordered[_ANKLE_LIMIT_PLACES], -bound, bound)
        limited = linkage.reached_position(limited)
        wanted = linkage.reached_position(wanted)
    position = np.clip(limited, RANGE[:, 0], RANGE[:, 1])
    if np.abs(position - wanted).max() > _ROUNDING:
        notes.append(Note.POSITION_CLAMPED)
    return position


def limited_gains(
    values: Sequence[float], limits: tuple[float, float], rules: DialectRules, notes: list[Note]
) -> np.ndarray | None:
    """Gains of the motors within their range, (25,), firmware order; None for the defaults."""
    if len(values) == 0:
        return None
    if len(values) != len(JOINT_NAMES):
        notes.append(Note.GAINS_WRONG_COUNT)
        return None
    wanted = rules.to_joint_order(np.array(values))
    if not np.isfinite(wanted).all():
        notes.append(Note.GAINS_NOT_FINITE)
        return None
    limited = np.clip(wanted, *limits)
    if np.abs(limited - wanted).max() > _ROUNDING:
        notes.append(Note.GAIN_CLAMPED)
    return limited


def trajectory(
    position: np.ndarray, kp: np.ndarray | None, kd: np.ndarray | None, rules: DialectRules, linkage: Linkage
) -> Trajectory:
    """The firmware command for a pose and, where given, explicit gains.

    Explicit gains act at the motors, in both dialects, so those of the ankles go through the linkage.

    Args:
        position: rad, (25,), joint order.
        kp: N·m/rad at the motors, (25,), or None for the defaults.
        kd: N·m·s/rad at the motors, (25,), or None for the defaults.
        rules: of the dialect.
        linkage: of the ankles.
    """
    nothing = np.zeros(len(JOINT_NAMES))
    joint_kp, joint_kd = linkage.joint_gains(nothing if kp is None else kp, nothing if kd is None else kd, position)
    return Trajectory(
        position,
        None if kp is None else joint_kp,
        None if kd is None else joint_kd,
        rules.trajectory_timeout_s,
    )
