"""The walking task: state, commands, observations, reward and termination as pure functions of batched arrays.

Nothing here draws random numbers: draws come in as uniform numbers in [0, 1), so the same functions run on any array
library and a recorded rollout can be replayed elsewhere.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from asimov_gym.physics import DECIMATION, TIMESTEP, BodyParameters, Reading, delayed_position
from asimov_gym.robot import frames, gait_clock, mirror
from asimov_gym.robot.array_library import integer, namespace, within
from asimov_gym.robot.feet import SOLE_DEPTH
from asimov_gym.robot.joints import JOINT_NAMES, POLICY_JOINT_NAMES, POLICY_TO_JOINT, RANGE, STAND_POSITION
from asimov_gym.robot.observation import ObservationLayout, observation_layout
from asimov_gym.robot.safety_limits import has_fallen
from asimov_gym.robot.terrain import terrain_named
from asimov_gym.tasks.ground_truth import above_ground, critic_view, ground_truth
from asimov_gym.tasks.outcome import Outcome, settle
from asimov_gym.tasks.walk import bus_age, rewards
from asimov_gym.tasks.walk.config import WalkConfig
from asimov_gym.tasks.walk.draws import DT, NEVER, decided, draw_command, draw_kick, steps_between
from asimov_gym.tasks.walk.shove import pace, shoved
from asimov_gym.tasks.walk.state import COMMAND_DRAWS, PLACE_DRAWS, START_DRAWS, STEP_DRAWS, WalkState

_JOINTS, _ACTIONS = len(JOINT_NAMES), len(POLICY_JOINT_NAMES)
_TO_POLICY, _DRIVEN = np.zeros(_JOINTS, dtype=int), np.zeros(_JOINTS)
_TO_POLICY[POLICY_TO_JOINT], _DRIVEN[POLICY_TO_JOINT] = np.arange(_ACTIONS), 1.0
"""Each joint's place among the actions, and 1 where it has one: the others are held."""


class WalkTask:
    """The walking task under a configuration."""

    def __init__(self, config: WalkConfig | None = None) -> None:
        self.config = WalkConfig() if config is None else config
        self.terrain = terrain_named(self.config.terrain)
        self.episode_steps = max(1, round(self.config.episode_s / DT))

    @cached_property
    def layout(self) -> ObservationLayout:
        """Layout of the actor's observation."""
        return observation_layout(self.config.layout)

    @cached_property
    def step_draws(self) -> Mapping[str, int]:
        """Uniform numbers per copy that a step takes under this configuration, by what they are for."""
        return {**STEP_DRAWS, "bus": bus_age.BUS_DRAWS} if self.config.noise.can_slot_delay else STEP_DRAWS

    @cached_property
    def start_draws(self) -> Mapping[str, int]:
        """Uniform numbers per copy that the start of an episode takes besides."""
        return START_DRAWS if self.terrain.is_flat else {**START_DRAWS, "place": PLACE_DRAWS}

    @property
    def trail(self) -> int:
        """How many earlier moments of the joints the physics has to remember for `sensed`."""
        return bus_age.OLDEST if self.config.noise.can_slot_delay else 0

    # -- start ---------------------------------------------------------------------------------------------------------

    def place(self, draws: Any) -> Any:
        """Where episodes start on a terrain that is not flat: x, y and the height to add to the pose's, m, (N, 3), from
        draws (N, PLACE_DRAWS)."""
        return self.terrain.start(draws)

    def initial_pose(self, draws: Any) -> tuple[Any, Any, Any, Any]:
        """A disturbed standing pose from draws (N, POSE_DRAWS).

        Returns:
            Joint positions (N, 25), pelvis height (N,), pelvis orientation (N, 4), pelvis velocity and rates (N, 6).
        """
        xp = namespace(draws)
        centred = 2.0 * draws - 1.0
        yaw = math.pi * centred[:, 0]
        roll, pitch = 0.05 * centred[:, 1], 0.08 * centred[:, 2]
        quat = _from_euler(roll, pitch, yaw)
        joints = xp.asarray(STAND_POSITION, dtype=draws.dtype) + 0.1 * centred[:, 5 : 5 + _JOINTS]
        joints = xp.clip(joints, xp.asarray(RANGE[:, 0], dtype=draws.dtype), xp.asarray(RANGE[:, 1], dtype=draws.dtype))
        height = 0.62 + 0.01 * draws[:, 3] + 0.1 * (xp.abs(roll) + xp.abs(pitch))
        velocity = 0.2 * centred[:, 5 + _JOINTS :]
        return joints, height, quat, velocity

    def initial_state(self, draws: Any, randomise: bool = True, noise: bool = True) -> WalkState:
        """Task state of fresh copies from draws (N, RESET_DRAWS).

        Args:
            draws: uniform numbers.
            randomise: whether copies get an action delay; none otherwise.
            noise: whether their encoders have an offset; none otherwise.
        """
        xp = namespace(draws)
        n, dtype, c = draws.shape[0], draws.dtype, self.config
        zeros = xp.zeros(n, dtype=dtype)
        steps = xp.asarray([c.randomisation.action_delay_ms[i] / (1000.0 * TIMESTEP) for i in (0, 1)], dtype=dtype)
        low, high = xp.round(steps[0]), xp.round(steps[1])
        delay = xp.astype(xp.floor(low + (high - low + 0.999) * draws[:, 0]), integer(xp))
        zero = c.noise.joint_zero * (2.0 * draws[:, 2 : 2 + _JOINTS] - 1.0)
        calm, kick_draw = decided(draws[:, -2], c.calm_share)
        never = xp.full(n, NEVER, dtype=integer(xp))
        command, left = draw_command(c.command, draws[:, 2 + _JOINTS : 2 + _JOINTS + COMMAND_DRAWS])
        return WalkState(
            step=xp.zeros(n, dtype=integer(xp)),
            command=command,
            command_left=left,
            kick_left=xp.where(calm, never, steps_between(kick_draw, c.kick.interval_s)),
            phase=xp.where(draws[:, 1] < 0.5, zeros, zeros + math.pi),
            action=xp.zeros((n, 3, _ACTIONS), dtype=dtype),
            delay=delay if randomise else xp.zeros_like(delay),
            joint_zero=zero if noise else xp.zeros_like(zero),
            mean_velocity=xp.zeros((n, 3), dtype=dtype),
            shove=xp.zeros((n, len(c.shove.bodies), 3), dtype=dtype),
            shove_left=xp.zeros(n, dtype=integer(xp)),
            shove_wait=xp.where(calm, never, steps_between(draws[:, -1], c.shove.interval_s)),
        )

    def is_calm(self, state: WalkState) -> Any:
        """Copies whose episode nothing disturbs, (N,) bool."""
        return state.kick_left > NEVER // 2

    # -- a step --------------------------------------------------------------------------------------------------------

    def clip_action(self, action: Any) -> Any:
        """Action within its bounds, (N, 23)."""
        return namespace(action).clip(action, -self.config.action_clip, self.config.action_clip)

    def targets(self, state: WalkState) -> Any:
        """Joint targets for each physics step, (N, DECIMATION, 25): the state's actions, late by its delay.

        The neck is held at its standing pose; targets stay within the joints' ranges.
        """
        xp = namespace(state.action)
        dtype = state.action.dtype
        scale = xp.asarray(self.config.action_scale * _DRIVEN, dtype=dtype)
        offset = scale * xp.take(state.action, xp.asarray(_TO_POLICY), axis=-1)
        target = xp.asarray(STAND_POSITION, dtype=dtype) + offset
        low, high = xp.asarray(RANGE[:, 0], dtype=dtype), xp.asarray(RANGE[:, 1], dtype=dtype)
        return delayed_position(within(xp, target, low, high), state.delay, DECIMATION)

    def kick(self, state: WalkState, draws: Any, level: Any) -> tuple[WalkState, Any]:
        """State with the time to the next kick renewed where it is up, and what to add to the pelvis' velocity, (N, 6).

        Args:
            state: before the step.
            draws: (N, KICK_DRAWS); they matter where a kick is due.
            level: place in the curriculum, 0 to 1.
        """
        xp = namespace(draws)
        due = state.kick_left <= 0
        kick, wait = draw_kick(self.config.kick, draws, level)
        left = xp.where(due, wait, state.kick_left)
        return replace(state, kick_left=left), xp.where(due[:, None], kick, xp.zeros_like(kick))

    def shove(self, state: WalkState, draws: Any, level: Any) -> WalkState:
        """State with the shoves of this step, (N, SHOVE_DRAWS) draws; see `asimov_gym.tasks.walk.shove`."""
        return shoved(self.config.shove, state, draws, level) if self.config.shove.bodies else state

    def wrench(self, state: WalkState) -> dict[str, Any]:
        """Force and torque of the state's shoves by body, (N, 6), world frame."""
        xp = namespace(state.shove)
        bodies = enumerate(self.config.shove.bodies)
        return {name: xp.concat([state.shove[:, i], xp.zeros_like(state.shove[:, i])], axis=-1) for i, name in bodies}

    def push_action(self, state: WalkState, action: Any) -> WalkState:
        """State with a new clipped action (N, 23) in front."""
        xp = namespace(action)
        return replace(state, action=xp.concat([action[:, None, :], state.action[:, :2]], axis=1))

    def motion(self, state: WalkState, reading: Reading) -> tuple[WalkState, rewards.Motion]:
        """What the step did; the state with its running means updated. The clock is still this step's."""
        xp = namespace(reading.gyro)
        angle = frames.heading(reading.base_quat)
        velocity = frames.to_heading(angle, reading.base_velocity)
        turning = frames.yaw_rate(reading.gravity, reading.gyro)
        now = xp.concat([velocity[:, 0:2], turning[:, None]], axis=-1)
        mean = state.mean_velocity + (now - state.mean_velocity) * (DT / self.config.mean_velocity_s)
        moving = gait_clock.is_moving(state.command, self.config.standing_threshold)
        walking = xp.astype(moving, velocity.dtype)
        sine = xp.sin(state.phase) * walking
        calm = rewards.squares(velocity[:, 0:2]) < self.config.thrown_speed**2
        offset = reading.foot_position - reading.base_position[:, None, :]
        motion = rewards.Motion(
            reading=reading,
            velocity=velocity,
            yaw_rate=turning,
            mean_velocity=mean,
            foot_offset=frames.to_heading(angle[:, None], offset),
            foot_height=above_ground(reading.foot_position, self.terrain) - SOLE_DEPTH,
            contact=xp.astype(reading.foot_force[:, :, 2] > rewards.CONTACT_FORCE, velocity.dtype),
            command=state.command,
            moving=walking,
            resting=xp.astype(calm & ~moving, velocity.dtype),
            swing=xp.stack([sine, -sine], axis=-1),
            action=state.action,
            step_height=self.config.step_height,
        )
        return replace(state, mean_velocity=mean), motion

    def reward(self, motion: rewards.Motion, penalty_level: Any = 1.0) -> tuple[Any, dict[str, Any]]:
        """Reward of the step (N,) and the share of each term per second."""
        return rewards.total(motion, self.config.rewards, penalty_level, DT)

    def fallen(self, reading: Reading) -> Any:
        """Copies on the ground, (N,) bool: tilted beyond 60 degrees or the pelvis below 0.35 m over the ground."""
        return has_fallen(reading.gravity, above_ground(reading.base_position[:, None], self.terrain)[:, 0])

    def conclude(
        self, state: WalkState, reading: Reading, diverged: Any, command_draws: Any, penalty_level: Any = 1.0
    ) -> Outcome:
        """Outcome of a step that ended in `reading`.

        Args:
            state: during the step, with its action in front.
            reading: at its end.
            diverged: copies whose simulation broke down, (N,) bool.
            command_draws: for commands whose time is up, (N, COMMAND_DRAWS).
            penalty_level: factor on the penalties.
        """
        state, motion = self.motion(state, reading)
        reward, shares = self.reward(motion, penalty_level)
        state = self.advance(state, command_draws)
        return settle(state, reward, shares, self.fallen(reading), diverged, self.episode_steps)

    def advance(self, state: WalkState, command_draws: Any) -> WalkState:
        """State for the next step: clocks run, commands whose time is up are drawn anew."""
        xp = namespace(state.phase)
        moving = gait_clock.is_moving(state.command, self.config.standing_threshold)
        phase = gait_clock.advance(state.phase, moving, self.config.gait_frequency_hz, DT)
        fresh, lifetime = draw_command(self.config.command, command_draws)
        due = state.command_left <= 1
        return replace(
            state,
            step=state.step + 1,
            phase=phase,
            command=xp.where(due[:, None], fresh, state.command),
            command_left=xp.where(due, lifetime, state.command_left - 1),
            kick_left=state.kick_left - 1,
            shove_wait=state.shove_wait - pace(self.config.shove, state, moving),
        )

    # -- what learners see ---------------------------------------------------------------------------------------------

    def clock(self, state: WalkState) -> Any:
        """The clock's signal, (N, 2)."""
        return gait_clock.signal(state.phase, gait_clock.is_moving(state.command, self.config.standing_threshold))

    def sensed(self, reading: Reading, trail: Any, draws: Any) -> Reading:
        """The reading as the motor bus delivers it to the actor: joints aged by their slots.

        Args:
            reading: of now.
            trail: the joints at the `trail` physics steps before, (N, K, 2, 25).
            draws: (N, BUS_DRAWS).
        """
        return bus_age.aged(reading, trail, bus_age.slot_ages(draws))

    def views(
        self,
        state: WalkState,
        reading: Reading,
        body: BodyParameters,
        draws: Any | None = None,
        sensed: Reading | None = None,
    ) -> tuple[Any, Any]:
        """What actor and critic see, (N, width) and (N, privileged_width).

        Args:
            state: of the task.
            reading: of the robots.
            body: their figures.
            draws: for the noise of the actor's sensors, (N, SENSOR_DRAWS); none without.
            sensed: the reading as it reaches the actor, where that is another one.
        """
        clean = self._clean(state, reading)
        felt = clean if sensed is None else self._clean(state, sensed)
        return self._felt(felt, state.joint_zero, draws), self._privileged(clean, state, reading, body)

    def observe(self, state: WalkState, reading: Reading, draws: Any | None = None) -> Any:
        """What the actor sees alone, (N, width); as in `views`."""
        return self._felt(self._clean(state, reading), state.joint_zero, draws)

    def privilege(self, state: WalkState, reading: Reading, body: BodyParameters) -> Any:
        """What the critic sees alone, (N, privileged_width): the clean actor view and what only a simulator knows."""
        return self._privileged(self._clean(state, reading), state, reading, body)

    def _clean(self, state: WalkState, reading: Reading) -> Any:
        """The actor's observation from perfect sensors, scaled but not yet within its bounds, (N, width)."""
        return self.layout.scaled(
            gyro=reading.gyro,
            gravity=reading.gravity,
            command=state.command,
            joint_position=reading.joint_position,
            joint_velocity=reading.joint_velocity,
            action=state.action[:, 0],
            clock=self.clock(state),
        )

    def _felt(self, clean: Any, joint_zero: Any, draws: Any | None) -> Any:
        """A clean view with the faults of the sensors, within its bounds: encoder offsets, and noise where drawn."""
        xp, n = namespace(clean), len(self.layout.joint_order)
        joints, command = self.layout.slices["joint_position_0"].start, self.layout.slices["command"].start
        position = clean[:, joints : joints + n] + xp.take(joint_zero, xp.asarray(self.layout.joint_order), axis=-1)
        head, velocity = clean[:, :command], clean[:, joints + n : joints + 2 * n]
        if draws is not None:
            noise = (2.0 * draws - 1.0) * xp.asarray(self._noise, dtype=draws.dtype)
            head, position = head + noise[:, :command], position + noise[:, command : command + n]
            velocity = velocity + noise[:, command + n :]
        parts = [head, clean[:, command:joints], position, velocity, clean[:, joints + 2 * n :]]
        return self.layout.bounded(xp.astype(xp.concat(parts, axis=-1), xp.float32, copy=False))

    @cached_property
    def _noise(self) -> np.ndarray:
        """Half-width of each sensor's noise as the observation scales it, (SENSOR_DRAWS,)."""
        noise, scales, slices = self.config.noise, self.layout.scales, self.layout.slices
        widths = {"gyro": noise.gyro, "gravity": noise.gravity}
        for name in slices:
            if name.startswith(("joint_position", "joint_velocity")):
                widths[name] = vars(noise)[name.rpartition("_")[0]]
        return np.concatenate([width * scales[slices[name]] for name, width in widths.items()])

    def _privileged(self, clean: Any, state: WalkState, reading: Reading, body: BodyParameters) -> Any:
        """The critic's observation around a clean view of the actor's."""
        xp = namespace(reading.gyro)
        clean = self.layout.bounded(clean)
        clean = clean if self.layout.has_clock else xp.concat([clean, self.clock(state)], axis=-1)
        truth = ground_truth(reading, self.terrain)
        assert body.foot_friction is not None and body.torso_mass is not None
        known = [
            truth["velocity"],
            truth["height"],
            state.mean_velocity - state.command,
            truth["foot_height"],
            truth["foot_force"],
            truth["foot_speed"],
            body.foot_friction[:, None],
            body.torso_mass[:, None],
            state.delay[:, None],
        ]
        return critic_view(clean, known)

    @cached_property
    def privileged_mirror(self) -> mirror.Mirror:
        """Mirror of the critic's observation."""
        layout = observation_layout("asimov-80")
        swap = mirror.Mirror(np.array([1, 0]), np.ones(2))
        return mirror.join(
            [
                layout.mirror,
                mirror.mirror_polar,
                mirror.signs_mirror(1.0),
                mirror.mirror_command,
                swap,
                swap,
                swap,
                mirror.signs_mirror(1.0, 1.0, 1.0),
            ]
        )

    @property
    def privileged_width(self) -> int:
        return self.privileged_mirror.size


def _from_euler(roll: Any, pitch: Any, yaw: Any) -> Any:
    """Quaternions (N, 4) of a turn by yaw, then pitch, then roll."""
    xp = namespace(roll)
    cr, sr = xp.cos(0.5 * roll), xp.sin(0.5 * roll)
    cp, sp = xp.cos(0.5 * pitch), xp.sin(0.5 * pitch)
    cy, sy = xp.cos(0.5 * yaw), xp.sin(0.5 * yaw)
    return xp.stack(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ],
        axis=-1,
    )
