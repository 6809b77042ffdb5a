"""The ankle linkage between what the firmware computes and what the machine does.

The firmware knows the linkage in its linear form. With `linear` mechanics the two agree: pitch and roll pass unchanged.
With `exact` mechanics a wanted angle is reached only in part, and a measured one is read off the motors with the same
small error, as on the real robot.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from asimov_gym.robot import ankle


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
