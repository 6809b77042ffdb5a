"""The 200 Hz loop of the robot: commands in, joint targets to the physics, a state snapshot out."""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np

from asimov_gym.firmware.alerts import AlertBoard
from asimov_gym.firmware.clock import MICROSECONDS, Clock
from asimov_gym.firmware.commands import Command, Stand, Trajectory, Velocity
from asimov_gym.firmware.config import FirmwareConfig
from asimov_gym.firmware.gantry import Gantry
from asimov_gym.firmware.linkage import Linkage
from asimov_gym.firmware.modes import Outcome, State, Trigger, transition
from asimov_gym.firmware.motors import Motors
from asimov_gym.firmware.policy_control import PolicyControl, PolicyFault
from asimov_gym.firmware.safety import Safety
from asimov_gym.firmware.snapshot import FirmwareState
from asimov_gym.physics import DECIMATION, CPhysics, JointTarget
from asimov_gym.policy import Policy
from asimov_gym.robot.alerts import AlertId
from asimov_gym.robot.joints import JOINT_NAMES, RANGE, STAND_POSITION

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Receipt:
    """What the firmware made of a command."""

    outcome: Outcome
    clamped: bool = False
    """A velocity was outside the policy's trained range and was clamped to it."""


class Firmware:
    """The robot's firmware on a simulated robot.

    Boots in DAMP, hanging from the gantry in the standing pose. `command` takes effect at once, `tick` runs one control
    step of 5 ms.

    Args:
        physics: one robot.
        clock: read by every time-out, ramp and timestamp.
        policy: the MOVE/POLICY network, as `asimov_gym.policy.load_policy` returns it; without, velocities are dropped.
        config: times, thresholds, gantry and motor figures.
        seed: of the sensor noise.

    Raises:
        ValueError: the physics holds more than one robot.
    """

    def __init__(
        self,
        physics: CPhysics,
        clock: Clock,
        policy: Policy | None = None,
        config: FirmwareConfig | None = None,
        seed: int = 0,
    ) -> None:
        if physics.copies != 1:
            raise ValueError(f"firmware drives one robot: physics.copies must be 1, got {physics.copies}")
        self.physics = physics
        self.clock = clock
        self.config = config or FirmwareConfig()
        self.gantry = Gantry(physics.model, self.config.gantry)
        self.motors = Motors(self.config.motors, seed)
        self.linkage = Linkage(self.config.ankle)
        self.policy = None if policy is None else PolicyControl(policy, self.config.action_limit, self.linkage)
        self._safety = Safety(self.config)
        self._damp_kp = np.zeros((1, len(JOINT_NAMES)))
        self._damp_kd = np.full((1, len(JOINT_NAMES)), self.config.damp_kd)
        self.boots = 0
        """How often the firmware has booted."""
        self.ticks = 0
        """Control steps since the robot was made."""
        self.hang()
        self._boot()

    # -- life --------------------------------------------------------------------------------------

    def _boot(self) -> None:
        self.boots += 1
        self._boot_us = self.clock.now_us()
        self.alerts = AlertBoard()
        self._state = State.DAMP
        self._entered_us = 0
        self._entry_position = self._reading.joint_position.copy()
        self._velocity = np.zeros(3)
        self.trajectory: Trajectory | None = None
        """The last trajectory taken in this boot."""
        self._trajectory_us = 0
        self._policy_ticks = 0
        self._target = JointTarget(self._entry_position)
        self.snapshot = self._snapshot()

    def restart(self) -> None:
        """Restart the firmware: the only thing that clears a latched fault. Heat and the robot's pose stay."""
        _log.info("firmware restarts")
        self._boot()

    def hang(self) -> None:
        """Put the robot where it boots: standing pose, at rest, hanging (on its feet without a gantry)."""
        qpos, qvel = self.physics.standing()
        qpos[2] += self.gantry.hang_lift
        self.physics.reset(qpos, qvel)
        self.gantry.rehang()
        self._reading = self.physics.read()

    def inject(self, alert: AlertId, source: int = 0, value: int = 0, threshold: int = 0) -> None:
        """Raise an alert as if the hardware had: a rehearsal of a fault. A critical one latches DAMP."""
        if self.alerts.set(alert, self.now_us, value, threshold, source):
            self._fault()

    # -- commands ----------------------------------------------------------------------------------

    @property
    def state(self) -> State:
        """Where the mode machine is."""
        return self._state

    @property
    def now_us(self) -> int:
        """Firmware clock: microseconds since this boot."""
        return self.clock.now_us() - self._boot_us

    def command(self, command: Command) -> Receipt:
        """Take a checked command; the mode changes at once, the joints from the next tick on."""
        trigger = command.trigger
        if trigger is Trigger.VELOCITY and self.policy is None and self._state is not State.DAMP:
            return Receipt(Outcome.NO_POLICY)
        result = transition(self._state, trigger, self.alerts.latched)
        if result.outcome is not Outcome.TAKEN:
            return Receipt(result.outcome)
        self._enter(result.state, trigger)
        clamped = False
        if isinstance(command, Velocity):
            assert self.policy is not None
            self._velocity = self.policy.limit(command.vector)
            clamped = not np.array_equal(self._velocity, command.vector)
            if clamped:
                _log.debug("velocity %s clamped to the policy's range: %s", command.vector, self._velocity)
        elif isinstance(command, Trajectory):
            self.trajectory, self._trajectory_us = command, self.now_us
        elif isinstance(command, Stand) and self.alerts.latched:
            _log.info("STAND has no effect: error_flags 0x%x; restart the firmware", self.alerts.error_flags)
        return Receipt(Outcome.TAKEN, clamped)

    def _enter(self, state: State, trigger: Trigger) -> None:
        if state is self._state:
            return
        _log.info("%s -> %s on %s", self._state.value, state.value, trigger.value)
        self._state = state
        self._entered_us = self.now_us
        self._entry_position = self._reading.joint_position.copy()
        self._velocity = np.zeros(3)
        if state is State.POLICY:
            assert self.policy is not None
            self.policy.reset()
            self._policy_ticks = 0

    def _fault(self) -> None:
        self._enter(transition(self._state, Trigger.FAULT, latched=True).state, Trigger.FAULT)

    # -- the loop ----------------------------------------------------------------------------------

    def tick(self) -> FirmwareState:
        """Run one control step and return the robot's state after it."""
        now = self.now_us
        self._reading = self.physics.read()  # anew: someone may have pushed or moved the robot since
        self._watch(now)
        target = self._joint_target(now)
        dt = self.physics.timestep
        wrench = self.gantry.wrench(self._state, self._ramp(now), self._reading, dt)
        self._reading = self.physics.step(target, 1, wrench)
        self.motors.step(self._motor_torque(), dt)
        self.ticks += 1
        self.snapshot = self._snapshot()
        return self.snapshot

    def _watch(self, now: int) -> None:
        """Faults and time-outs."""
        latched = self._safety.check(self._state, self._reading, self.motors.temperature, self.alerts, now)
        if self.physics.diverged[0]:
            _log.error("the simulation diverged and the robot was put back on its feet: latching DAMP")
            latched |= self.alerts.set(AlertId.WATCHDOG_TIMEOUT, now)
        if latched:
            self._fault()
        silent_us = round(self.config.trajectory_timeout_s * MICROSECONDS)
        if self._state is State.TRAJECTORY and now - self._trajectory_us >= silent_us:
            self._enter(transition(self._state, Trigger.SILENCE, latched=False).state, Trigger.SILENCE)
        self.alerts.expire(now)

    def _ramp(self, now: int) -> float:
        """Share of the stand ramp that is done, 0 to 1."""
        ramp_us = self.config.stand_ramp_s * MICROSECONDS
        return 1.0 if ramp_us <= 0.0 else min(1.0, (now - self._entered_us) / ramp_us)

    def _joint_target(self, now: int) -> JointTarget:
        if self._state is State.POLICY:
            if self._policy_ticks % DECIMATION == 0:
                self._target = self._policy_target(now)
            self._policy_ticks += 1
        # Not `else`: a policy fault has just taken the robot to DAMP.
        if self._state is State.DAMP:
            return JointTarget(self._reading.joint_position, kp=self._damp_kp, kd=self._damp_kd)
        if self._state is State.STAND:
            start, share = self._entry_position, self._ramp(now)
            goal = self.linkage.reached_position(STAND_POSITION)
            return JointTarget(start + share * (goal - start))
        if self._state is State.TRAJECTORY:
            assert self.trajectory is not None
            t = self.trajectory
            gains = [None if gain is None else gain[None] for gain in (t.kp, t.kd)]
            return JointTarget(np.clip(t.position, RANGE[:, 0], RANGE[:, 1])[None], kp=gains[0], kd=gains[1])
        return self._target

    def _policy_target(self, now: int) -> JointTarget:
        """Ask the network; a failing or runaway one latches DAMP."""
        assert self.policy is not None
        try:
            return self.policy.step(self._reading, self._velocity)
        except PolicyFault as fault:
            _log.error("policy fault %s: %s", fault.alert.name, fault)
            if self.alerts.set(fault.alert, now, fault.value, fault.threshold):
                self._fault()
            return self._target

    def _motor_torque(self) -> np.ndarray:
        return self.linkage.motor_torque(self._reading.joint_torque[0], self._reading.joint_position[0])

    def _snapshot(self) -> FirmwareState:
        r = self._reading
        return FirmwareState(
            boot=self.boots,
            timestamp_us=self.now_us,
            state=self._state,
            joint_position=r.joint_position[0],
            joint_velocity=r.joint_velocity[0],
            joint_torque=r.joint_torque[0],
            motor_position=self.linkage.motor_position(r.joint_position[0]),
            motor_velocity=self.linkage.motor_velocity(r.joint_velocity[0], r.joint_position[0]),
            motor_torque=self._motor_torque(),
            motor_current=self.motors.current,
            motor_temperature=self.motors.temperature.copy(),
            imu_quat=r.base_quat[0],
            imu_gyro=r.gyro[0],
            imu_gravity=r.gravity[0],
            alerts=self.alerts.active,
            error_flags=self.alerts.error_flags,
            velocity=self._velocity,
            gantry_force=self.gantry.force,
        )
