"""MOVE/POLICY: the network at 50 Hz, watched for failure and for lateness.

An answer counts from the moment it is there. Until then the robot follows the previous one, and the network is not
asked again: it is one thread.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

import numpy as np

from asimov_gym.firmware.alerts import AlertBoard
from asimov_gym.firmware.condition import Condition
from asimov_gym.firmware.linkage import Linkage
from asimov_gym.physics import DECIMATION, JointTarget, Reading
from asimov_gym.policy import Policy, PolicyDriver, clip_command, joint_gains
from asimov_gym.robot.alerts import AlertId
from asimov_gym.robot.joints import KD, KP

_NOT_FINITE = 2**32 - 1
"""Value of a POLICY_SPAZ alert whose cause is NaN or infinity."""


class PolicyFault(Exception):
    """The network failed; carries the alert to raise."""

    def __init__(self, alert: AlertId, message: str, value: int = 0, threshold: int = 0) -> None:
        super().__init__(message)
        self.alert = alert
        self.value = value
        self.threshold = threshold


@dataclass(frozen=True)
class InferenceConfig:
    """What the firmware thinks of the network."""

    action_limit: float = 10.0
    """A network output beyond this is a runaway policy: at 0.25 rad per unit it is past every joint's range.
    Assumed."""
    timeout_s: float = 0.1
    """POLICY_INFERENCE_TIMEOUT after this long without an answer. Assumed."""
    failure_s: float = 0.5
    """INFERENCE_FAILURE, which latches DAMP, after this long without an answer. Assumed."""

    def __post_init__(self) -> None:
        for name, high in (("action_limit", 1e6), ("timeout_s", 60.0), ("failure_s", 60.0)):
            value = getattr(self, name)
            if not (math.isfinite(value) and 0.0 < value <= high):
                raise ValueError(f"inference {name} must be above 0 and at most {high:g}, got {value!r}")


@dataclass(frozen=True)
class InferenceTime:
    """How long the network took, wall clock plus any injected delay."""

    count: int = 0
    total_ms: float = 0.0
    max_ms: float = 0.0

    @property
    def average_ms(self) -> float:
        return self.total_ms / self.count if self.count else 0.0

    def add(self, milliseconds: float) -> InferenceTime:
        """With one more inference."""
        return InferenceTime(self.count + 1, self.total_ms + milliseconds, max(self.max_ms, milliseconds))


@dataclass(frozen=True)
class _Answer:
    """An answer of the network that is under way."""

    asked_us: int
    due_us: int
    """When it is there, firmware time."""
    took_ms: float
    target: JointTarget


class PolicyControl:
    """Drives one robot with a network: command clamp, gains, and the watch over its output and its time.

    Args:
        policy: the network.
        config: limits of output and time.
        linkage: between the joints that the network thinks in and those of the machine.
        realtime: whether the time that inference takes on this machine counts. In lockstep it does not: the simulated
            clock stands still meanwhile, and only an injected delay makes an answer late.
    """

    def __init__(self, policy: Policy, config: InferenceConfig, linkage: Linkage, realtime: bool = True) -> None:
        self.policy = policy
        self.contract = policy.contract
        self.config = config
        self.time = InferenceTime()
        self._driver = PolicyDriver(policy, copies=1)
        self._linkage = linkage
        self._realtime = realtime
        self._period_ms = 1000.0 / self.contract.policy_rate_hz
        # The robot's own gains need not be said again, and lending others to the physics costs time in every step.
        kp, kd = joint_gains(self.contract)
        own = np.array_equal(kp, KP) and np.array_equal(kd, KD)
        self._kp, self._kd = (None, None) if own else (kp[None], kd[None])
        self.reset()

    def reset(self) -> None:
        """Start afresh: no last action, gait clock at its start, no answer yet."""
        self._driver.reset()
        self._ticks = 0
        self._pending: _Answer | None = None
        self._target: JointTarget | None = None

    def limit(self, command: np.ndarray) -> np.ndarray:
        """A velocity (3,) within the range the policy was trained for."""
        return clip_command(self.contract, command)

    def step(
        self, reading: Reading, command: np.ndarray, condition: Condition, board: AlertBoard, now_us: int
    ) -> JointTarget | None:
        """One control step, 5 ms; every fourth asks the network.

        Args:
            reading: the robot as sensed, a batch of one.
            command: vx, vy (m/s) and yaw rate (rad/s), (3,).
            condition: of the hardware; may delay or break the network.
            board: takes the alerts of a late network.
            now_us: firmware time.

        Returns:
            The target in force, None before the first answer.

        Raises:
            PolicyFault: the network raised an error or did not answer in time, or its output is not finite or beyond
                the action limit.
        """
        self._deliver(board, now_us)
        if self._ticks % DECIMATION == 0:
            if self._pending is None:
                self._pending = self._ask(reading, command, condition, now_us)
                self._deliver(board, now_us)
            else:
                self._complain(1e-3 * (now_us - self._pending.asked_us), board, now_us)
        self._ticks += 1
        return self._target

    def _deliver(self, board: AlertBoard, now_us: int) -> None:
        """Put an answer in force whose time has come."""
        answer = self._pending
        if answer is None or now_us < answer.due_us:
            return
        self._target, self._pending = answer.target, None
        if answer.took_ms > self._period_ms:
            self._complain(answer.took_ms, board, now_us)

    def _ask(self, reading: Reading, command: np.ndarray, condition: Condition, now_us: int) -> _Answer:
        start = time.perf_counter()
        try:
            if condition.policy_fails:
                raise RuntimeError("injected failure of the network")
            target = self._driver.step(
                gyro=reading.gyro,
                gravity=reading.gravity,
                command=command[None],
                joint_position=self._linkage.measured_position(reading.joint_position),
                joint_velocity=self._linkage.measured_velocity(reading.joint_velocity, reading.joint_position),
            )
        except Exception as error:  # whatever goes wrong in a foreign network must end in a safe robot
            raise PolicyFault(AlertId.INFERENCE_FAILURE, f"{type(error).__name__}: {error}") from error
        measured_ms = 1000.0 * (time.perf_counter() - start)
        self.time = self.time.add(measured_ms + condition.policy_delay_ms)
        self._check(self._driver.raw)
        target = JointTarget(self._linkage.reached_position(target), kp=self._kp, kd=self._kd)
        took_ms = condition.policy_delay_ms + (measured_ms if self._realtime else 0.0)
        return _Answer(now_us, now_us + round(1000.0 * condition.policy_delay_ms), took_ms, target)

    def _complain(self, waited_ms: float, board: AlertBoard, now_us: int) -> None:
        """Raise what an answer calls for that took, or has not come for, this long: past the next policy step."""
        value, period = round(10.0 * waited_ms), round(10.0 * self._period_ms)
        for alert in (AlertId.POLICY_LATE, AlertId.POLICY_DEADLINE_MISS):
            board.set(alert, now_us, value, period)
        if waited_ms >= 1000.0 * self.config.timeout_s:
            board.set(AlertId.POLICY_INFERENCE_TIMEOUT, now_us, value, round(1e4 * self.config.timeout_s))
        if waited_ms >= 1000.0 * self.config.failure_s:
            limit = round(1e4 * self.config.failure_s)
            raise PolicyFault(AlertId.INFERENCE_FAILURE, f"no answer for {waited_ms:.0f} ms", value, limit)

    def _check(self, output: np.ndarray) -> None:
        largest = float(np.abs(output).max())
        if largest <= self.config.action_limit:
            return
        limit, threshold = self.config.action_limit, round(1000.0 * self.config.action_limit)
        if not np.isfinite(largest):
            raise PolicyFault(AlertId.POLICY_SPAZ, "the network's output is not finite", _NOT_FINITE, threshold)
        value = min(round(1000.0 * largest), _NOT_FINITE - 1)
        raise PolicyFault(AlertId.POLICY_SPAZ, f"network output {largest:.1f} beyond {limit}", value, threshold)
