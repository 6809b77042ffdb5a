"""MOVE/POLICY: the network at 50 Hz, watched for failure."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from asimov_gym.firmware.linkage import Linkage
from asimov_gym.physics import JointTarget, Reading
from asimov_gym.policy import Policy, PolicyDriver, clip_command, joint_gains
from asimov_gym.robot.alerts import AlertId

_NOT_FINITE = 2**32 - 1
"""Value of a POLICY_SPAZ alert whose cause is NaN or infinity."""


class PolicyFault(Exception):
    """The network failed; carries the alert to raise."""

    def __init__(self, alert: AlertId, message: str, value: int = 0, threshold: int = 0) -> None:
        super().__init__(message)
        self.alert = alert
        self.value = value
        self.threshold = threshold


@dataclass
class InferenceTime:
    """How long the network took, wall-clock."""

    count: int = 0
    total_ms: float = 0.0
    max_ms: float = 0.0

    @property
    def average_ms(self) -> float:
        return self.total_ms / self.count if self.count else 0.0

    def add(self, milliseconds: float) -> None:
        self.count += 1
        self.total_ms += milliseconds
        self.max_ms = max(self.max_ms, milliseconds)


class PolicyControl:
    """Drives one robot with a network: command clamp, gains, and the watch over its output.

    Args:
        policy: the network.
        action_limit: outputs beyond this, before clipping, are a runaway policy.
        linkage: between the joints that the network thinks in and those of the machine.
    """

    def __init__(self, policy: Policy, action_limit: float, linkage: Linkage) -> None:
        self.contract = policy.contract
        self.time = InferenceTime()
        self._driver = PolicyDriver(policy, copies=1)
        self._limit = action_limit
        self._linkage = linkage
        self._kp, self._kd = (gains[None] for gains in joint_gains(self.contract))

    def reset(self) -> None:
        """Start afresh: no last action, gait clock at its start."""
        self._driver.reset()

    def limit(self, command: np.ndarray) -> np.ndarray:
        """A velocity (3,) within the range the policy was trained for."""
        return clip_command(self.contract, command)

    def step(self, reading: Reading, command: np.ndarray) -> JointTarget:
        """One policy step, 20 ms.

        Args:
            reading: the robot, a batch of one.
            command: vx, vy (m/s) and yaw rate (rad/s), (3,).

        Raises:
            PolicyFault: the network raised an error, or its output is not finite or beyond the action limit.
        """
        start = time.perf_counter()
        try:
            target = self._driver.step(
                gyro=reading.gyro,
                gravity=reading.gravity,
                command=command[None],
                joint_position=self._linkage.measured_position(reading.joint_position),
                joint_velocity=self._linkage.measured_velocity(reading.joint_velocity, reading.joint_position),
            )
        except Exception as error:  # whatever goes wrong in a foreign network must end in a safe robot
            raise PolicyFault(AlertId.INFERENCE_FAILURE, f"{type(error).__name__}: {error}") from error
        self.time.add(1000.0 * (time.perf_counter() - start))
        self._check(self._driver.raw)
        return JointTarget(self._linkage.reached_position(target), kp=self._kp, kd=self._kd)

    def _check(self, output: np.ndarray) -> None:
        largest = float(np.abs(output).max())
        if largest <= self._limit:
            return
        threshold = round(1000.0 * self._limit)
        if not np.isfinite(largest):
            raise PolicyFault(AlertId.POLICY_SPAZ, "the network's output is not finite", _NOT_FINITE, threshold)
        value = min(round(1000.0 * largest), _NOT_FINITE - 1)
        raise PolicyFault(AlertId.POLICY_SPAZ, f"network output {largest:.1f} beyond {self._limit}", value, threshold)
