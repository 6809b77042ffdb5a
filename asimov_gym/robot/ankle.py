"""The ankle linkage: joints (pitch, roll) against motors (A, B).

Each foot hangs on a universal joint and is moved by two motors in the shank. Motor A turns a crank of radius r whose
rod lifts one end of a crossbar of length c at distance d from the joint; motor B does the same at the other end.
Equating the height of the crank pins with that of the bar ends gives, with K_PITCH = d / r and K_ROLL = c / (2 r),

    sin A =  K_PITCH tan(pitch) - K_ROLL sin(roll)
    sin B = -K_PITCH tan(pitch) - K_ROLL sin(roll)

for both feet, since the right pitch axis is the mirrored one. `exact` is this mechanism; `linear` is its small-angle
form, which the robot's firmware computes with. Asked through the linear form for 0.10, 0.30 and 0.35 rad of pitch, the
mechanism goes to 0.099, 0.275 and 0.311.

Functions take and return vectors of 25 entries (joint order or motor order) with any leading axes, of any array library
that follows the array-API standard. Only the four ankle entries change. The exact form saturates where the mechanism
ends: motor angles at the motors' travel, roll at an angle that the foot never reaches. There it stays finite, and its
inverse no longer returns what was asked for.

Source: ankle description of the open-source robot (see NOTICE); torques and speeds follow by virtual work, lossless.
"""

from __future__ import annotations

import math
from typing import Any, Literal, NamedTuple

import numpy as np

from asimov_gym.robot.array_library import namespace
from asimov_gym.robot.joints import JOINT_NAMES, joint_index

K_PITCH = 2.02
"""Motor angle per pitch angle, d / r."""
K_ROLL = 0.80
"""Motor angle per roll angle, c / (2 r)."""
MOTOR_TRAVEL = 1.22
"""Largest angle of a crank to either side, rad (70 degrees; the figure of the robot's first generation, same ankle)."""

Form = Literal["linear", "exact"]
FORMS: tuple[Form, ...] = ("linear", "exact")

_WIDTH = len(JOINT_NAMES)
_SIN_TRAVEL = math.sin(MOTOR_TRAVEL)


def _both_feet(axis: str) -> slice:
    """Places of an ankle axis, left and right. A slice, since an index array costs several times as much."""
    left, right = joint_index(f"left_ankle_{axis}_joint"), joint_index(f"right_ankle_{axis}_joint")
    return slice(left, right + 1, right - left)


_FIRST = _both_feet("pitch")
"""Places of pitch, and of motor A."""
_SECOND = _both_feet("roll")
"""Places of roll, and of motor B."""
_MERGE = np.arange(_WIDTH)
_MERGE[_FIRST] = _WIDTH + np.arange(2)
_MERGE[_SECOND] = _WIDTH + 2 + np.arange(2)


class _Slopes(NamedTuple):
    """Partial derivatives dA/dpitch, dA/droll, dB/dpitch, dB/droll, each (..., 2) for left and right."""

    a_pitch: Any
    a_roll: Any
    b_pitch: Any
    b_roll: Any

    @property
    def determinant(self) -> Any:
        return self.a_pitch * self.b_roll - self.a_roll * self.b_pitch


_LINEAR_SLOPES = _Slopes(K_PITCH, -K_ROLL, -K_PITCH, -K_ROLL)


def to_motor_position(joint: Any, form: Form = "linear") -> Any:
    """Motor angles (..., 25) in motor order from joint angles (..., 25), rad.

    Raises:
        ValueError: the last axis is not 25, or the form is unknown.
    """
    pitch, roll = _pairs("joint", joint)
    if _check(form) == "linear":
        lift, bank = K_PITCH * pitch, K_ROLL * roll
        return _merge(joint, lift - bank, -lift - bank)
    xp = namespace(joint)
    sin_a, sin_b = _crank_sines(xp, pitch, roll)
    return _merge(joint, xp.asin(sin_a), xp.asin(sin_b))


def to_joint_position(motor: Any, form: Form = "linear") -> Any:
    """Joint angles (..., 25) from motor angles (..., 25), rad; the inverse of `to_motor_position`, in closed form.

    Raises:
        ValueError: the last axis is not 25, or the form is unknown.
    """
    a, b = _pairs("motor", motor)
    if _check(form) == "linear":
        return _merge(motor, (a - b) / (2.0 * K_PITCH), -(a + b) / (2.0 * K_ROLL))
    xp = namespace(motor)
    sin_a, sin_b = xp.sin(_clip(xp, a, MOTOR_TRAVEL)), xp.sin(_clip(xp, b, MOTOR_TRAVEL))
    sin_roll = _clip(xp, -(sin_a + sin_b) / (2.0 * K_ROLL), _SIN_TRAVEL)
    return _merge(motor, xp.atan((sin_a - sin_b) / (2.0 * K_PITCH)), xp.asin(sin_roll))


def to_motor_velocity(joint_velocity: Any, joint_position: Any = None, form: Form = "linear") -> Any:
    """Motor speeds (..., 25) from joint speeds (..., 25), rad/s.

    Args:
        joint_velocity: joint speeds.
        joint_position: joint angles (..., 25), rad; the exact form needs them.
        form: `linear` or `exact`.

    Raises:
        ValueError: the last axis is not 25, the form is unknown, or the exact form lacks `joint_position`.
    """
    pitch, roll = _pairs("joint_velocity", joint_velocity)
    s = _slopes(joint_position, form)
    return _merge(joint_velocity, s.a_pitch * pitch + s.a_roll * roll, s.b_pitch * pitch + s.b_roll * roll)


def to_joint_velocity(motor_velocity: Any, joint_position: Any = None, form: Form = "linear") -> Any:
    """Joint speeds (..., 25) from motor speeds (..., 25), rad/s; arguments and errors as for `to_motor_velocity`."""
    a, b = _pairs("motor_velocity", motor_velocity)
    s = _slopes(joint_position, form)
    determinant = s.determinant
    pitch, roll = (s.b_roll * a - s.a_roll * b) / determinant, (s.a_pitch * b - s.b_pitch * a) / determinant
    return _merge(motor_velocity, pitch, roll)


def to_joint_torque(motor_torque: Any, joint_position: Any = None, form: Form = "linear") -> Any:
    """Joint torques (..., 25) that motor torques (..., 25) produce, N·m: the transposed slopes (virtual work).

    Arguments and errors as for `to_motor_velocity`.
    """
    a, b = _pairs("motor_torque", motor_torque)
    s = _slopes(joint_position, form)
    return _merge(motor_torque, s.a_pitch * a + s.b_pitch * b, s.a_roll * a + s.b_roll * b)


def to_motor_torque(joint_torque: Any, joint_position: Any = None, form: Form = "linear") -> Any:
    """Motor torques (..., 25) that hold joint torques (..., 25), N·m; the inverse of `to_joint_torque`."""
    pitch, roll = _pairs("joint_torque", joint_torque)
    s = _slopes(joint_position, form)
    determinant = s.determinant
    a, b = (s.b_roll * pitch - s.b_pitch * roll) / determinant, (s.a_pitch * roll - s.a_roll * pitch) / determinant
    return _merge(joint_torque, a, b)


def gains_to_joint(kp: Any, kd: Any) -> tuple[Any, Any]:
    """Joint-space gains (..., 25) of motor-space gains (..., 25) in motor order.

    A gain k on both motors acts as 2 K_PITCH² k = 8.16 k on pitch and 2 K_ROLL² k = 1.28 k on roll. Unequal gains would
    also couple pitch with roll; a law per joint cannot have that, so the coupling is left out and each joint gets its
    share of both motors.

    Args:
        kp: position gains, N·m/rad.
        kd: damping gains, N·m·s/rad.

    Raises:
        ValueError: the last axis is not 25.
    """
    joint_gains = []
    for name, gain in (("kp", kp), ("kd", kd)):
        a, b = _pairs(name, gain)
        joint_gains.append(_merge(gain, K_PITCH**2 * (a + b), K_ROLL**2 * (a + b)))
    return joint_gains[0], joint_gains[1]


def _check(form: Form) -> Form:
    if form not in FORMS:
        raise ValueError(f"form must be one of {', '.join(map(repr, FORMS))}, got {form!r}")
    return form


def _pairs(name: str, vector: Any) -> tuple[Any, Any]:
    """First and second ankle entries of a vector, each (..., 2) for left and right."""
    if vector.ndim < 1 or vector.shape[-1] != _WIDTH:
        raise ValueError(f"{name} must have shape (..., {_WIDTH}), got {tuple(vector.shape)}")
    return vector[..., _FIRST], vector[..., _SECOND]


def _merge(vector: Any, first: Any, second: Any) -> Any:
    """The vector with its ankle entries replaced; its leading axes broadcast against those of the new entries."""
    xp = namespace(vector)
    shape = (*first.shape[:-1], _WIDTH)
    if xp is np:  # the standard has no arrays to write into, and would need three times as long
        merged = np.empty(shape, np.result_type(vector, first))
        merged[...] = vector
        merged[..., _FIRST], merged[..., _SECOND] = first, second
        return merged
    rest = xp.broadcast_to(vector, shape)
    return xp.take(xp.concat([rest, first, second], axis=-1), xp.asarray(_MERGE), axis=-1)


def _clip(xp: Any, value: Any, limit: float) -> Any:
    return xp.clip(value, -limit, limit)


def _crank_sines(xp: Any, pitch: Any, roll: Any) -> tuple[Any, Any]:
    lift, bank = K_PITCH * xp.tan(pitch), K_ROLL * xp.sin(roll)
    return _clip(xp, lift - bank, _SIN_TRAVEL), _clip(xp, -lift - bank, _SIN_TRAVEL)


def _slopes(joint_position: Any, form: Form) -> _Slopes:
    """Slopes of the motor angles at a joint position; beyond the motors' travel with the cranks held at it."""
    if _check(form) == "linear":
        return _LINEAR_SLOPES
    if joint_position is None:
        raise ValueError("joint_position is needed by the exact form: the slopes of the linkage depend on the pose")
    pitch, roll = _pairs("joint_position", joint_position)
    xp = namespace(joint_position)
    sin_a, sin_b = _crank_sines(xp, pitch, roll)
    cos_a, cos_b = xp.sqrt(1.0 - sin_a * sin_a), xp.sqrt(1.0 - sin_b * sin_b)
    pitch_slope, roll_slope = K_PITCH / xp.cos(pitch) ** 2, K_ROLL * xp.cos(roll)
    return _Slopes(pitch_slope / cos_a, -roll_slope / cos_a, -pitch_slope / cos_b, -roll_slope / cos_b)
