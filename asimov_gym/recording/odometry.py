"""Where the robot walked, from what it reported: leg odometry.

Telemetry has no position and no linear velocity of the pelvis. Both follow from the legs while a foot stands: the lower
foot is taken to rest on the ground, so the pelvis moves against it as the joints and the gyro say. Heights are those at
which the lower sole touches the ground. Slipping, flight and a robot that hangs on its gantry are not seen.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from asimov_gym.physics import CPhysics
from asimov_gym.recording.series import TelemetrySeries
from asimov_gym.robot.feet import SOLE_DEPTH
from asimov_gym.robot.frames import heading, to_heading, yaw_rate
from asimov_gym.robot.joints import JOINT_NAMES

_FEET = ("left_foot", "right_foot")


@dataclass(frozen=True)
class Odometry:
    """Estimated motion of the pelvis at each sample of a series, n samples."""

    time: np.ndarray
    """As of the series, s, (n,)."""
    qpos: np.ndarray
    """Generalised positions of the model, (n, nq); the walk starts at x = y = 0."""
    velocity: np.ndarray
    """Forward and left (m/s) in the heading frame, and yaw rate (rad/s), (n, 3)."""

    def poses(self, interval: float) -> np.ndarray:
        """Generalised positions every `interval` seconds, interpolated between samples, (m, nq)."""
        if len(self.time) < 2:
            return self.qpos.copy()
        at = np.arange(self.time[0], self.time[-1] + 1e-9, interval)
        after = np.clip(np.searchsorted(self.time, at), 1, len(self.time) - 1)
        before = after - 1
        share = np.clip((at - self.time[before]) / np.maximum(self.time[after] - self.time[before], 1e-9), 0.0, 1.0)
        start, end = self.qpos[before], self.qpos[after].copy()
        # A quaternion and its negative are one orientation: go the short way.
        end[:, 3:7] *= np.where((start[:, 3:7] * end[:, 3:7]).sum(axis=1, keepdims=True) < 0.0, -1.0, 1.0)
        poses = start + share[:, None] * (end - start)
        poses[:, 3:7] /= np.linalg.norm(poses[:, 3:7], axis=1, keepdims=True)
        return poses


def estimate_motion(series: TelemetrySeries, physics: CPhysics | None = None) -> Odometry:
    """Leg odometry over a series of telemetry.

    Args:
        series: at 200 Hz it resolves each step; at 10 Hz the speed at each instant is right, the way only roughly.
        physics: one robot whose model to use; the shipped one when None.
    """
    physics = physics or CPhysics(1, "evaluation")
    model = physics.model
    data = mujoco.MjData(model)
    dofs = np.array([int(model.joint(name).dofadr[0]) for name in JOINT_NAMES])
    joints, speeds = series.joint_position(), series.joint_velocity()
    quats = series.imu_quat / np.linalg.norm(series.imu_quat, axis=-1, keepdims=True)
    qpos = physics.configuration(joints, np.zeros((len(joints), 3)), quats)
    velocity = np.zeros((len(qpos), 3))
    for i in range(len(qpos)):
        data.qpos[:] = qpos[i]
        # As if the pelvis' origin stood still: whatever the foot on the ground then does, the pelvis does reversed.
        data.qvel[:] = 0.0
        data.qvel[3:6] = series.imu_gyro[i]
        data.qvel[dofs] = speeds[i]
        mujoco.mj_forward(model, data)
        positions = [data.sensor(f"{foot}_position").data for foot in _FEET]
        lower = int(positions[1][2] < positions[0][2])
        qpos[i, 2] = SOLE_DEPTH - positions[lower][2]
        velocity[i] = -data.sensor(f"{_FEET[lower]}_velocity").data
    steps = np.diff(series.time, prepend=series.time[:1])
    qpos[:, :2] = np.cumsum(velocity[:, :2] * steps[:, None], axis=0)
    level = to_heading(heading(quats), velocity)
    rate = yaw_rate(series.imu_gravity, series.imu_gyro)
    return Odometry(series.time, qpos, np.column_stack([level[:, :2], rate]))
