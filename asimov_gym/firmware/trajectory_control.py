"""MOVE/TRAJECTORY: the last trajectory taken, its gains checked, its silence watched."""

from __future__ import annotations

import numpy as np

from asimov_gym.firmware.alerts import AlertBoard
from asimov_gym.firmware.clock import MICROSECONDS
from asimov_gym.firmware.commands import Trajectory
from asimov_gym.firmware.linkage import Linkage
from asimov_gym.physics import JointTarget
from asimov_gym.robot.alerts import AlertId
from asimov_gym.robot.joints import JOINT_NAMES, RANGE

KP_LIMIT = 500.0
"""Greatest position gain that a motor takes on its bus, N·m/rad."""
KD_LIMIT = 5.0
"""Greatest damping gain that a motor takes on its bus, N·m·s/rad."""


class TrajectoryControl:
    """Turns trajectories into joint targets.

    Args:
        linkage: between ankle joints and motors.
        timeout_s: silence after which a trajectory without a time of its own ends.
    """

    def __init__(self, linkage: Linkage, timeout_s: float) -> None:
        self._linkage = linkage
        self._timeout_s = timeout_s
        self._limits = (np.full(len(JOINT_NAMES), KP_LIMIT), np.full(len(JOINT_NAMES), KD_LIMIT))
        self.reset()

    def reset(self) -> None:
        """Forget the last trajectory."""
        self.last: Trajectory | None = None
        self._target: JointTarget | None = None
        self._until_us = 0

    def take(self, trajectory: Trajectory, board: AlertBoard, now_us: int) -> None:
        """Follow a trajectory from now on.

        Gains that no motor would take (negative, or beyond what its bus carries) raise INVALID_GAINS, and the default
        gains stand in for the whole array. The edge clamps what it lets through, so this catches other callers.

        Args:
            trajectory: targets and gains.
            board: takes the alert.
            now_us: firmware time.
        """
        self.last = trajectory
        seconds = self._timeout_s if trajectory.timeout_s is None else trajectory.timeout_s
        self._until_us = now_us + round(seconds * MICROSECONDS)
        position = np.clip(trajectory.position, RANGE[:, 0], RANGE[:, 1])
        kp, kd = trajectory.kp, trajectory.kd
        if kp is not None or kd is not None:
            kp_limit, kd_limit = self._linkage.joint_gains(*self._limits, position)
            kp, kd = self._usable(kp, kp_limit, board, now_us), self._usable(kd, kd_limit, board, now_us)
        self._target = JointTarget(position[None], kp=kp, kd=kd)

    def silent(self, now_us: int) -> bool:
        """Whether the last trajectory's time is up."""
        return now_us >= self._until_us

    @property
    def target(self) -> JointTarget:
        """The present joint target.

        Raises:
            RuntimeError: no trajectory was taken yet.
        """
        if self._target is None:
            raise RuntimeError("no trajectory was taken in this boot")
        return self._target

    def _usable(self, gain: np.ndarray | None, limit: np.ndarray, board: AlertBoard, now_us: int) -> np.ndarray | None:
        if gain is None:
            return None
        bad = (gain < 0.0) | (gain > limit * (1.0 + 1e-6))  # gains come as 32-bit floats
        if not bad.any():
            return gain[None]
        joint = int(np.flatnonzero(bad)[0])
        value, bound = abs(float(gain[joint])), float(limit[joint]) if gain[joint] > 0.0 else 0.0
        board.set(AlertId.INVALID_GAINS, now_us, min(round(100.0 * value), 2**32 - 1), round(100.0 * bound), joint)
        return None
