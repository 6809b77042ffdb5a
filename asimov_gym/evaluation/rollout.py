"""Many robots driven by one policy, each through its own trial, and the record of what they did.

The robots of a rollout share a model (physics variant, ground, torque limits); commands, pushes, delays, noise,
friction and payload are each robot's own. What a robot does depends on its trial alone, not on the others beside it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from asimov_gym.evaluation.pushes import PushSchedule
from asimov_gym.evaluation.robots import start_robots
from asimov_gym.evaluation.scenario import FALL_RULES, Trial
from asimov_gym.evaluation.sensor_noise import SensorNoise
from asimov_gym.evaluation.variants import variant_named
from asimov_gym.firmware.stand import RAMP_S, stand_target
from asimov_gym.physics import Reading, delayed_position
from asimov_gym.policy import Policy, PolicyContract, PolicyDriver, clip_command
from asimov_gym.robot import frames, gait_clock
from asimov_gym.robot.joints import STAND_POSITION
from asimov_gym.robot.observation import POLICY_RATE_HZ
from asimov_gym.robot.safety_limits import has_fallen
from asimov_gym.robot.terrain import terrain_named

DT = 1.0 / POLICY_RATE_HZ
"""Policy step, s."""
HEADING_GAIN = 1.0
"""Yaw rate per heading error where the heading is held, 1/s."""
_SHRINK_EVERY, _SHRINK_BELOW = 25, 0.8
"""Robots that are done are left out when fewer than this share go on; looked at every so many policy steps."""
_SIZES = {
    "command": (3,),
    "given": (3,),
    "velocity": (3,),
    "position": (3,),
    "quat": (4,),
    "gravity": (3,),
    "phase": (),
    "joint_position": (25,),
    "joint_velocity": (25,),
    "joint_torque": (25,),
    "action": (23,),
    "foot_position": (2, 3),
    "foot_velocity": (2, 3),
    "foot_force": (2, 3),
    "foot_height": (2,),
    "pelvis_height": (),
}
"""Recorded quantities, and the shape of one robot's."""
ROW_BYTES = 4 * sum(math.prod(shape) for shape in _SIZES.values())
"""Memory of one robot and policy step."""
Progress = Callable[[int], None]
"""Called with the robots that were stepped, after each policy step."""


@dataclass(frozen=True)
class Trace:
    """What n robots did in T policy steps of `dt`; float32, row k is the state after step k.

    Of robot i the rows before `fall_step[i]` count; the others are zero.
    """

    dt: float
    """s."""
    command: np.ndarray
    """What the scenario asks for: vx, vy (m/s), yaw rate (rad/s), (T, n, 3)."""
    given: np.ndarray
    """What the policy was told: the command within its range, and with the heading held, (T, n, 3)."""
    velocity: np.ndarray
    """Pelvis velocity in the heading frame (m/s) and yaw rate about the vertical (rad/s), (T, n, 3)."""
    position: np.ndarray
    """Pelvis, world, m, (T, n, 3)."""
    quat: np.ndarray
    """Pelvis orientation (w, x, y, z), body to world, (T, n, 4)."""
    gravity: np.ndarray
    """Unit vector to the ground, body frame, (T, n, 3)."""
    phase: np.ndarray
    """Gait clock of the left foot, rad, (T, n); zero for a policy without a clock."""
    joint_position: np.ndarray
    """rad, joint order, (T, n, 25)."""
    joint_velocity: np.ndarray
    """rad/s, joint order, (T, n, 25)."""
    joint_torque: np.ndarray
    """N·m, joint order, (T, n, 25)."""
    action: np.ndarray
    """Network output after clipping, policy order, (T, n, 23)."""
    foot_position: np.ndarray
    """Foot sites (left, right), world, m, (T, n, 2, 3)."""
    foot_velocity: np.ndarray
    """World, m/s, (T, n, 2, 3)."""
    foot_force: np.ndarray
    """Force of the ground on each foot, world, N, (T, n, 2, 3)."""
    foot_height: np.ndarray
    """Foot sites above the ground below them, m, (T, n, 2)."""
    pelvis_height: np.ndarray
    """Above the ground below it, m, (T, n)."""
    start: np.ndarray
    """Pelvis position before the first step, (n, 3)."""
    steps: np.ndarray
    """Policy steps that were asked for, (n,) int."""
    fall_step: np.ndarray
    """Policy step of the fall, or of what ended the trial early (`errors`); `steps` where neither came, (n,) int."""
    errors: tuple[str | None, ...]
    """Why a robot's trial ended early without a fall; None where it did not, (n,)."""

    @property
    def survived(self) -> np.ndarray:
        """Robots that came to the end of their trial, (n,) bool."""
        return self.fall_step >= self.steps

    def end_s(self, i: int) -> float | None:
        """When a robot fell or its trial ended early; None where it came to its end."""
        return None if self.survived[i] else float((self.fall_step[i] + 1) * self.dt)

    def robot(self, i: int) -> Trace:
        """The trace of one robot alone, n = 1, with the rows that count."""
        rows = {name: getattr(self, name)[: self.fall_step[i], i : i + 1] for name in _SIZES}
        one = {name: getattr(self, name)[i : i + 1] for name in ("start", "steps", "fall_step", "errors")}
        return replace(self, **rows, **one)

    def save(self, path: Path, i: int) -> None:
        """Write one robot's rows as .npz: time (s, after each step) and every quantity by its name here, without the
        axis of robots."""
        length = int(self.fall_step[i])
        arrays = {name: getattr(self, name)[:length, i] for name in _SIZES}
        np.savez_compressed(path, time=(1 + np.arange(length, dtype=np.float32)) * np.float32(self.dt), **arrays)


def shared_conditions(trial: Trial) -> tuple[object, ...]:
    """What the trials of one rollout have in common."""
    c = trial.scenario.conditions
    return c.physics, c.terrain, c.motor_strength, c.weak_joints, trial.scenario.limits


def roll_out(
    policy: Policy, trials: Sequence[Trial], *, threads: int | None = None, progress: Progress | None = None
) -> Trace:
    """Drive a robot through each trial.

    Args:
        policy: the network.
        trials: with equal `shared_conditions`.
        threads: physics threads; the machine's cores when None.
        progress: called with the number of robots stepped, after each policy step.

    Raises:
        ValueError: there is no trial, they cannot share a rollout, or the policy's contract does not allow a command
            range.
        ModuleNotFoundError: the engine is not installed.
    """
    if not trials:
        raise ValueError("trials must hold at least one trial, got none")
    if len({shared_conditions(trial) for trial in trials}) > 1:
        raise ValueError("trials of one rollout must share physics, terrain, motor strength and command limits")
    return _Rollout(_within_limits(policy, trials[0]), trials, threads).run(progress)


class _Limited:
    """A policy with another range of commands."""

    def __init__(self, policy: Policy, contract: PolicyContract) -> None:
        self.contract = contract
        self.infer = policy.infer


def _within_limits(policy: Policy, trial: Trial) -> Policy:
    limits = dict(trial.scenario.limits)
    if not limits:
        return policy
    axes = zip(("vx", "vy", "wz"), policy.contract.command_ranges, strict=True)
    ranges = tuple(limits.get(axis, trained) for axis, trained in axes)
    return _Limited(policy, replace(policy.contract, command_ranges=ranges))


class _Rollout:
    """The state of a rollout. Arrays have a row for each robot that goes on; `_place` says whose row it is."""

    def __init__(self, policy: Policy, trials: Sequence[Trial], threads: int | None) -> None:
        conditions = [trial.scenario.conditions for trial in trials]
        n, variant = len(trials), variant_named(conditions[0].physics)
        self._trials, self._n, self._substeps = trials, n, variant.substeps
        self._policy, self._terrain = policy, terrain_named(conditions[0].terrain)
        self._steps = np.array([trial.scenario.steps for trial in trials])
        self._length = int(self._steps.max())
        self._asked = np.zeros((self._length, n, 3), dtype=np.float32)
        for i, trial in enumerate(trials):
            self._asked[: self._steps[i], i] = trial.scenario.command_rows()
        self._pushes = PushSchedule(trials)
        self._delay = np.array([round(0.001 * t.delay_ms / variant.timestep) for t in trials])
        self._stand_step = np.array([trial.scenario.stand_step for trial in trials])
        self._stand_entry = np.zeros((n, len(STAND_POSITION)))
        self._holds = np.array([c.hold_heading for c in conditions])
        self._fall = np.array([(FALL_RULES[c.fall].gravity_z, FALL_RULES[c.fall].height) for c in conditions])
        self._noise = SensorNoise(trials)
        errors = np.stack(
            [t.generator("start").uniform(-1.0, 1.0, 25) * t.scenario.conditions.initial_joint_error for t in trials]
        )
        self._robots = start_robots(policy.contract, conditions, errors, threads)
        self._driver = PolicyDriver(policy, n)
        self._place = np.arange(n)
        reading = self._robots.read()
        self._history = np.tile(reading.joint_position[:, None], (1, 3, 1))
        self._heading = frames.heading(reading.base_quat)
        self._start = np.array(reading.base_position)
        self._fall_step = self._steps.copy()
        self._errors: list[str | None] = [None] * n
        self._rows = {name: np.zeros((self._length, n, *size), np.float32) for name, size in _SIZES.items()}

    def run(self, progress: Progress | None) -> Trace:
        """Every step of every robot."""
        reading = self._robots.read()
        try:
            for step in range(self._length):
                if step % _SHRINK_EVERY == 0:
                    reading = self._leave_out_done(step, reading)
                    if len(self._place) == 0:
                        break
                reading = self._step(step, reading)
                if progress is not None:
                    progress(int(self._going(step).sum()))
        finally:
            self._robots.close()
        return Trace(
            dt=DT,
            **self._rows,
            start=self._start,
            steps=self._steps,
            fall_step=self._fall_step,
            errors=tuple(self._errors),
        )

    def _going(self, step: int) -> np.ndarray:
        """Of the robots that are simulated: whether they are still in their trial at a step."""
        return step < self._fall_step[self._place]

    def _leave_out_done(self, step: int, reading: Reading) -> Reading:
        going = self._going(step)
        if going.mean() > _SHRINK_BELOW:
            return reading
        kept = np.flatnonzero(going)
        if len(kept) == 0:
            self._place = kept
            return reading
        robots = self._robots.take(kept)
        if robots is None:
            return reading
        state = self._driver.state
        self._robots, self._driver = robots, PolicyDriver(self._policy, len(kept))
        self._driver.state = replace(state, action=state.action[kept], phase=state.phase[kept])
        self._place, self._history, self._heading = self._place[kept], self._history[kept], self._heading[kept]
        return self._robots.read()

    def _step(self, step: int, reading: Reading) -> Reading:
        place, going = self._place, self._going(step)
        asked = self._asked[step, place].astype(np.float64)
        given = self._with_heading(asked, reading)
        target = self._driver.step(command=given, **self._noise.sense(place, reading))
        standing = step >= self._stand_step[place]
        if standing.any():
            target = np.where(standing[:, None], self._stand_target(step, reading), target)
        sound = (self._driver.finite | standing) & np.isfinite(target).all(axis=1)
        if not sound.all():
            self._end(step, going & ~sound, "the network's output is not finite")
            going = going & sound
            self._driver.reset(~sound)
            target = np.where(sound[:, None], target, STAND_POSITION)
        phase = self._driver.state.phase
        self._history = np.concatenate([target[:, None], self._history[:, :2]], axis=1)
        late = delayed_position(self._history, self._delay[place], self._substeps)
        after = self._robots.step(late, self._pushes.wrench(step, place))
        self._end(step, going & self._robots.diverged, "the simulation diverged")
        going = going & ~self._robots.diverged
        x, y = after.base_position[:, 0], after.base_position[:, 1]
        height = after.base_position[:, 2] - self._terrain.height(x, y)
        rule = self._fall[place]
        fallen = going & has_fallen(after.gravity, height, rule[:, 0], rule[:, 1])
        self._fall_step[place[fallen]] = step
        self._record(step, going & ~fallen, given, phase, height, after)
        return after

    def _stand_target(self, step: int, reading: Reading) -> np.ndarray:
        """What the mode STAND asks of the joints, (n, 25); of meaning for robots that are in it."""
        since = step - self._stand_step[self._place]
        begins = since == 0
        self._stand_entry[self._place[begins]] = reading.joint_position[begins]
        self._robots.use_robot_gains(begins)  # of the firmware's modes POLICY alone has the policy's
        ramp = np.clip(since * DT / RAMP_S, 0.0, 1.0)[:, None]
        return stand_target(self._stand_entry[self._place], STAND_POSITION, ramp)

    def _end(self, step: int, which: np.ndarray, reason: str) -> None:
        for i in self._place[which]:
            self._errors[i] = f"{reason} after {step * DT:.2f} s"
            self._fall_step[i] = step

    def _with_heading(self, asked: np.ndarray, reading: Reading) -> np.ndarray:
        """The command within the policy's range, its yaw rate corrected for robots that hold their heading."""
        contract = self._policy.contract
        given = clip_command(contract, asked)
        holds = self._holds[self._place]
        if not holds.any():
            return given
        error = self._heading - frames.heading(reading.base_quat)
        error = (error + math.pi) % (2.0 * math.pi) - math.pi
        holds = holds & gait_clock.is_moving(given, contract.standing_threshold)
        held = given.copy()
        held[:, 2] += HEADING_GAIN * error
        self._heading = self._heading + DT * given[:, 2]
        return np.where(holds[:, None], clip_command(contract, held), given)

    def _record(
        self, step: int, which: np.ndarray, given: np.ndarray, phase: np.ndarray, height: np.ndarray, reading: Reading
    ) -> None:
        velocity = frames.as_command(reading.base_quat, reading.base_velocity, reading.gravity, reading.gyro)
        feet = reading.foot_position
        values = {
            "command": self._asked[step, self._place],
            "given": given,
            "velocity": velocity,
            "position": reading.base_position,
            "quat": reading.base_quat,
            "gravity": reading.gravity,
            "phase": phase,
            "joint_position": reading.joint_position,
            "joint_velocity": reading.joint_velocity,
            "joint_torque": reading.joint_torque,
            "action": self._driver.state.action,
            "foot_position": feet,
            "foot_velocity": reading.foot_velocity,
            "foot_force": reading.foot_force,
            "foot_height": feet[:, :, 2] - self._terrain.height(feet[:, :, 0], feet[:, :, 1]),
            "pelvis_height": height,
        }
        places = self._place[which]
        for name, value in values.items():
            self._rows[name][step, places] = value[which]
