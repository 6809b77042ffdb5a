"""The joint table: every name, order, limit and gain of the robot's 25 actuated joints.

Three orders exist, and nothing in this project indexes joints by a literal number:

* **joint order**: the 25 joints in the order of the robot's control interface ("firmware order" of the contract, with
  23 Neck_Pitch and 24 Neck_Yaw), the ankles as pitch and roll. Physics, tasks and firmware use it.
* **motor order**: the same 25 slots by motor; only the four ankle slots differ, which hold the motors A and B of the
  linkage (see `asimov_gym.robot.ankle`). Telemetry and dialect A trajectories use it.
* **policy order**: 23 joints, waist before the arms, right arm before the left, no neck. Networks use it.

Figures: the published models and training configurations of Asimov 1 (see NOTICE). Angles are radians, torques N·m at
the joint. Left and right joints of a pair turn about opposite axes, so a mirrored joint has the negated value; only
Neck_Pitch keeps its sign.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np


@dataclass(frozen=True)
class Motor:
    """One motor family of the robot (ENCOS EC series), figures at the output shaft."""

    name: str
    rated_torque: float
    """Continuous torque, N·m."""
    peak_torque: float
    """N·m."""
    rated_speed: float
    """rad/s."""
    peak_speed: float
    """rad/s."""
    kt: float
    """Output torque per ampere of the phase current that the bus reports, N·m/A."""
    peak_current: float
    """A."""


MOTORS = MappingProxyType(
    {
        motor.name: motor
        for motor in (
            Motor("EC-A6416-P2-25", 40.0, 120.0, 11.205, 12.566, 2.75, 60.0),
            Motor("EC-A5013-H17-100", 30.0, 90.0, 3.456, 3.979, 7.15, 20.0),
            Motor("EC-A3814-H14-107", 20.0, 60.0, 4.922, 5.445, 5.70, 10.0),
            Motor("EC-A4315-P2-36", 25.0, 75.0, 11.414, 12.252, 2.53, 30.0),
            Motor("EC-A4310-P2-36", 12.0, 36.0, 7.854, 9.320, 1.81, 30.0),
        )
    }
)
"""Motor families by name."""

_A6416, _A5013, _A3814, _A4315, _A4310 = MOTORS


@dataclass(frozen=True)
class Joint:
    """One actuated joint. All joints are hinges; positions in rad, torques in N·m, speeds in rad/s."""

    name: str
    """Name in the model and in policies, such as `left_hip_pitch_joint`."""
    motor_name: str
    """Name of the motor in the same slot of the control interface, such as `L_Hip_Pitch` or `L_Ankle_A`."""
    body: str
    """Body that the joint moves."""
    range: tuple[float, float]
    stand: float
    """Angle in the standing pose; also the offset of policy actions."""
    kp: float
    """Default position gain, N·m/rad."""
    kd: float
    """Default damping gain, N·m·s/rad."""
    effort: float
    """Torque limit."""
    velocity_limit: float
    armature: float
    """Identified reflected inertia, kg·m²."""
    frictionloss: float
    """Dry friction, N·m."""
    damping: float
    """Viscous friction, N·m·s/rad."""
    motor: str
    """Key into `MOTORS`."""
    can_slot: int
    """Place in its bus's polling order; 0 is the oldest sample of a cycle."""
    assumed: bool = False
    """True where no public source gives the drive's figures (the neck)."""


@dataclass(frozen=True)
class _Drive:
    """The figures that joints with the same motor and gains share."""

    motor: str
    kp: float
    kd: float
    effort: float
    velocity_limit: float
    armature: float
    frictionloss: float
    damping: float


_HIP_PITCH = _Drive(_A6416, 150.0, 5.0, 45.0, 12.57, 0.0698, 0.7, 0.05)
_HIP_ROLL = _Drive(_A5013, 150.0, 5.0, 45.0, 3.98, 0.14, 0.2, 0.02)
_HIP_YAW = _Drive(_A3814, 150.0, 5.0, 28.0, 5.45, 0.0687, 0.7, 0.05)
_KNEE = _Drive(_A4315, 150.0, 5.0, 45.0, 12.25, 0.033, 0.7, 0.02)
_ANKLE_PITCH = _Drive(_A4310, 110.0, 5.0, 40.0, 9.32, 0.0484, 0.4, 0.015)
_ANKLE_ROLL = _Drive(_A4310, 110.0, 5.0, 17.0, 9.32, 0.0484, 0.4, 0.015)
_WAIST = _Drive(_A6416, 65.0, 5.0, 40.0, 12.57, 0.0698, 0.7, 0.05)
_SHOULDER_PITCH = _Drive(_A5013, 57.0, 5.0, 30.0, 3.98, 0.14, 0.2, 0.02)
_SHOULDER_ROLL = _Drive(_A4315, 86.0, 5.0, 25.0, 12.25, 0.033, 0.7, 0.02)
_SHOULDER_YAW = _Drive(_A3814, 96.0, 5.0, 20.0, 5.45, 0.0687, 0.7, 0.05)
_ELBOW = _Drive(_A4310, 40.0, 2.0, 12.0, 9.32, 0.0242, 0.4, 0.015)
_NECK = _ELBOW  # motor and gains are unpublished; the neck link's mass fits the elbow's motor

_LEG = (
    # name, motor slot name, left range, left standing angle, drive, CAN slot
    ("hip_pitch", "Hip_Pitch", (-2.094395, 1.0), -0.15, _HIP_PITCH, 0),
    ("hip_roll", "Hip_Roll", (-0.785398, 0.785398), 0.0, _HIP_ROLL, 1),
    ("hip_yaw", "Hip_Yaw", (-0.785398, 0.785398), 0.0, _HIP_YAW, 2),
    ("knee", "Knee", (0.0, 1.5), 0.45, _KNEE, 3),
    ("ankle_pitch", "Ankle_A", (-0.35, 0.35), -0.3, _ANKLE_PITCH, 4),
    ("ankle_roll", "Ankle_B", (-0.35, 0.35), 0.0, _ANKLE_ROLL, 5),
)
_ARM = (
    ("shoulder_pitch", "Shoulder_Pitch", (-3.141593, 0.872665), -0.25, _SHOULDER_PITCH, 0),
    ("shoulder_roll", "Shoulder_Roll", (-1.570796, 0.0), -0.05, _SHOULDER_ROLL, 1),
    ("shoulder_yaw", "Shoulder_Yaw", (-1.570796, 1.570796), 0.0, _SHOULDER_YAW, 2),
    ("elbow", "Elbow", (0.0, 2.443461), 0.4, _ELBOW, 3),
    ("wrist_yaw", "Wrist_Yaw", (-3.141593, 3.141593), 0.0, _ELBOW, 4),
)


def _joint(
    name: str,
    motor_name: str,
    limits: tuple[float, float],
    stand: float,
    drive: _Drive,
    can_slot: int,
    assumed: bool = False,
) -> Joint:
    return Joint(
        name=f"{name}_joint",
        motor_name=motor_name,
        body=f"{name}_link",
        range=limits,
        stand=stand,
        can_slot=can_slot,
        assumed=assumed,
        **vars(drive),
    )


def _limb(rows: Sequence[tuple[str, str, tuple[float, float], float, _Drive, int]], side: str) -> tuple[Joint, ...]:
    """Joints of a limb; the right one is the left one with every angle negated."""
    mirrored = side == "right"
    joints = []
    for name, slot, (low, high), stand, drive, can_slot in rows:
        limits = (-high, -low) if mirrored else (low, high)
        angle = -stand if mirrored else stand
        joints.append(_joint(f"{side}_{name}", f"{side[0].upper()}_{slot}", limits, angle + 0.0, drive, can_slot))
    return tuple(joints)


JOINTS: tuple[Joint, ...] = (
    *_limb(_LEG, "left"),
    *_limb(_LEG, "right"),
    *_limb(_ARM, "left"),
    *_limb(_ARM, "right"),
    _joint("waist_yaw", "Waist_Yaw", (-1.570796, 1.570796), 0.0, _WAIST, 0),
    _joint("neck_pitch", "Neck_Pitch", (-0.785398, 0.785398), 0.0, _NECK, 1, assumed=True),
    _joint("neck_yaw", "Neck_Yaw", (-1.570796, 1.570796), 0.0, _NECK, 2, assumed=True),
)
"""The 25 joints in joint order."""


def _read_only(values: Sequence[float] | Sequence[tuple[float, float]]) -> np.ndarray:
    array = np.asarray(values, dtype=np.float64)
    array.setflags(write=False)
    return array


JOINT_NAMES: tuple[str, ...] = tuple(joint.name for joint in JOINTS)
MOTOR_NAMES: tuple[str, ...] = tuple(joint.motor_name for joint in JOINTS)
BODY_NAMES: tuple[str, ...] = ("pelvis_link", *(joint.body for joint in JOINTS))
"""The robot's bodies: the pelvis, and the one that each joint moves."""

POLICY_JOINT_NAMES: tuple[str, ...] = (
    *JOINT_NAMES[:12],
    "waist_yaw_joint",
    *(joint.name for joint in _limb(_ARM, "right")),
    *(joint.name for joint in _limb(_ARM, "left")),
)
"""The 23 joints that a policy moves, in the order of its actions. The neck is held."""

STAND_POSITION = _read_only([joint.stand for joint in JOINTS])
RANGE = _read_only([joint.range for joint in JOINTS])
KP = _read_only([joint.kp for joint in JOINTS])
KD = _read_only([joint.kd for joint in JOINTS])
EFFORT = _read_only([joint.effort for joint in JOINTS])
VELOCITY_LIMIT = _read_only([joint.velocity_limit for joint in JOINTS])


def permutation(source: Sequence[str], target: Sequence[str]) -> np.ndarray:
    """Indices that reorder a vector from `source` to `target` order: `vector[..., permutation(source, target)]`.

    Args:
        source: names in the order of the vector at hand.
        target: names in the wanted order; each must occur in `source`.

    Raises:
        ValueError: a name of `target` is missing from `source`.
    """
    places = {name: index for index, name in enumerate(source)}
    missing = [name for name in target if name not in places]
    if missing:
        raise ValueError(f"joint names {missing} are not among {list(source)}")
    indices = np.array([places[name] for name in target], dtype=np.intp)
    indices.setflags(write=False)
    return indices


POLICY_TO_JOINT = permutation(JOINT_NAMES, POLICY_JOINT_NAMES)
"""Place in joint order of each policy joint, shape (23,): `joint_vector[..., POLICY_TO_JOINT]` is in policy order."""
NECK = permutation(JOINT_NAMES, ("neck_pitch_joint", "neck_yaw_joint"))
"""Places of the two neck joints in joint order."""


def joint_index(name: str) -> int:
    """Place of a joint in joint order.

    Raises:
        ValueError: the name is unknown; the message lists the known ones.
    """
    try:
        return JOINT_NAMES.index(name)
    except ValueError:
        raise ValueError(f"unknown joint {name!r}; the joints are {', '.join(JOINT_NAMES)}") from None
