"""The 200 Hz loop of the robot: commands in, joint targets to the physics, a state snapshot out.

While joint control is open, each control step of 5 ms is five physics steps of 1 ms, with the law of the joint targets
run in each. Everything else, faults, time-outs, network and reports, keeps its rate.
"""

from __future__ import annotations

import hashlib
import logging
import secrets
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from asimov_gym.firmware.alerts import AlertBoard
from asimov_gym.firmware.battery import Battery
from asimov_gym.firmware.can_bus import CanBuses
from asimov_gym.firmware.clock import MICROSECONDS, Clock, StepClock
from asimov_gym.firmware.commands import Command, Damp, Freeze, Stand, Stream, Trajectory, Velocity
from asimov_gym.firmware.condition import Condition
from asimov_gym.firmware.config import FirmwareConfig
from asimov_gym.firmware.faults import FaultInjector
from asimov_gym.firmware.gantry import Gantry
from asimov_gym.firmware.joint_control import JointControl, RunEnd
from asimov_gym.firmware.joint_sample import JointSample, JointSampler
from asimov_gym.firmware.linkage import Linkage
from asimov_gym.firmware.modes import Outcome, State, Transition, Trigger, transition
from asimov_gym.firmware.motors import Motors
from asimov_gym.firmware.policy_control import InferenceTime, PolicyControl, PolicyFault
from asimov_gym.firmware.safety import Safety
from asimov_gym.firmware.sensing import ImuWatch, Sensing, silent_joints
from asimov_gym.firmware.snapshot import FirmwareState
from asimov_gym.firmware.torque_limits import TorqueLimits
from asimov_gym.firmware.trajectory_control import TrajectoryControl
from asimov_gym.firmware.watchdog import Watchdog
from asimov_gym.physics import CPhysics, JointTarget
from asimov_gym.policy import Policy
from asimov_gym.robot.alerts import AlertId
from asimov_gym.robot.joints import JOINT_NAMES, STAND_POSITION

_log = logging.getLogger(__name__)

_TO_DAMP = (Trigger.DAMP, Trigger.SILENCE, Trigger.FAULT, Trigger.E_STOP)
FAST_STEP_S = 0.001
"""Physics step while joint control is open, s."""
_ENCODER_ERROR = 5
"""What a motor driver answers when its encoder fails."""


@dataclass(frozen=True)
class Receipt:
    """What the firmware made of a command."""

    outcome: Outcome
    clamped: bool = False
    """A velocity was outside the policy's trained range and was clamped to it."""


class Firmware:
    """The robot's firmware on a simulated robot.

    Boots in DAMP, hanging from the gantry in the standing pose. `command` takes effect at once, `tick` runs one control
    step of 5 ms, or a fifth of one while `fast`. Faults are injected through `faults`, joint commands go to `joints`.

    Args:
        physics: one robot.
        clock: read by every time-out, ramp and timestamp.
        policy: the MOVE/POLICY network, as `asimov_gym.policy.load_policy` returns it; without, velocities are dropped.
        config: times, thresholds, gantry and motor figures.
        seed: of the sensor noise, and with a `StepClock` of the epochs.

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
        self.config = c = config or FirmwareConfig()
        realtime = not isinstance(clock, StepClock)
        self.gantry = Gantry(physics.model, c.gantry)
        self.motors = Motors(c.motors, seed)
        self.battery = Battery(c.battery)
        self.linkage = Linkage(c.ankle)
        self.policy = None if policy is None else PolicyControl(policy, c.inference, self.linkage, realtime)
        self.faults = FaultInjector(self)
        """Where the robot is broken on purpose."""
        self.joints = JointControl(self.linkage, c.joint_control)
        """Where joint commands go."""
        self._sampler = JointSampler(self.linkage, c.joint_control.contact_force)
        self.fast = False
        """Whether the physics runs at 1 kHz from the next control step on."""
        self.period_us = round(physics.timestep * MICROSECONDS)
        """Length of a control step, microseconds."""
        self.seed = seed
        self._sensing = Sensing(self.linkage, physics.timestep, c.aged_readings)
        self._safety = Safety(c)
        self._buses = CanBuses(c.can)
        self._imu = ImuWatch(c.imu_stale_s, c.imu_failure_s)
        self._watchdog = Watchdog(round(physics.timestep * MICROSECONDS), c.watchdog_s, realtime)
        self._limits = TorqueLimits(physics.figures.kp, physics.figures.kd, self.linkage)
        self._trajectories = TrajectoryControl(self.linkage, c.trajectory_timeout_s)
        self._stand = self.linkage.reached_position(STAND_POSITION)[None]
        self._damp_kp = np.zeros((1, len(JOINT_NAMES)))
        self._damp_kd = np.full((1, len(JOINT_NAMES)), c.damp_kd)
        self.e_stopped = False
        """Whether the E-stop is pressed."""
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
        self._boot_ticks = self.ticks
        self._epoch = self._new_epoch()
        self.alerts = AlertBoard()
        self._safety.reset()
        self._buses.reset()
        self._watchdog.reset()
        self._trajectories.reset()
        self.joints.reset()
        self._step_us, self._spent_s = 0, 0.0
        self._diverged = False
        self._walk: JointTarget | None = None
        self._state = State.DAMP
        self._changes: list[tuple[State, State]] = []
        self.damped_by: Trigger | None = None
        """What led to DAMP last, or was there to keep the robot in it; None since the boot."""
        self._limp = False
        self._entered_us = 0
        self._look()
        self._motor_torque = self.linkage.motor_torque(self._reading.joint_torque[0], self._reading.joint_position[0])
        self._entry_position = self._sense.reading.joint_position
        self._hold_velocity(None)
        self.snapshot = self._snapshot()

    def _new_epoch(self) -> int:
        if isinstance(self.clock, StepClock):
            digest = hashlib.blake2b(f"{self.seed}/{self.boots}".encode(), digest_size=8).digest()
            return int.from_bytes(digest, "big") >> 1 or 1
        return secrets.randbits(63) or 1

    def restart(self) -> None:
        """Restart the firmware: the only thing that clears a latched fault. Heat, charge, injected faults, a pressed
        E-stop and the robot's pose stay."""
        _log.info("firmware restarts")
        self._boot()

    def resume(self) -> None:
        """Tell the firmware that its loop starts again after a pause that was meant, which is no stall."""
        self._watchdog.reset()

    def hang(self) -> None:
        """Put the robot where it boots: standing pose, at rest, hanging (on its feet without a gantry)."""
        qpos, qvel = self.physics.standing()
        qpos[2] += self.gantry.hang_lift
        self.physics.reset(qpos, qvel)
        self.gantry.rehang()
        self._sensing.forget()
        self._look()

    def inject(self, alert: AlertId, source: int = 0, value: int = 0, threshold: int = 0) -> None:
        """Raise an alert as if the hardware had; see `FaultInjector.raise_alert`. A critical one latches DAMP."""
        if self.alerts.set(alert, self.now_us, value, threshold, source):
            self._fire(Trigger.FAULT)

    # -- commands ----------------------------------------------------------------------------------

    @property
    def state(self) -> State:
        """Where the mode machine is."""
        return self._state

    @property
    def now_us(self) -> int:
        """Firmware clock: microseconds since this boot."""
        return self.clock.now_us() - self._boot_us

    @property
    def limp(self) -> bool:
        """Whether the robot is in DAMP without torque, as asked for by `Damp(limp=True)`."""
        return self._limp and self._state is State.DAMP

    @property
    def rising(self) -> bool:
        """Whether STAND is still on its ramp to the standing pose."""
        return self._state is State.STAND and self._ramp(self.now_us) < 1.0

    @property
    def velocity(self) -> np.ndarray:
        """What the robot walks by from the next policy step on: vx, vy (m/s), yaw rate (rad/s), (3,)."""
        return self._velocity

    @property
    def foot_load(self) -> np.ndarray:
        """What the ground carries under the left and the right foot, N, (2,). Not a reading of the robot's."""
        return self._reading.foot_force[0, :, 2]

    @property
    def trajectory(self) -> Trajectory | None:
        """The last trajectory taken in this boot."""
        return self._trajectories.last

    def command(self, command: Command) -> Receipt:
        """Take a checked command; the mode changes at once, the joints from the next tick on."""
        trigger = command.trigger
        if isinstance(command, Stream) and self.joints.fault is not None:
            return Receipt(Outcome.JOINT_FAULT)
        if trigger is Trigger.VELOCITY and self.policy is None and self._state is not State.DAMP:
            return Receipt(Outcome.NO_POLICY)
        result = self._fire(trigger)
        if result.outcome is not Outcome.TAKEN:
            return Receipt(result.outcome)
        clamped = False
        if isinstance(command, Damp):
            self._limp = command.limp
        elif isinstance(command, Velocity):
            clamped = self._hold_velocity(command)
        elif isinstance(command, Trajectory):
            self.joints.end(RunEnd.OVERRIDDEN)
            self._trajectories.take(command, self.alerts, self.now_us)
        elif isinstance(command, Stream):
            self.joints.begin(self._sense.reading.joint_position[0], self.clock.now_us())
        elif isinstance(command, Freeze):
            self.joints.freeze(self._sense.reading.joint_position[0])
        elif isinstance(command, Stand) and self._state is State.DAMP:
            reason = "the E-stop is pressed" if self.e_stopped else f"error_flags 0x{self.alerts.error_flags:x}"
            _log.info("STAND has no effect: %s", reason)
        return Receipt(Outcome.TAKEN, clamped)

    def stop_walking(self) -> None:
        """Make the velocity zero where the robot walks: whoever commanded it has gone. The mode stays."""
        if self._state is State.POLICY:
            self._hold_velocity(None)

    def e_stop(self, pressed: bool) -> None:
        """Press or release the E-stop. Pressing it leads to DAMP at once; releasing it leaves the robot there.

        While it is pressed no command but DAMP has an effect. It latches nothing and sets no error flag.
        """
        if pressed != self.e_stopped:
            _log.warning("E-stop %s", "pressed" if pressed else "released")
        self.e_stopped = pressed
        if pressed:
            self._fire(Trigger.E_STOP)

    def _fire(self, trigger: Trigger) -> Transition:
        """Run the mode machine."""
        result = transition(self._state, trigger, self.alerts.latched, self.e_stopped)
        if trigger in _TO_DAMP:
            self.damped_by, self._limp = trigger, False
        if result.state is not self._state:
            if trigger in (Trigger.SILENCE, Trigger.E_STOP):  # a change that no command and no other alert explains
                self.alerts.set(AlertId.MODE_CHANGE, self.now_us, result.state.mode, self._state.mode)
            self._enter(result.state, trigger)
        return result

    def _enter(self, state: State, trigger: Trigger) -> None:
        _log.info("%s -> %s on %s", self._state.value, state.value, trigger.value)
        self._changes.append((self._state, state))
        self._state = state
        self._entered_us = self.now_us
        self._entry_position = self._sense.reading.joint_position
        self._hold_velocity(None)
        if state is not State.TRAJECTORY:
            stopped = trigger in (Trigger.FAULT, Trigger.E_STOP)
            self.joints.end(RunEnd.STOPPED if stopped else RunEnd.OVERRIDDEN)
        if state is State.POLICY:
            assert self.policy is not None
            self.policy.reset()
            self._walk = None

    def _hold_velocity(self, command: Velocity | None) -> bool:
        """Walk by a command, None for zero. True if it was clamped to the policy's range."""
        self._velocity_until_us: int | None = None
        if command is None:
            self._velocity = np.zeros(3)
            return False
        assert self.policy is not None
        self._velocity = self.policy.limit(command.vector)
        if command.timeout_s is not None:
            self._velocity_until_us = self.now_us + round(command.timeout_s * MICROSECONDS)
        clamped = not np.array_equal(self._velocity, command.vector)
        if clamped:
            _log.debug("velocity %s clamped to the policy's range: %s", command.vector, self._velocity)
        return clamped

    # -- the loop ----------------------------------------------------------------------------------

    def tick(self) -> FirmwareState:
        """Run one control step, or a fifth of one while `fast`, and return the robot's state after the last whole one.

        The clock stands at the end of the step already. `between_steps` says whether the control step is done.
        """
        start = time.perf_counter()
        clock_us = self.clock.now_us()
        now, first = clock_us - self._boot_us, self.between_steps
        if first:
            self.physics.set_timestep(self.step_us / MICROSECONDS)
            self.faults.update(clock_us)
        condition, dt = self.faults.condition, self.physics.timestep
        self._look()  # anew: someone may have pushed or moved the robot since
        if first:
            self._watch(condition, now, clock_us)
        self._watch_joints(clock_us)
        if first and self._state is State.POLICY:
            self._walk = self._policy_target(condition, now)
        target = self._machine_target(self._joint_target(now), condition)
        if first:
            self._sensing.remember(self._reading, self.motors.current, self.motors.temperature)
        wrench = self.gantry.wrench(self._state, self._ramp(now), self._reading, dt)
        self._reading = self.physics.step(target, 1, _sum_wrenches(wrench, condition.wrench))
        position = self._reading.joint_position[0]
        self._motor_torque = self.linkage.motor_torque(self._reading.joint_torque[0], position)
        self.motors.step(self._motor_torque, dt, condition.leak)
        if self.battery.due(dt):
            speed = self.linkage.motor_velocity(self._reading.joint_velocity[0], position)
            self.battery.sample(self._motor_torque, speed)
        self._sense = self._sensing.look(self._reading, self.motors.current, self.motors.temperature, condition)
        self._diverged |= bool(self.physics.diverged[0])
        self._step_us += round(dt * MICROSECONDS)
        self._spent_s = time.perf_counter() - start + (0.0 if first else self._spent_s)
        if self._step_us >= self.period_us:
            self._step_us = 0
            self.ticks += 1
            self.snapshot = self._snapshot()
            self._changes.clear()
            self._watchdog.add(self._spent_s)
        return self.snapshot

    @property
    def between_steps(self) -> bool:
        """Whether no control step is under way."""
        return self._step_us == 0

    @property
    def step_us(self) -> int:
        """Length of the next step, microseconds: of the whole control step, or of a fifth of it while `fast`."""
        if self.between_steps:
            return round(FAST_STEP_S * MICROSECONDS) if self.fast else self.period_us
        return round(self.physics.timestep * MICROSECONDS)

    def joint_sample(self) -> JointSample:
        """The robot now, as joint control reports it."""
        felt = self.physics.specific_force()[0] if self.faults.condition.imu_since_us is None else None
        return self._sampler.sample(self.clock.realtime_us(), self._reading, self._sense.reading, felt, self.joints)

    def _look(self) -> None:
        """Sense the robot as it is now."""
        self._reading = self.physics.read()
        motors = self.motors
        self._sense = self._sensing.look(self._reading, motors.current, motors.temperature, self.faults.condition)

    def _watch(self, condition: Condition, now: int, clock_us: int) -> None:
        """Faults and time-outs."""
        board = self.alerts
        latched = self._watchdog.check(board, now)
        latched |= self._safety.check(self._state, self._sense, board, now)
        latched |= self._buses.check(condition, board, now, clock_us)
        latched |= self._imu.check(condition, board, now, clock_us)
        latched |= self.battery.check(board, now)
        if condition.encoder_fault is not None:
            for motor in np.flatnonzero(condition.encoder_fault).tolist():
                latched |= board.set(AlertId.MOTOR_ENCODER_ERROR, now, _ENCODER_ERROR, source=motor)
        if self._diverged:
            self._diverged = False
            _log.error("the simulation diverged and the robot was put back on its feet: latching DAMP")
            latched |= board.set(AlertId.WATCHDOG_TIMEOUT, now)
        if latched:
            self._fire(Trigger.FAULT)
        if self._state is State.TRAJECTORY and not self.joints.drives and self._trajectories.silent(now):
            self._fire(Trigger.SILENCE)
        if self._velocity_until_us is not None and now >= self._velocity_until_us:
            self._hold_velocity(None)
        board.expire(now)

    def _watch_joints(self, clock_us: int) -> None:
        """Joint commands that run out, and joints that are too fast for them."""
        if not self.joints.running:
            return
        ended = self.joints.check(self._sense.reading.joint_velocity[0], clock_us, self.clock.realtime_us())
        if ended is None:
            return
        _log.info("joint control ends: %s", ended.value)
        self._fire(Trigger.SILENCE)  # for whatever reason: the joints have no target any more

    def _ramp(self, now: int) -> float:
        """Share of the stand ramp that is done, 0 to 1."""
        ramp_us = self.config.stand_ramp_s * MICROSECONDS
        return 1.0 if ramp_us <= 0.0 else min(1.0, (now - self._entered_us) / ramp_us)

    def _joint_target(self, now: int) -> JointTarget:
        """What the mode asks of the joints."""
        match self._state:
            case State.DAMP:
                kd = self._damp_kp if self._limp else self._damp_kd
                return JointTarget(self._sense.reading.joint_position, kp=self._damp_kp, kd=kd)
            case State.STAND:
                start = self._entry_position
                return JointTarget(start + self._ramp(now) * (self._stand - start))
            case State.TRAJECTORY if self.joints.drives:
                return self.joints.target(self._sense.reading.joint_position[0], self.clock.now_us())
            case State.TRAJECTORY:
                return self._trajectories.target
        return JointTarget(self._entry_position) if self._walk is None else self._walk

    def _policy_target(self, condition: Condition, now: int) -> JointTarget | None:
        """Ask the network; a failing, runaway or missing one latches DAMP."""
        assert self.policy is not None
        try:
            return self.policy.step(self._sense.reading, self._velocity, condition, self.alerts, now)
        except PolicyFault as fault:
            _log.error("policy fault %s: %s", fault.alert.name, fault)
            if self.alerts.set(fault.alert, now, fault.value, fault.threshold):
                self._fire(Trigger.FAULT)
            return None

    def _machine_target(self, target: JointTarget, condition: Condition) -> JointTarget:
        """What the motors can make of a target, at the torque that their speed leaves and without the silent ones."""
        reading = self._reading
        target = self._limits.apply(target, reading.joint_position, reading.joint_velocity)
        if condition.silent is None:
            return target
        alive = ~silent_joints(condition.silent)[None]
        figures = self.physics.figures
        kp = figures.kp if target.kp is None else target.kp
        kd = figures.kd if target.kd is None else target.kd
        return replace(target, kp=kp * alive, kd=kd * alive, load=None if target.load is None else target.load * alive)

    def _snapshot(self) -> FirmwareState:
        seen = self._sense.reading
        return FirmwareState(
            boot=self.boots,
            epoch=self._epoch,
            tick=self.ticks - self._boot_ticks,
            timestamp_us=self.now_us,
            state=self._state,
            changes=tuple(self._changes),
            e_stop=self.e_stopped,
            joint_position=seen.joint_position[0],
            joint_velocity=seen.joint_velocity[0],
            joint_torque=self._reading.joint_torque[0],
            motor_torque=self._motor_torque,
            motor_current=self._sense.current,
            motor_temperature=self._sense.temperature,
            imu_quat=seen.base_quat[0],
            imu_gyro=seen.gyro[0],
            imu_gravity=seen.gravity[0],
            alerts=self.alerts.active,
            error_flags=self.alerts.error_flags,
            velocity=self._velocity,
            gantry_force=self.gantry.force,
            battery=self.battery.state,
            cycle=self._watchdog.cycle,
            inference=InferenceTime() if self.policy is None else self.policy.time,
            bus_losses=self._buses.losses,
            linkage=self.linkage,
        )


def _sum_wrenches(
    rope: dict[str, np.ndarray] | None, pushes: Mapping[str, np.ndarray]
) -> Mapping[str, np.ndarray] | None:
    """Force and torque of rope and pushes together, by body."""
    if not pushes:
        return rope
    total = dict(pushes)
    for body, wrench in (rope or {}).items():
        total[body] = total.get(body, 0.0) + wrench
    return total
