"""The ankle linkage between what the firmware computes and what the machine does.

The firmware knows the linkage in its linear form. With `linear` mechanics the two agree: pitch and roll pass unchanged.
With `exact` mechanics a wanted angle is reached only in part, and a measured one is read off the motors with the same
small error, as on the real robot.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from asimov_gym.robot import ankle
from asimov_gym.robot.joints import JOINT_NAMES, joint_index

_FEET = np.array([[joint_index(f"{side}_ankle_{a}_joint") for a in ("pitch", "roll")] for side in ("left", "right")])
"""Places of the ankle joints, and of the motors A and B, of the left and the right foot."""


def _unit_speed(axis: int) -> tuple[np.ndarray, np.ndarray]:
    """Places of an ankle axis on both feet, and the joint speeds that turn it alone."""
    speed = np.zeros(len(JOINT_NAMES))
    speed[_FEET[:, axis]] = 1.0
    return _FEET[:, axis], speed


_UNIT_SPEEDS = (_unit_speed(0), _unit_speed(1))


@dataclass(frozen=True)
class Linkage:
    """Conversions of joint vectors (..., 25) under one form of the mechanism."""

    form: ankle.Form = "linear"

    def motor_position(self, joint: np.ndarray) -> np.ndarray:
        """Motor angles of a pose, rad."""
        return ankle.to_motor_position(joint, self.form)

    def motor_velocity(self, velocity: np.ndarray, joint: np.ndarray) -> np.ndarray:
        """Motor speeds, rad/s, at a pose."""
        return ankle.to_motor_velocity(velocity, joint, self.form)

    def motor_torque(self, torque: np.ndarray, joint: np.ndarray) -> np.ndarray:
        """Motor torques, N·m, at a pose."""
        return ankle.to_motor_torque(torque, joint, self.form)

    def joint_position(self, motor: np.ndarray) -> np.ndarray:
        """Pose of motor angles, rad."""
        return ankle.to_joint_position(motor, self.form)

    def joint_velocity(self, motor_velocity: np.ndarray, joint: np.ndarray) -> np.ndarray:
        """Joint speeds of motor speeds, rad/s, at a pose."""
        return ankle.to_joint_velocity(motor_velocity, joint, self.form)

    def joint_gains(self, kp: np.ndarray, kd: np.ndarray, joint: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Gains at the joints of gains at the motors, at a pose: each ankle joint gets its share of both motors.

        In the linear form that is `ankle.gains_to_joint` whatever the pose; in the exact one the slopes of the
        mechanism at the pose stand in the place of K_PITCH and K_ROLL.
        """
        if self.form == "linear":
            return ankle.gains_to_joint(kp, kd)
        gains = []
        for motor_gain in (kp, kd):
            joint_gain = motor_gain.copy()
            for axis, unit in _UNIT_SPEEDS:
                slope = ankle.to_motor_velocity(unit, joint, self.form)
                share = motor_gain * slope * slope
                joint_gain[axis] = share[_FEET].sum(axis=-1)
            gains.append(joint_gain)
        return gains[0], gains[1]

    def reached_position(self, wanted: np.ndarray) -> np.ndarray:
        """Pose that the mechanism reaches when the firmware drives its motors for a wanted one, rad."""
        if self.form == "linear":
            return wanted
        return ankle.to_joint_position(ankle.to_motor_position(wanted), self.form)

    def measured_position(self, joint: np.ndarray) -> np.ndarray:
        """Pose that the firmware computes from the motors' angles, rad."""
        if self.form == "linear":
            return joint
        return ankle.to_joint_position(self.motor_position(joint))

    def measured_velocity(self, velocity: np.ndarray, joint: np.ndarray) -> np.ndarray:
        """Joint speeds that the firmware computes from the motors' speeds, rad/s."""
        if self.form == "linear":
            return velocity
        return ankle.to_joint_velocity(self.motor_velocity(velocity, joint))
