"""The motors' torque-speed limit applied to the control law.

The physics clamps a joint's torque to its effort, whatever its speed; a motor gives less the faster it turns. Each
control step the law's torque at the present reading is followed to the motors (ankles through the linkage), held
against `motor_torque_limits`, and where a motor cannot give it the joint's gains and load are scaled down so that the
law asks for what the motor has. The two motors of a foot give in together, by the share of the weaker one.

The approximation: within a step of 5 ms the law moves on with the joint while the scale stays, so that the torque can
be off by the damping gain times the change of speed. Braking is never limited below the effort, and at rest no limit
binds.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from asimov_gym.firmware.linkage import Linkage
from asimov_gym.physics import JointTarget
from asimov_gym.robot.joints import EFFORT, JOINT_NAMES
from asimov_gym.robot.motor import NO_LOAD_SPEED, PEAK_TORQUE, motor_torque_limits

_FEET = tuple(
    slice(JOINT_NAMES.index(f"{side}_ankle_pitch_joint"), JOINT_NAMES.index(f"{side}_ankle_roll_joint") + 1)
    for side in ("left", "right")
)


class TorqueLimits:
    """Holds a joint target against the motors' torque-speed limit.

    Args:
        kp: gains of targets that name none, N·m/rad, (25,), joint order.
        kd: likewise, N·m·s/rad.
        linkage: between ankle joints and motors.
    """

    def __init__(self, kp: np.ndarray, kd: np.ndarray, linkage: Linkage) -> None:
        self._kp, self._kd, self._linkage = kp[None], kd[None], linkage
        self._effort = EFFORT[None]
        # Motor speeds per joint speed, (25, 25); the exact linkage gears up to twice as much at the end of its travel.
        unit, middle = np.eye(len(JOINT_NAMES)), np.zeros(len(JOINT_NAMES))
        gear = np.stack([np.abs(linkage.motor_velocity(speed, middle)) for speed in unit], axis=1)
        self._gear = gear if linkage.form == "linear" else np.where(gear == unit, gear, 2.0 * gear)
        self._slow = self._harmless_speed(linkage)

    @staticmethod
    def _harmless_speed(linkage: Linkage) -> np.ndarray:
        """Motor speeds below which the limit cannot bind, rad/s, (25,): the motor still has all it can be asked for."""
        # At most its joint's effort, or both efforts of its foot at once.
        asked = np.abs(linkage.motor_torque(EFFORT, np.zeros(len(JOINT_NAMES))))
        for foot in _FEET:
            asked[foot] = asked[foot].max()
        return NO_LOAD_SPEED * (1.0 - np.minimum(1.0, asked / PEAK_TORQUE))

    def apply(self, target: JointTarget, position: np.ndarray, velocity: np.ndarray) -> JointTarget:
        """The target, with less gain where a motor could not follow it.

        Args:
            target: one robot's, arrays (1, 25).
            position: of the joints, rad, (1, 25).
            velocity: of the joints, rad/s, (1, 25).
        """
        if (self._gear @ np.abs(velocity[0]) < self._slow).all():
            return target
        kp = self._kp if target.kp is None else target.kp
        kd = self._kd if target.kd is None else target.kd
        wanted = 0.0 if target.velocity is None else target.velocity
        law = kp * (target.position - position) + kd * (wanted - velocity)
        if target.load is not None:
            law = law + target.load
        clamped = np.minimum(np.maximum(law, -self._effort), self._effort)
        torque = self._linkage.motor_torque(clamped[0], position[0])
        low, high = motor_torque_limits(self._linkage.motor_velocity(velocity[0], position[0]))
        over = (torque > high) | (torque < low)
        if not over.any():
            return target
        share = np.ones(len(JOINT_NAMES))
        share[over] = np.where(torque > 0.0, high, low)[over] / torque[over]
        for foot in _FEET:
            share[foot] = share[foot].min()
        weak = share < 1.0
        scale = np.ones((1, len(JOINT_NAMES)))
        # A law beyond the joint's effort must first come down to it; a joint without torque keeps its gains.
        scale[0, weak] = share[weak] * np.divide(
            clamped[0, weak], law[0, weak], out=np.ones(int(weak.sum())), where=law[0, weak] != 0.0
        )
        load = None if target.load is None else target.load * scale
        return replace(target, kp=kp * scale, kd=kd * scale, load=load)
