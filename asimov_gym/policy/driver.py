"""The 50 Hz loop around a policy, the same in firmware, environment and evaluation.

Senses and a velocity command go in, joint targets come out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from asimov_gym.policy.contract import PolicyContract, clip_action, clip_command, targets
from asimov_gym.policy.runner import Policy
from asimov_gym.robot import gait_clock
from asimov_gym.robot.array_library import namespace
from asimov_gym.robot.joints import POLICY_TO_JOINT, STAND_POSITION
from asimov_gym.robot.observation import observation_layout

_FROM_POLICY = np.zeros(len(STAND_POSITION), dtype=np.intp)
_FROM_POLICY[POLICY_TO_JOINT] = np.arange(len(POLICY_TO_JOINT))
_HELD = np.ones(len(STAND_POSITION), dtype=bool)
_HELD[POLICY_TO_JOINT] = False


@dataclass(frozen=True)
class PolicyState:
    """What a driven policy remembers from step to step, for n robots."""

    action: Any
    """Last network output after clipping, policy order, float32, (n, 23)."""
    phase: Any
    """Gait phase of the left foot, rad, (n,)."""


@dataclass(frozen=True)
class PolicyStep:
    """A step of a driven policy, for n robots."""

    state: PolicyState
    """After the step."""
    command: Any
    """Within the trained ranges, (n, 3)."""
    observation: Any
    """What the network saw, float32, (n, width)."""
    raw: Any
    """What it answered, before clipping, (n, 23)."""
    targets: Any
    """Joint targets, rad, joint order, (n, 25); the neck stands."""


class PolicyLaw:
    """What a policy does in a step, as a pure function over arrays of any library."""

    def __init__(self, contract: PolicyContract) -> None:
        """Prepare for a contract.

        Raises:
            ValueError: its layout is unknown.
        """
        self.contract = contract
        self.layout = observation_layout(contract.observation.layout)
        # The layout measures positions from the standing pose, a policy from its own default; zero for our policies.
        self._pose_shift = np.zeros_like(STAND_POSITION)
        self._pose_shift[POLICY_TO_JOINT] = STAND_POSITION[POLICY_TO_JOINT] - np.array(contract.default_joint_pos)

    def step(
        self,
        state: PolicyState,
        infer: Callable[[Any], Any],
        *,
        gyro: Any,
        gravity: Any,
        command: Any,
        joint_position: Any,
        joint_velocity: Any,
    ) -> PolicyStep:
        """One policy step; the arguments are those of `PolicyDriver.step`, and the network as a function."""
        xp, contract = namespace(joint_position), self.contract
        within = clip_command(contract, command)
        moving = gait_clock.is_moving(within, contract.standing_threshold)
        observation = self.layout.observe(
            gyro=gyro,
            gravity=gravity,
            command=within,
            joint_position=joint_position + xp.asarray(self._pose_shift, dtype=joint_position.dtype),
            joint_velocity=joint_velocity,
            action=state.action,
            clock=gait_clock.signal(state.phase, moving),
        )
        raw = infer(observation)
        action, phase = clip_action(contract, raw), state.phase
        if contract.gait_frequency_hz is not None:
            phase = gait_clock.advance(phase, moving, contract.gait_frequency_hz, 1.0 / contract.policy_rate_hz)
        driven = targets(contract, xp.astype(action, joint_position.dtype))
        stand = xp.asarray(STAND_POSITION, dtype=joint_position.dtype)
        joint_targets = xp.where(xp.asarray(_HELD), stand, xp.take(driven, xp.asarray(_FROM_POLICY), axis=-1))
        return PolicyStep(PolicyState(action, phase), within, observation, raw, joint_targets)


class PolicyDriver:
    """Drives n robots with one policy, one call of `step` each 1/50 s.

    The order of things is that of training: the observation shows the clock's phase and the action of the step before,
    and the clock advances after the network has run.
    """

    def __init__(self, policy: Policy, copies: int = 1) -> None:
        """Start with no last action and the clock at phase 0.

        Args:
            policy: the network.
            copies: number of robots, n.

        Raises:
            ValueError: `copies` is below 1, or the policy's layout is unknown.
        """
        if copies < 1:
            raise ValueError(f"copies must be at least 1, got {copies!r}")
        self.policy = policy
        self.copies = copies
        self.contract = policy.contract
        self._law = PolicyLaw(self.contract)
        actions = len(POLICY_TO_JOINT)
        self._action = np.zeros((copies, actions), dtype=np.float32)
        self._phase = np.zeros(copies)
        self._raw = np.zeros((copies, actions), dtype=np.float32)
        self._command = np.zeros((copies, 3))
        self._observation = np.zeros((copies, self._law.layout.width), dtype=np.float32)

    def reset(self, mask: np.ndarray | None = None, phase: float | np.ndarray = 0.0) -> None:
        """Forget the last action and restart the clock.

        Args:
            mask: robots to reset, (n,) bool; None for all.
            phase: new gait phase in rad, one for all or (n,).

        Raises:
            ValueError: wrong shape.
        """
        chosen = np.ones(self.copies, dtype=bool) if mask is None else np.asarray(mask)
        if chosen.shape != (self.copies,) or chosen.dtype != bool:
            raise ValueError(f"mask must be bool of shape ({self.copies},), got {chosen.dtype} of shape {chosen.shape}")
        self._action = np.where(chosen[:, None], np.float32(0.0), self._action)
        self._raw = np.where(chosen[:, None], np.float32(0.0), self._raw)
        self._phase = np.where(chosen, np.broadcast_to(phase, (self.copies,)) % (2.0 * np.pi), self._phase)

    def step(
        self,
        gyro: np.ndarray,
        gravity: np.ndarray,
        command: np.ndarray,
        joint_position: np.ndarray,
        joint_velocity: np.ndarray,
    ) -> np.ndarray:
        """One policy step.

        Args:
            gyro: angular velocity in the body frame, rad/s, (n, 3).
            gravity: unit vector to the ground in the body frame, (n, 3).
            command: vx, vy (m/s) and yaw rate (rad/s), (n, 3); clamped to the trained ranges.
            joint_position: rad, joint order, (n, 25).
            joint_velocity: rad/s, joint order, (n, 25).

        Returns:
            Joint targets in rad, joint order, (n, 25); the neck stands. A robot whose senses or command are not finite
            gets targets that are not finite: see `finite`.

        Raises:
            ValueError: an argument has the wrong shape.
        """
        n = self.copies
        gyro, gravity = _shaped("gyro", gyro, (n, 3)), _shaped("gravity", gravity, (n, 3))
        position = _shaped("joint_position", joint_position, (n, len(STAND_POSITION)))
        velocity = _shaped("joint_velocity", joint_velocity, (n, len(STAND_POSITION)))
        s = self._law.step(
            PolicyState(self._action, self._phase),
            self.policy.infer,
            gyro=gyro,
            gravity=gravity,
            command=_shaped("command", command, (n, 3)),
            joint_position=position,
            joint_velocity=velocity,
        )
        self._command, self._observation, self._raw = s.command, s.observation, s.raw
        self._action, self._phase = s.state.action, s.state.phase
        return s.targets

    @property
    def state(self) -> PolicyState:
        """What the policy remembers now; a later step does not change it."""
        return PolicyState(self._action.copy(), self._phase.copy())

    @state.setter
    def state(self, state: PolicyState) -> None:
        self._action = _shaped("state.action", state.action, self._action.shape).astype(np.float32)
        self._phase = _shaped("state.phase", state.phase, self._phase.shape).copy()

    @property
    def raw(self) -> np.ndarray:
        """Output of the network at the last step, before clipping, (n, 23)."""
        return self._raw.copy()

    @property
    def finite(self) -> np.ndarray:
        """Robots whose last network output was finite, (n,) bool. The others need `reset` before they are driven on."""
        return np.all(np.isfinite(self._raw), axis=-1)

    @property
    def command(self) -> np.ndarray:
        """Command of the last step, within the trained ranges, (n, 3)."""
        return self._command.copy()

    @property
    def observation(self) -> np.ndarray:
        """What the network saw at the last step, float32, (n, width)."""
        return self._observation.copy()


def _shaped(name: str, value: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    array = np.asarray(value, dtype=np.float64)
    if array.shape != shape:
        raise ValueError(f"{name} must have shape {shape}, got {array.shape}")
    return array
