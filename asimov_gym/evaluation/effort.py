"""What a motion costs the drives: energy, torque and speed against their limits, and how smooth the actions are.

Plain arrays of one robot, T policy steps, joint order; torques N·m, speeds rad/s. Torques and speeds are samples at
the policy's rate, so a peak shorter than 20 ms may be missed.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from asimov_gym.robot import ankle
from asimov_gym.robot.joints import EFFORT, VELOCITY_LIMIT
from asimov_gym.robot.model import robot_model
from asimov_gym.robot.motor import NO_LOAD_SPEED, RATED_TORQUE

GRAVITY = 9.81
"""m/s²."""
LEAST_DISTANCE = 0.5
"""A cost of transport needs at least this way, m."""


@lru_cache(maxsize=1)
def robot_mass() -> float:
    """Mass of the robot in its default revision, kg."""
    return float(robot_model(visuals=False).body_mass.sum())


def cost_of_transport(torque: np.ndarray, speed: np.ndarray, dt: float, mass: float, distance: float) -> float | None:
    """Mechanical work of all drives, braking counted like driving, over weight times distance; None below half a metre.

    Args:
        torque: (T, 25).
        speed: (T, 25).
        dt: s.
        mass: of the robot with what it carries, kg.
        distance: way walked, m.
    """
    if distance < LEAST_DISTANCE:
        return None
    work = float(np.abs(torque * speed).sum(dtype=np.float64)) * dt
    return work / (mass * GRAVITY * distance)


def torque_rms_shares(torque: np.ndarray) -> np.ndarray:
    """Root mean square of each joint's torque as a share of its limit, (25,)."""
    return np.sqrt((np.asarray(torque, dtype=np.float64) ** 2).mean(axis=0)) / EFFORT


def torque_peak_shares(torque: np.ndarray) -> np.ndarray:
    """Largest torque of each joint as a share of its limit, (25,); 1 is saturated."""
    return np.abs(torque).max(axis=0) / EFFORT


def rated_torque_shares(torque: np.ndarray) -> np.ndarray:
    """Root mean square of each motor's torque as a share of its continuous rating, (25,), motor order.

    Heat follows the square of torque, so above 1 the motor overheats if the motion goes on.
    """
    motor = np.asarray(ankle.to_motor_torque(np.asarray(torque, dtype=np.float64)))
    return np.sqrt((motor**2).mean(axis=0)) / RATED_TORQUE


def speed_peak_shares(speed: np.ndarray) -> np.ndarray:
    """Largest speed of each joint as a share of its velocity limit, (25,)."""
    return np.abs(speed).max(axis=0) / VELOCITY_LIMIT


def no_load_shares(speed: np.ndarray) -> np.ndarray:
    """Largest speed of each motor as a share of the speed at which it has no torque left, (25,), motor order."""
    motor = np.asarray(ankle.to_motor_velocity(np.asarray(speed, dtype=np.float64)))
    return np.abs(motor).max(axis=0) / NO_LOAD_SPEED


def action_jerk(action: np.ndarray) -> float | None:
    """Mean over time and joints of the squared second difference of the actions, action units²; None below 3 steps.

    Args:
        action: clipped network outputs, (T, 23).
    """
    if len(action) < 3:
        return None
    return float((np.diff(np.asarray(action, dtype=np.float64), n=2, axis=0) ** 2).mean())
