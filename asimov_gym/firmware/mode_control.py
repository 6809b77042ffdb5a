"""The mode machine at work: what commands and events do to it, and what each mode asks of the joints.

Which trigger leads where is the table of `asimov_gym.firmware.modes`. Here is what goes with it: the velocity that is
held, the pose that a mode was entered in, what a change of mode ends, and the joint target that follows from all that.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np

from asimov_gym.firmware.alerts import AlertBoard
from asimov_gym.firmware.clock import MICROSECONDS
from asimov_gym.firmware.commands import Command, Damp, Freeze, Stand, Stream, Trajectory, Velocity
from asimov_gym.firmware.condition import Condition
from asimov_gym.firmware.config import FirmwareConfig
from asimov_gym.firmware.hardware import Hardware
from asimov_gym.firmware.joint_control import JointControl, RunEnd
from asimov_gym.firmware.linkage import Linkage
from asimov_gym.firmware.modes import Outcome, State, Transition, Trigger, transition
from asimov_gym.firmware.policy_control import PolicyControl, PolicyFault
from asimov_gym.firmware.stand import stand_target
from asimov_gym.firmware.trajectory_control import TrajectoryControl
from asimov_gym.physics import JointTarget
from asimov_gym.robot.alerts import AlertId
from asimov_gym.robot.joints import JOINT_NAMES, STAND_POSITION

_log = logging.getLogger(__name__)

_TO_DAMP = (Trigger.DAMP, Trigger.SILENCE, Trigger.FAULT, Trigger.E_STOP)


@dataclass(frozen=True)
class Receipt:
    """What the firmware made of a command."""

    outcome: Outcome
    clamped: bool = False
    """A velocity was outside the policy's trained range and was clamped to it."""


class ModeControl:
    """Holds the state of the mode machine and drives the joints by it.

    `now_us` is firmware time in every argument list, `clock_us` the time of the robot's clock.

    Args:
        hardware: sensed here, driven by others.
        linkage: between the standing pose that is asked for and the one that the ankles reach.
        config: ramp, damping and time-outs.
        policy: drives in MOVE/POLICY; without, velocities are dropped.
        joints: drives in MOVE/TRAJECTORY while a stream of joint commands runs or a pose is frozen.
        board: takes the alerts of this boot.
    """

    def __init__(
        self,
        hardware: Hardware,
        linkage: Linkage,
        config: FirmwareConfig,
        policy: PolicyControl | None,
        joints: JointControl,
        board: AlertBoard,
    ) -> None:
        self._hardware = hardware
        self._policy = policy
        self._joints = joints
        self._trajectories = TrajectoryControl(linkage, config.trajectory_timeout_s)
        self._stand = linkage.reached_position(STAND_POSITION)[None]
        self._ramp_us = config.stand_ramp_s * MICROSECONDS
        self._no_gain = np.zeros((1, len(JOINT_NAMES)))
        self._damp_kd = np.full((1, len(JOINT_NAMES)), config.damp_kd)
        self.e_stopped = False
        """Whether the E-stop is pressed."""
        self.reset(board)

    def reset(self, board: AlertBoard) -> None:
        """The firmware boots, with a new board: in DAMP, nothing commanded. A pressed E-stop stays pressed."""
        self._board = board
        self._trajectories.reset()
        self._joints.reset()
        self.state = State.DAMP
        """Where the mode machine is."""
        self.changes: list[tuple[State, State]] = []
        """What it went through, from and to, since whoever reads this last emptied it."""
        self.damped_by: Trigger | None = None
        """What led to DAMP last, or was there to keep the robot in it; None since the boot."""
        self._limp = False
        self._entered_us = 0
        self._entry_position = self._hardware.sense.reading.joint_position
        self._walk: JointTarget | None = None
        self._zero_velocity()

    @property
    def limp(self) -> bool:
        """Whether the robot is in DAMP without torque, as asked for by `Damp(limp=True)`."""
        return self._limp and self.state is State.DAMP

    @property
    def velocity(self) -> np.ndarray:
        """What the robot walks by from the next policy step on: vx, vy (m/s), yaw rate (rad/s), (3,)."""
        return self._velocity

    @property
    def trajectory(self) -> Trajectory | None:
        """The last trajectory taken in this boot."""
        return self._trajectories.last

    def ramp(self, now_us: int) -> float:
        """Share of the stand ramp that is done, 0 to 1; only of meaning in STAND."""
        return 1.0 if self._ramp_us <= 0.0 else min(1.0, (now_us - self._entered_us) / self._ramp_us)

    # -- commands and events -----------------------------------------------------------------------

    def take(self, command: Command, now_us: int, clock_us: int) -> Receipt:
        """Take a checked command; the mode changes at once, the joints with the next target."""
        trigger = command.trigger
        if isinstance(command, Stream) and self._joints.fault is not None:
            return Receipt(Outcome.JOINT_FAULT)
        if trigger is Trigger.VELOCITY and self._policy is None and self.state is not State.DAMP:
            return Receipt(Outcome.NO_POLICY)
        result = self.fire(trigger, now_us)
        if result.outcome is not Outcome.TAKEN:
            return Receipt(result.outcome)
        clamped = False
        if isinstance(command, Damp):
            self._limp = command.limp
        elif isinstance(command, Velocity):
            clamped = self._hold_velocity(command, now_us)
        elif isinstance(command, Trajectory):
            self._joints.end(RunEnd.OVERRIDDEN)
            self._trajectories.take(command, self._board, now_us)
        elif isinstance(command, Stream):
            self._joints.begin(self._hardware.sense.reading.joint_position[0], clock_us)
        elif isinstance(command, Freeze):
            self._joints.freeze(self._hardware.sense.reading.joint_position[0])
        elif isinstance(command, Stand) and self.state is State.DAMP:
            reason = "the E-stop is pressed" if self.e_stopped else f"error_flags 0x{self._board.error_flags:x}"
            _log.info("STAND has no effect: %s", reason)
        return Receipt(Outcome.TAKEN, clamped)

    def stop_walking(self) -> None:
        """Make the velocity zero where the robot walks."""
        if self.state is State.POLICY:
            self._zero_velocity()

    def e_stop(self, pressed: bool, now_us: int) -> None:
        """Press or release the E-stop."""
        if pressed != self.e_stopped:
            _log.warning("E-stop %s", "pressed" if pressed else "released")
        self.e_stopped = pressed
        if pressed:
            self.fire(Trigger.E_STOP, now_us)

    def expire(self, now_us: int) -> None:
        """End what has run out of time: a trajectory that fell silent, a velocity that was given for a while."""
        if self.state is State.TRAJECTORY and not self._joints.drives and self._trajectories.silent(now_us):
            self.fire(Trigger.SILENCE, now_us)
        if self._velocity_until_us is not None and now_us >= self._velocity_until_us:
            self._zero_velocity()

    def fire(self, trigger: Trigger, now_us: int) -> Transition:
        """Run the mode machine."""
        result = transition(self.state, trigger, self._board.latched, self.e_stopped)
        if trigger in _TO_DAMP:
            self.damped_by, self._limp = trigger, False
        if result.state is not self.state:
            if trigger in (Trigger.SILENCE, Trigger.E_STOP):  # a change that no command and no other alert explains
                self._board.set(AlertId.MODE_CHANGE, now_us, result.state.mode, self.state.mode)
            self._enter(result.state, trigger, now_us)
        return result

    def _enter(self, state: State, trigger: Trigger, now_us: int) -> None:
        _log.info("%s -> %s on %s", self.state.value, state.value, trigger.value)
        self.changes.append((self.state, state))
        self.state = state
        self._entered_us = now_us
        self._entry_position = self._hardware.sense.reading.joint_position
        self._zero_velocity()
        if state is not State.TRAJECTORY:
            stopped = trigger in (Trigger.FAULT, Trigger.E_STOP)
            self._joints.end(RunEnd.STOPPED if stopped else RunEnd.OVERRIDDEN)
        if state is State.POLICY:
            assert self._policy is not None
            self._policy.reset()
            self._walk = None

    def _zero_velocity(self) -> None:
        self._velocity = np.zeros(3)
        self._velocity_until_us: int | None = None

    def _hold_velocity(self, command: Velocity, now_us: int) -> bool:
        """Walk by a command. True if it was clamped to the policy's range."""
        assert self._policy is not None
        self._velocity = self._policy.limit(command.vector)
        timeout = command.timeout_s
        self._velocity_until_us = None if timeout is None else now_us + round(timeout * MICROSECONDS)
        clamped = not np.array_equal(self._velocity, command.vector)
        if clamped:
            _log.debug("velocity %s clamped to the policy's range: %s", command.vector, self._velocity)
        return clamped

    # -- joint targets -----------------------------------------------------------------------------

    def step_policy(self, condition: Condition, now_us: int) -> None:
        """One control step of the network, in MOVE/POLICY; a failing, runaway or missing one latches DAMP."""
        if self.state is not State.POLICY:
            return
        assert self._policy is not None
        sensed = self._hardware.sense.reading
        try:
            self._walk = self._policy.step(sensed, self._velocity, condition, self._board, now_us)
        except PolicyFault as fault:
            self._walk = None
            _log.error("policy fault %s: %s", fault.alert.name, fault)
            if self._board.set(fault.alert, now_us, fault.value, fault.threshold):
                self.fire(Trigger.FAULT, now_us)

    def target(self, now_us: int, clock_us: int) -> JointTarget:
        """What the mode asks of the joints, arrays (1, 25)."""
        position = self._hardware.sense.reading.joint_position
        match self.state:
            case State.DAMP:
                return JointTarget(position, kp=self._no_gain, kd=self._no_gain if self._limp else self._damp_kd)
            case State.STAND:
                return JointTarget(stand_target(self._entry_position, self._stand, self.ramp(now_us)))
            case State.TRAJECTORY if self._joints.drives:
                return self._joints.target(position[0], clock_us)
            case State.TRAJECTORY:
                return self._trajectories.target
        return JointTarget(self._entry_position) if self._walk is None else self._walk
