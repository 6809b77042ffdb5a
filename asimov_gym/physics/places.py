"""Where the robot's quantities stand in a model's vectors: positions, velocities, sensor values.

A run of neighbours is kept as a slice. Looking at a slice costs a tenth of gathering by an index array, and a single
robot's control loop does it a dozen times each 5 ms.
"""

from __future__ import annotations

import mujoco
import numpy as np

from asimov_gym.robot.joints import JOINT_NAMES

Places = slice | np.ndarray
"""An index into a vector: a slice, or an array of places."""


def as_places(indices: np.ndarray) -> Places:
    """Whole numbers as a slice where each is one more than the last, else as they are."""
    if np.array_equal(indices, indices[0] + np.arange(len(indices))):
        return slice(int(indices[0]), int(indices[-1]) + 1)
    return indices


class JointPlaces:
    """The 25 joints, joint order, in a model's generalised positions and velocities."""

    def __init__(self, model: mujoco.MjModel) -> None:
        joints = [model.joint(name) for name in JOINT_NAMES]
        self.position = as_places(np.array([j.qposadr[0] for j in joints]))
        self.velocity = as_places(np.array([j.dofadr[0] for j in joints]))


class SensorPlaces:
    """Torques of the joints, joint order, vectors of the two feet, left before right, and the accelerometer, in a row
    of sensor values."""

    def __init__(self, model: mujoco.MjModel) -> None:
        def places(*names: str) -> Places:
            sensors = [model.sensor(name) for name in names]
            return as_places(np.concatenate([np.arange(s.adr[0], s.adr[0] + s.dim[0]) for s in sensors]))

        def feet(quantity: str) -> Places:
            return places(f"left_foot_{quantity}", f"right_foot_{quantity}")

        self.torque = places(*(name.removesuffix("_joint") + "_torque" for name in JOINT_NAMES))
        self.foot_position = feet("position")
        self.foot_velocity = feet("velocity")
        self.foot_up = feet("up")
        self.foot_force = feet("force")
        self.accelerometer = places("imu_accelerometer")
