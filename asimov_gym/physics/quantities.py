"""What goes into a physics step and what comes out of it. All joint arrays are in joint order, batch first."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from asimov_gym.physics.places import JointPlaces
from asimov_gym.robot.array_library import namespace
from asimov_gym.robot.frames import projected_gravity

SPEED_LIMIT = 200.0
"""Generalised speeds beyond this (m/s, rad/s) count as a diverged simulation."""


def is_sound(qpos: Any, qvel: Any) -> Any:
    """Copies whose simulation has not diverged, (N,) bool, from positions (N, nq) and velocities (N, nv)."""
    xp = namespace(qpos)
    slow = xp.all(xp.abs(qvel) < SPEED_LIMIT, axis=1)  # false also where a speed is not a number
    return slow & xp.all(xp.isfinite(qpos), axis=1)


def are_sound(qpos: np.ndarray, qvel: np.ndarray) -> bool:
    """Whether no copy's simulation has diverged; arguments as for `is_sound`."""
    return bool(qvel.max() < SPEED_LIMIT and qvel.min() > -SPEED_LIMIT and np.isfinite(qpos).all())


@dataclass(frozen=True)
class JointTarget:
    """Command of the one control law, `torque = kp (position - q) + kd (velocity - q') + load`.

    The sum is clamped to the joint's effort.

    Each array is (N, 25), held for every substep, or (N, S, 25), one row for each of S substeps.
    """

    position: Any
    """rad."""
    velocity: Any | None = None
    """rad/s; zero when omitted."""
    load: Any | None = None
    """Feed-forward torque, N·m; zero when omitted."""
    kp: Any | None = None
    """N·m/rad; the model's gains when omitted."""
    kd: Any | None = None
    """N·m·s/rad; the model's gains when omitted."""


def delayed_position(history: Any, delay: Any, substeps: int) -> Any:
    """Per-substep targets when commands act `delay` physics steps late, (N, substeps, 25).

    Args:
        history: targets of the present policy step and the ones before, newest first, (N, H, 25).
        delay: whole physics steps, (N,) int, at most `substeps * (H - 1)`.
        substeps: physics steps per policy step.
    """
    xp = namespace(history)
    late = delay[:, None] - xp.arange(substeps)[None, :]
    age = xp.where(late > 0, (late + substeps - 1) // substeps, xp.zeros_like(late))
    rows = xp.arange(history.shape[0])[:, None]
    return history[rows, age]


@dataclass(frozen=True)
class Reading:
    """State of N robots after a step.

    Foot and torque entries are measured at the start of the last physics step (5 ms earlier than the rest), as MuJoCo's
    sensors are.
    """

    base_position: Any
    """Pelvis origin, world, m, (N, 3)."""
    base_quat: Any
    """Pelvis orientation (w, x, y, z), body to world, (N, 4)."""
    base_velocity: Any
    """Velocity of the pelvis origin, world, m/s, (N, 3)."""
    gyro: Any
    """Angular velocity, body frame, rad/s, (N, 3)."""
    gravity: Any
    """Unit vector to the ground, body frame, (N, 3)."""
    joint_position: Any
    """rad, (N, 25)."""
    joint_velocity: Any
    """rad/s, (N, 25)."""
    joint_torque: Any
    """Torque of the drives after clamping, N·m, (N, 25)."""
    foot_position: Any
    """Site under each foot (left, right), world, m, (N, 2, 3)."""
    foot_velocity: Any
    """World, m/s, (N, 2, 3)."""
    foot_up: Any
    """The soles' upward direction, world unit vectors, (N, 2, 3)."""
    foot_force: Any
    """Net force of the ground on each foot, world, N, (N, 2, 3)."""

    @classmethod
    def assemble(
        cls,
        qpos: Any,
        qvel: Any,
        joints: JointPlaces,
        *,
        joint_torque: Any,
        foot_position: Any,
        foot_velocity: Any,
        foot_up: Any,
        foot_force: Any,
    ) -> Reading:
        """The reading of generalised positions (N, nq), velocities (N, nv) and what sensors say."""
        quat = qpos[:, 3:7]
        return cls(
            base_position=qpos[:, 0:3],
            base_quat=quat,
            base_velocity=qvel[:, 0:3],
            gyro=qvel[:, 3:6],
            gravity=projected_gravity(quat),
            joint_position=qpos[:, joints.position],
            joint_velocity=qvel[:, joints.velocity],
            joint_torque=joint_torque,
            foot_position=foot_position,
            foot_velocity=foot_velocity,
            foot_up=foot_up,
            foot_force=foot_force,
        )

    def astype(self, dtype: Any) -> Reading:
        """The same reading in another floating type."""
        return Reading(**{name: array.astype(dtype) for name, array in vars(self).items()})


@dataclass(frozen=True)
class PhysicsState:
    """Everything needed to continue a simulation exactly."""

    time: np.ndarray
    """s, (N,)."""
    qpos: np.ndarray
    """Generalised positions in the model's order, (N, nq)."""
    qvel: np.ndarray
    """(N, nv)."""
    warmstart: np.ndarray
    """Accelerations that the constraint solver starts from, (N, nv)."""
    sensors: np.ndarray
    """Sensor values of the last step, (N, nsensordata)."""
