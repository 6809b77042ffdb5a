"""Many robots driven by one policy under the evaluation conditions, without a rope, noise or randomisation.

Conditions: the `evaluation` physics profile, foot friction as in the model (0.6), a start in the standing pose with
joint errors of up to 0.02 rad drawn from the seed, and an action delay of (seed mod 6) times 5 ms.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from asimov_gym.physics import DECIMATION, BodyParameters, CPhysics, JointTarget, Reading, delayed_position
from asimov_gym.policy import Policy, PolicyDriver, joint_gains
from asimov_gym.robot import frames
from asimov_gym.robot.joints import RANGE, STAND_POSITION
from asimov_gym.robot.observation import POLICY_RATE_HZ
from asimov_gym.robot.safety_limits import has_fallen

DELAYS = 6
"""Distinct action delays, 0 to 25 ms in physics steps of 5 ms."""
INITIAL_JOINT_ERROR = 0.02
"""rad."""


@dataclass(frozen=True)
class Trace:
    """What n robots did in T policy steps. After a fall, a robot's rows go on but mean nothing."""

    dt: float
    command: np.ndarray
    """vx, vy, yaw rate, (T, n, 3)."""
    velocity: np.ndarray
    """Pelvis velocity in the heading frame and yaw rate about the vertical, (T, n, 3)."""
    position: np.ndarray
    """Pelvis, world, m, (T, n, 3)."""
    gravity: np.ndarray
    """(T, n, 3)."""
    foot_height: np.ndarray
    """Foot sites above the ground, m, (T, n, 2)."""
    joint_torque: np.ndarray
    """N·m, joint order, (T, n, 25)."""
    joint_velocity: np.ndarray
    """rad/s, joint order, (T, n, 25)."""
    fall_step: np.ndarray
    """Policy step of the fall, T where there is none, (n,)."""
    start: np.ndarray
    """Pelvis position before the first step, (n, 3)."""

    @property
    def survived(self) -> np.ndarray:
        """(n,) bool."""
        return self.fall_step >= len(self.command)


def roll_out(
    policy: Policy,
    seeds: np.ndarray,
    seconds: float,
    command: Callable[[float], np.ndarray],
    wrench: Callable[[float], Mapping[str, np.ndarray] | None] | None = None,
    progress: Callable[[int, int], None] | None = None,
    threads: int | None = None,
) -> Trace:
    """Drive n robots for some time.

    Args:
        policy: the network.
        seeds: of each robot, (n,) int; a seed fixes the start and the action delay.
        seconds: simulated time.
        command: velocity commands (n, 3) at a time in seconds.
        wrench: forces on bodies, (n, 6) by body name in the world frame, at a time in seconds; none when omitted.
        progress: called with the steps done and the steps in all.
        threads: physics threads; the machine's cores when omitted.
    """
    n, steps = len(seeds), round(seconds * POLICY_RATE_HZ)
    body = BodyParameters.with_gains(*joint_gains(policy.contract), n)
    physics = CPhysics(n, "evaluation", threads, body)
    driver = PolicyDriver(policy, n)
    qpos, qvel = physics.standing()
    joints = STAND_POSITION + np.stack(
        [np.random.default_rng(int(s)).uniform(-INITIAL_JOINT_ERROR, INITIAL_JOINT_ERROR, 25) for s in seeds]
    )
    joints = np.clip(joints, RANGE[:, 0], RANGE[:, 1])
    start = np.tile(qpos[:3], (n, 1))
    physics.reset(physics.configuration(joints, start, np.tile(qpos[3:7], (n, 1))), qvel)
    delay = np.asarray(seeds) % DELAYS
    history = np.tile(joints[:, None], (1, 3, 1))
    rows: dict[str, list[np.ndarray]] = {
        name: [] for name in ("command", "velocity", "position", "gravity", "foot", "torque", "speed")
    }
    fall_step = np.full(n, steps)
    reading = physics.read()
    for step in range(steps):
        now = step / POLICY_RATE_HZ
        wanted = np.asarray(command(now), dtype=np.float64)
        target = driver.step(reading.gyro, reading.gravity, wanted, reading.joint_position, reading.joint_velocity)
        history = np.concatenate([target[:, None], history[:, :2]], axis=1)
        late = delayed_position(history, delay, DECIMATION)
        reading = physics.step(JointTarget(late), DECIMATION, None if wrench is None else wrench(now))
        fallen = has_fallen(reading.gravity, reading.base_position[:, 2]) | physics.diverged
        fall_step = np.where(fallen & (fall_step == steps), step, fall_step)
        _record(rows, driver.command, reading)
        if progress is not None:
            progress(step + 1, steps)
        if (fall_step < steps).all():
            break
    physics.close()
    arrays = {name: np.stack(values) for name, values in rows.items()}
    return Trace(
        dt=1.0 / POLICY_RATE_HZ,
        command=arrays["command"],
        velocity=arrays["velocity"],
        position=arrays["position"],
        gravity=arrays["gravity"],
        foot_height=arrays["foot"],
        joint_torque=arrays["torque"],
        joint_velocity=arrays["speed"],
        fall_step=np.where(fall_step == steps, len(arrays["command"]), fall_step),
        start=start,
    )


def _record(rows: dict[str, list[np.ndarray]], command: np.ndarray, reading: Reading) -> None:
    angle = frames.heading(reading.base_quat)
    velocity = frames.to_heading(angle, reading.base_velocity)
    velocity[:, 2] = frames.yaw_rate(reading.gravity, reading.gyro)
    rows["command"].append(command)
    rows["velocity"].append(velocity)
    rows["position"].append(reading.base_position)
    rows["gravity"].append(reading.gravity)
    rows["foot"].append(reading.foot_position[:, :, 2])
    rows["torque"].append(reading.joint_torque.astype(np.float32))
    rows["speed"].append(reading.joint_velocity.astype(np.float32))
