"""The 200 Hz loop of the robot: commands in, joint targets to the physics, a state snapshot out.

While joint control is open, each control step of 5 ms is five physics steps of 1 ms, with the law of the joint targets
run in each. Everything else, faults, time-outs, network and reports, keeps its rate.

This module is the order of things within a step. What the commands do is in `mode_control`, the robot below the
firmware in `hardware`.
"""

from __future__ import annotations

import hashlib
import logging
import secrets
import time

import numpy as np

from asimov_gym.firmware.alerts import AlertBoard
from asimov_gym.firmware.can_bus import CanBuses
from asimov_gym.firmware.clock import MICROSECONDS, Clock, StepClock
from asimov_gym.firmware.commands import Command, Trajectory
from asimov_gym.firmware.condition import Condition
from asimov_gym.firmware.config import FirmwareConfig
from asimov_gym.firmware.faults import FaultInjector
from asimov_gym.firmware.hardware import Hardware
from asimov_gym.firmware.joint_control import JointControl
from asimov_gym.firmware.joint_sample import JointSample, JointSampler
from asimov_gym.firmware.linkage import Linkage
from asimov_gym.firmware.mode_control import ModeControl, Receipt
from asimov_gym.firmware.modes import State, Trigger
from asimov_gym.firmware.policy_control import InferenceTime, PolicyControl
from asimov_gym.firmware.safety import Safety
from asimov_gym.firmware.sensing import ImuWatch
from asimov_gym.firmware.snapshot import FirmwareState
from asimov_gym.firmware.watchdog import Watchdog
from asimov_gym.physics import CPhysics
from asimov_gym.policy import Policy
from asimov_gym.robot.alerts import AlertId

_log = logging.getLogger(__name__)

FAST_STEP_S = 0.001
"""Physics step while joint control is open, s."""
_ENCODER_ERROR = 5
"""What a motor driver answers when its encoder fails."""


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
        self.linkage = Linkage(c.ankle)
        self._hardware = Hardware(physics, self.linkage, c, seed)
        self.gantry = self._hardware.gantry
        self.motors = self._hardware.motors
        self.battery = self._hardware.battery
        self.policy = None if policy is None else PolicyControl(policy, c.inference, self.linkage, realtime)
        self.faults = FaultInjector(self)
        """Where the robot is broken on purpose."""
        self.joints = JointControl(self.linkage, c.joint_control)
        """Where joint commands go."""
        self.fast = False
        """Whether the physics runs at 1 kHz from the next control step on."""
        self.period_us = round(physics.timestep * MICROSECONDS)
        """Length of a control step, microseconds."""
        self.seed = seed
        self.boots = 0
        """How often the firmware has booted."""
        self.ticks = 0
        """Control steps since the robot was made."""
        self.alerts = AlertBoard()
        """Of this boot."""
        self._modes = ModeControl(self._hardware, self.linkage, c, self.policy, self.joints, self.alerts)
        self._sampler = JointSampler(self.linkage, c.joint_control.contact_force)
        self._safety = Safety(c)
        self._buses = CanBuses(c.can)
        self._imu = ImuWatch(c.imu_stale_s, c.imu_failure_s)
        self._watchdog = Watchdog(self.period_us, c.watchdog_s, realtime)
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
        self._hardware.wake(self.faults.condition)
        self._modes.reset(self.alerts)
        self._step_us, self._spent_s = 0, 0.0
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
        self._hardware.hang(self.faults.condition)

    def inject(self, alert: AlertId, source: int = 0, value: int = 0, threshold: int = 0) -> None:
        """Raise an alert as if the hardware had; see `FaultInjector.raise_alert`. A critical one latches DAMP."""
        if self.alerts.set(alert, self.now_us, value, threshold, source):
            self._modes.fire(Trigger.FAULT, self.now_us)

    # -- commands ----------------------------------------------------------------------------------

    def command(self, command: Command) -> Receipt:
        """Take a checked command; the mode changes at once, the joints from the next tick on."""
        clock_us = self.clock.now_us()
        return self._modes.take(command, clock_us - self._boot_us, clock_us)

    def stop_walking(self) -> None:
        """Make the velocity zero where the robot walks: whoever commanded it has gone. The mode stays."""
        self._modes.stop_walking()

    def e_stop(self, pressed: bool) -> None:
        """Press or release the E-stop. Pressing it leads to DAMP at once; releasing it leaves the robot there.

        While it is pressed no command but DAMP has an effect. It latches nothing and sets no error flag.
        """
        self._modes.e_stop(pressed, self.now_us)

    # -- what the outside sees ---------------------------------------------------------------------

    @property
    def state(self) -> State:
        """Where the mode machine is."""
        return self._modes.state

    @property
    def now_us(self) -> int:
        """Firmware clock: microseconds since this boot."""
        return self.clock.now_us() - self._boot_us

    @property
    def damped_by(self) -> Trigger | None:
        """What led to DAMP last, or was there to keep the robot in it; None since the boot."""
        return self._modes.damped_by

    @property
    def e_stopped(self) -> bool:
        """Whether the E-stop is pressed."""
        return self._modes.e_stopped

    @property
    def limp(self) -> bool:
        """Whether the robot is in DAMP without torque, as asked for by `Damp(limp=True)`."""
        return self._modes.limp

    @property
    def rising(self) -> bool:
        """Whether STAND is still on its ramp to the standing pose."""
        return self.state is State.STAND and self._modes.ramp(self.now_us) < 1.0

    @property
    def velocity(self) -> np.ndarray:
        """What the robot walks by from the next policy step on: vx, vy (m/s), yaw rate (rad/s), (3,)."""
        return self._modes.velocity

    @property
    def trajectory(self) -> Trajectory | None:
        """The last trajectory taken in this boot."""
        return self._modes.trajectory

    @property
    def foot_load(self) -> np.ndarray:
        """What the ground carries under the left and the right foot, N, (2,). Not a reading of the robot's."""
        return self._hardware.reading.foot_force[0, :, 2]

    def joint_sample(self) -> JointSample:
        """The robot now, as joint control reports it."""
        hardware, time_us = self._hardware, self.clock.realtime_us()
        felt = self.physics.specific_force()[0] if self.faults.condition.imu_since_us is None else None
        return self._sampler.sample(time_us, hardware.reading, hardware.sense.reading, felt, self.joints)

    def _snapshot(self) -> FirmwareState:
        hardware, modes = self._hardware, self._modes
        seen = hardware.sense.reading
        return FirmwareState(
            boot=self.boots,
            epoch=self._epoch,
            tick=self.ticks - self._boot_ticks,
            timestamp_us=self.now_us,
            state=modes.state,
            changes=tuple(modes.changes),
            e_stop=modes.e_stopped,
            joint_position=seen.joint_position[0],
            joint_velocity=seen.joint_velocity[0],
            joint_torque=hardware.reading.joint_torque[0],
            motor_torque=hardware.motor_torque,
            motor_current=hardware.sense.current,
            motor_temperature=hardware.sense.temperature,
            imu_quat=seen.base_quat[0],
            imu_gyro=seen.gyro[0],
            imu_gravity=seen.gravity[0],
            alerts=self.alerts.active,
            error_flags=self.alerts.error_flags,
            velocity=modes.velocity,
            gantry_force=self.gantry.force,
            battery=self.battery.state,
            cycle=self._watchdog.cycle,
            inference=InferenceTime() if self.policy is None else self.policy.time,
            bus_losses=self._buses.losses,
            linkage=self.linkage,
        )

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
        condition, hardware, modes = self.faults.condition, self._hardware, self._modes
        hardware.look(condition)  # anew: someone may have pushed or moved the robot since
        if first:
            self._watch(condition, now, clock_us)
        self._watch_joints(now, clock_us)
        if first:
            modes.step_policy(condition, now)
            hardware.remember()
        hardware.step(modes.target(now, clock_us), condition, modes.state, modes.ramp(now))
        self._step_us += round(self.physics.timestep * MICROSECONDS)
        self._spent_s = time.perf_counter() - start + (0.0 if first else self._spent_s)
        if self._step_us >= self.period_us:
            self._step_us = 0
            self.ticks += 1
            self.snapshot = self._snapshot()
            modes.changes.clear()
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

    def _watch(self, condition: Condition, now: int, clock_us: int) -> None:
        """Faults and time-outs."""
        board = self.alerts
        latched = self._watchdog.check(board, now)
        latched |= self._safety.check(self.state, self._hardware.sense, board, now)
        latched |= self._buses.check(condition, board, now, clock_us)
        latched |= self._imu.check(condition, board, now, clock_us)
        latched |= self.battery.check(board, now)
        if condition.encoder_fault is not None:
            for motor in np.flatnonzero(condition.encoder_fault).tolist():
                latched |= board.set(AlertId.MOTOR_ENCODER_ERROR, now, _ENCODER_ERROR, source=motor)
        if self._hardware.diverged:
            self._hardware.diverged = False
            _log.error("the simulation diverged and the robot was put back on its feet: latching DAMP")
            latched |= board.set(AlertId.WATCHDOG_TIMEOUT, now)
        if latched:
            self._modes.fire(Trigger.FAULT, now)
        self._modes.expire(now)
        board.expire(now)

    def _watch_joints(self, now: int, clock_us: int) -> None:
        """Joint commands that run out, and joints that are too fast for them."""
        if not self.joints.running:
            return
        ended = self.joints.check(self._hardware.sense.reading.joint_velocity[0], clock_us, self.clock.realtime_us())
        if ended is None:
            return
        _log.info("joint control ends: %s", ended.value)
        self._modes.fire(Trigger.SILENCE, now)  # for whatever reason: the joints have no target any more
