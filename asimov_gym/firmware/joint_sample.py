"""The robot after one physics step, as joint control reports it: a thousand times a second while that is open."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from asimov_gym.firmware.joint_command import FEET, contact_made
from asimov_gym.firmware.joint_control import Echo, JointControl
from asimov_gym.firmware.linkage import Linkage
from asimov_gym.physics import Reading


@dataclass(frozen=True)
class JointSample:
    """One instant of the robot. Joint arrays are (25,) in joint order, the ankles as pitch and roll."""

    time_us: int
    """Real time of the robot's clock, microseconds since 1970."""
    position: np.ndarray
    """As sensed, rad."""
    velocity: np.ndarray
    """As sensed, rad/s."""
    load: np.ndarray
    """Torque of the drives during the step that ended here, N·m."""
    base_position: np.ndarray
    """Pelvis origin, world, m, (3,)."""
    base_quat: np.ndarray
    """Pelvis orientation (w, x, y, z), body to world, as sensed, (4,)."""
    base_velocity: np.ndarray
    """Velocity of the pelvis origin, world, m/s, (3,)."""
    gyro: np.ndarray
    """Angular velocity, body frame, as sensed, rad/s, (3,)."""
    specific_force: np.ndarray | None
    """What the accelerometer in the pelvis feels, body frame, m/s², (3,): (0, 0, 9.81) for a robot at rest. None while
    the IMU is stopped."""
    contacts: tuple[bool, ...]
    """Whether each foot, left before right, counts as in contact."""
    echo: Echo
    """Of the last joint command that the step knew of."""


class JointSampler:
    """Makes the samples; knows which foot counted as in contact in the last one.

    Args:
        linkage: through which the firmware reads the ankles.
        contact_force: N that a foot bears when it touches the ground.
    """

    def __init__(self, linkage: Linkage, contact_force: float) -> None:
        self._linkage = linkage
        self._contact_force = contact_force
        self._contacts = (False,) * FEET

    def sample(
        self, time_us: int, true: Reading, seen: Reading, specific_force: np.ndarray | None, joints: JointControl
    ) -> JointSample:
        """The robot at one instant. Asked twice for the same one, it says the same.

        Args:
            time_us: real time, microseconds since 1970.
            true: the robot as it is, a batch of one.
            seen: as sensed, likewise.
            specific_force: of the IMU, None while it is stopped, m/s², (3,).
            joints: for the echo and the contact advice.
        """
        touching = (np.abs(true.foot_force[0]).max(axis=-1) >= self._contact_force).tolist()
        feet = zip(self._contacts, touching, joints.advice, strict=True)
        self._contacts = tuple(contact_made(made, touches, advice) for made, touches, advice in feet)
        return JointSample(
            time_us=time_us,
            position=self._linkage.measured_position(seen.joint_position)[0],
            velocity=self._linkage.measured_velocity(seen.joint_velocity, seen.joint_position)[0],
            load=true.joint_torque[0],
            base_position=true.base_position[0],
            base_quat=seen.base_quat[0],
            base_velocity=true.base_velocity[0],
            gyro=seen.gyro[0],
            specific_force=specific_force,
            contacts=self._contacts,
            echo=joints.echo,
        )
