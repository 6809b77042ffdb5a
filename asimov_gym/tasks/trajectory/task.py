"""The trajectory task: actions, state, observation, reward and end of an episode as pure functions of batched arrays.

Actions and the reference are in motor order, as in the robot's trajectory commands; everything inside is in joint
order.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from asimov_gym.physics import DECIMATION, TIMESTEP, JointTarget, Reading
from asimov_gym.robot import ankle
from asimov_gym.robot.array_library import integer, namespace, real
from asimov_gym.robot.joints import JOINT_NAMES, RANGE
from asimov_gym.robot.motor import DEFAULT_HEAT, heat
from asimov_gym.robot.safety_limits import TRIP_C, has_fallen
from asimov_gym.tasks.outcome import Outcome, settle
from asimov_gym.tasks.trajectory import rewards, telemetry
from asimov_gym.tasks.trajectory.config import TrajectoryConfig
from asimov_gym.tasks.trajectory.motion import Motion, load_motion

DT = TIMESTEP * DECIMATION
"""Control step, s."""
MAX_KP, MAX_KD = 500.0, 5.0
"""Largest gains that the robot's interface takes, at the motors."""
_JOINTS = len(JOINT_NAMES)
_TOLERANCE = 1e-5
"""Targets this little beyond a limit do not count as clipped: float32 actions and the linkage round, rad."""

START_DRAWS = 1 + _JOINTS
"""Uniform numbers per copy that `initial_pose` needs."""


@dataclass(frozen=True)
class TrajectoryState:
    """What the task remembers of each copy."""

    step: Any
    """Control steps since the start, (N,)."""
    target: Any
    """Joint targets, newest first, rad, (N, 2, 25)."""
    temperature: Any
    """Of the motors, degrees Celsius, (N, 25)."""
    torque: Any
    """Of the motors at the last reading, N·m, (N, 25)."""


class TrajectoryTask:
    """The trajectory task under a configuration.

    Raises:
        MotionError: the configured motion is unknown or not one of this robot.
        FileNotFoundError: it is a file that does not exist.
    """

    def __init__(self, config: TrajectoryConfig | None = None, motion: Motion | None = None) -> None:
        self.config = TrajectoryConfig() if config is None else config
        self.motion = load_motion(self.config.motion, DT) if motion is None else motion
        self.episode_steps = max(1, round(self.config.episode_s / DT))
        self.motor_range = telemetry.motor_range(self.config.ankle)
        self.motor_frames = ankle.to_motor_position(self.motion.frames, self.config.ankle)
        self.action_low, self.action_high = self._action_bounds()

    def _action_bounds(self) -> tuple[np.ndarray, np.ndarray]:
        low, high = self.motor_range.T
        if not self.config.gains:
            return low, high
        zeros = np.zeros(2 * _JOINTS)
        top = np.concatenate([np.full(_JOINTS, MAX_KP), np.full(_JOINTS, MAX_KD)])
        return np.concatenate([low, zeros]), np.concatenate([high, top])

    # -- start ---------------------------------------------------------------------------------------------------------

    def initial_pose(self, draws: Any) -> tuple[Any, Any]:
        """Joint positions (N, 25) at the motion's first frame, a little disturbed, and headings (N,), rad, from draws
        (N, START_DRAWS)."""
        xp = namespace(draws)
        centred = 2.0 * draws - 1.0
        first = xp.asarray(self.motion.frames[0], dtype=draws.dtype)
        joints = first + self.config.start_noise * centred[:, 1:]
        low, high = (xp.asarray(RANGE[:, i], dtype=draws.dtype) for i in (0, 1))
        return xp.clip(joints, low, high), math.pi * centred[:, 0]

    def initial_state(self, joint_position: Any) -> TrajectoryState:
        """State of fresh copies that hold their pose (N, 25); their motors are cold and unloaded."""
        xp = namespace(joint_position)
        return TrajectoryState(
            step=xp.zeros(joint_position.shape[0], dtype=integer(xp)),
            target=xp.stack([joint_position, joint_position], axis=1),
            temperature=xp.full_like(joint_position, DEFAULT_HEAT.ambient_c),
            torque=xp.zeros_like(joint_position),
        )

    # -- a step --------------------------------------------------------------------------------------------------------

    def target(self, action: Any) -> tuple[JointTarget, Any]:
        """Joint command of actions (N, 25) or, with gains, (N, 75); and how many values were clipped, (N,)."""
        xp = namespace(action)
        wanted = ankle.to_joint_position(action[:, :_JOINTS], self.config.ankle)
        low, high = (xp.asarray(RANGE[:, i], dtype=action.dtype) for i in (0, 1))
        position = xp.clip(wanted, low, high)
        clipped = xp.sum(xp.astype(xp.abs(wanted - position) > _TOLERANCE, integer(xp)), axis=-1)
        if not self.config.gains:
            return JointTarget(position), clipped
        wanted_kp, wanted_kd = action[:, _JOINTS : 2 * _JOINTS], action[:, 2 * _JOINTS :]
        kp, kd = xp.clip(wanted_kp, 0.0, MAX_KP), xp.clip(wanted_kd, 0.0, MAX_KD)
        beyond = xp.concat([kp != wanted_kp, kd != wanted_kd], axis=-1)
        clipped = clipped + xp.sum(xp.astype(beyond, integer(xp)), axis=-1)
        joint_kp, joint_kd = ankle.gains_to_joint(kp, kd)
        return JointTarget(position, kp=joint_kp, kd=joint_kd), clipped

    def advance(self, state: TrajectoryState, target: JointTarget, reading: Reading) -> TrajectoryState:
        """State after a step that drove to `target` and ended in `reading`."""
        xp = namespace(reading.gyro)
        torque = ankle.to_motor_torque(reading.joint_torque, reading.joint_position, self.config.ankle)
        return replace(
            state,
            step=state.step + 1,
            target=xp.stack([xp.astype(target.position, state.target.dtype), state.target[:, 0]], axis=1),
            temperature=heat(state.temperature, torque, DT),
            torque=torque,
        )

    def conclude(self, state: TrajectoryState, target: JointTarget, reading: Reading, diverged: Any) -> Outcome:
        """Outcome of a step that drove to `target` and ended in `reading`; `diverged`: broken copies, (N,) bool."""
        state = self.advance(state, target, reading)
        reward, shares = self.reward(state, reading)
        ended = self.fallen(reading) | self.overheated(state)
        return settle(state, reward, shares, ended, diverged, self.episode_steps)

    def reward(self, state: TrajectoryState, reading: Reading) -> tuple[Any, dict[str, Any]]:
        """Reward of the step that led to `state`, (N,), and the share of each term per second."""
        xp = namespace(reading.gyro)
        tracking = rewards.Tracking(
            reading=reading,
            reference=self._frame(xp, self.motion.frames, state.step),
            reference_velocity=self._frame(xp, self.motion.velocities, state.step),
            target=state.target,
        )
        return rewards.total(tracking, self.config.rewards, DT)

    def fallen(self, reading: Reading) -> Any:
        """Copies on the ground, (N,) bool: tilted beyond 60 degrees or the pelvis below 0.35 m."""
        return has_fallen(reading.gravity, reading.base_position[:, 2])

    def overheated(self, state: TrajectoryState) -> Any:
        """Copies with a motor at the temperature at which the robot goes limp, (N,) bool."""
        xp = namespace(state.temperature)
        return xp.any(state.temperature >= TRIP_C, axis=-1)

    # -- what learners see ---------------------------------------------------------------------------------------------

    def observe(self, state: TrajectoryState, reading: Reading) -> dict[str, Any]:
        """Telemetry by its field names, the reference (N, K, 25) and the phase (N, 2)."""
        xp = namespace(reading.gyro)
        fallen = self.fallen(reading)
        observation = telemetry.measure(reading, state.torque, state.temperature, self.config.ankle)
        observation["fw_mode"] = xp.full_like(state.step, telemetry.FW_MODE_MOVE)
        observation["error_flags"] = telemetry.error_flags(fallen, state.temperature)[:, None]
        observation["alert_count"] = telemetry.alert_count(fallen, state.temperature)[:, None]
        steps = state.step[:, None] + xp.asarray(self.config.ahead)[None, :]
        observation["reference"] = xp.astype(self._frame(xp, self.motor_frames, steps), xp.float32)
        frame = state.step % len(self.motion.frames)
        angle = (2.0 * math.pi / len(self.motion.frames)) * xp.astype(frame, real(xp))
        observation["phase"] = xp.astype(xp.stack([xp.cos(angle), xp.sin(angle)], axis=-1), xp.float32)
        return observation

    def _frame(self, xp: Any, frames: np.ndarray, step: Any) -> Any:
        """Frames (..., 25) of a repeating table (T, 25) at steps (...)."""
        rows = xp.reshape(step % len(frames), (-1,))
        return xp.reshape(xp.take(xp.asarray(frames), rows, axis=0), (*step.shape, _JOINTS))
