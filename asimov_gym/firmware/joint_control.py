"""MOVE/TRAJECTORY driven by a stream of joint commands: who is in force, until when, and what ends it.

A run begins with `Stream`, a command like any other, and ends when the last joint command runs out, when a joint is
faster than the command allows, or when any other command or fault takes the robot elsewhere. The stream alone moves
nothing: joint commands before the run are kept, so that the first one, with the gains, may come before it. After the
run the robot goes to DAMP, as it does when a trajectory falls silent.

A joint that was too fast leaves a fault of this interface. It latches nothing, sets no error flag and leaves every
other command as it is; only the next `Stream` is refused until it is cleared, here or by a restart of the firmware.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

import numpy as np

from asimov_gym.firmware.clock import MICROSECONDS
from asimov_gym.firmware.joint_command import (
    ASIMOV_LIMITS,
    FEET,
    Advice,
    JointCommand,
    JointGains,
    JointLimits,
    desired_target,
)
from asimov_gym.firmware.linkage import Linkage
from asimov_gym.firmware.trajectory_control import KD_LIMIT, KP_LIMIT
from asimov_gym.physics import JointTarget
from asimov_gym.robot.joints import JOINT_NAMES


@dataclass(frozen=True)
class JointControlConfig:
    """Figures of joint control. All our choice: the interface that it follows publishes none of them."""

    wait_s: float = 2.0
    """How long a run waits for its first joint command, holding the pose, before it ends; and a stream for its run."""
    horizon_s: float = 10.0
    """A joint command may end this far ahead."""
    silence_s: float | None = None
    """A run ends after this long without a joint command, whatever their ends say; 0.2 is the rule of the robot's own
    trajectories. None leaves it to their ends."""
    kp_limit: float = KP_LIMIT
    """Greater position gains are clamped, N·m/rad."""
    kd_limit: float = KD_LIMIT
    """Greater damping gains are clamped, N·m·s/rad."""
    contact_force: float = 10.0
    """A foot touches the ground when it bears this much, N."""

    def __post_init__(self) -> None:
        allowed = {
            "wait_s": (0.0, 60.0),
            "horizon_s": (0.005, 3600.0),
            "silence_s": (0.005, 60.0),
            "kp_limit": (0.0, KP_LIMIT),
            "kd_limit": (0.0, KD_LIMIT),
            "contact_force": (0.0, 1000.0),
        }
        for name, (low, high) in allowed.items():
            value = getattr(self, name)
            if name == "silence_s" and value is None:
                continue
            if not (math.isfinite(value) and low <= value <= high):
                raise ValueError(f"joint_control {name} must be between {low:g} and {high:g}, got {value!r}")


class Refusal(Enum):
    """Why a joint command is not taken."""

    EXPIRED = "it came after its own end"
    TOO_DISTANT = "its end is too far ahead"
    NO_GAINS = "the first joint command of a run must carry gains"


class RunEnd(Enum):
    """What ended a run."""

    EXPIRED = "the last joint command ran out"
    SILENT = "no joint command came"
    FAULT = "a joint was faster than the joint command allows"
    OVERRIDDEN = "another command"
    STOPPED = "a fault of the robot, or the E-stop"
    RESTARTED = "the firmware restarted"


@dataclass(frozen=True)
class JointFault:
    """A joint was faster than the joint command in force allowed."""

    number: int
    """Counted from 1, never used twice while the robot lives."""
    onset_us: int
    """Real time of the robot's clock, microseconds since 1970."""
    joint: str
    speed: float
    """rad/s."""
    limit: float
    """rad/s."""

    def __str__(self) -> str:
        return f"fault {self.number}: {self.joint} at {self.speed:.2f} rad/s, limit {self.limit:g}"


@dataclass(frozen=True)
class Echo:
    """The last joint command taken, as it is echoed in the state."""

    key: int = 0
    received_us: int = 0
    """Real time of the robot's clock, microseconds since 1970; 0 before the first."""


_NO_ADVICE = (Advice.NONE,) * FEET


class JointControl:
    """Turns joint commands into joint targets while a run lasts.

    Args:
        linkage: between what is commanded and what the ankles reach.
        config: times and limits.
        limits: of positions and loads.
    """

    def __init__(self, linkage: Linkage, config: JointControlConfig, limits: JointLimits = ASIMOV_LIMITS) -> None:
        self.config = config
        self.limits = limits
        self._linkage = linkage
        self._fault_number = 0
        self.runs = 0
        """How many runs have begun."""
        self.running = False
        """Whether a run lasts."""
        self.ended: RunEnd | None = None
        """What ended the last run; None while one lasts, and before the first."""
        self.reset()

    def reset(self) -> None:
        """The firmware boots: no run, no fault, nothing remembered."""
        self.end(RunEnd.RESTARTED)
        self.forget_stream()
        self.fault: JointFault | None = None
        """Keeps the next run from beginning."""
        self.echo = Echo()
        self.received = 0
        """Joint commands taken in this run; without one for the next, or else in the last."""
        self._counts_anew = False

    def forget_stream(self) -> None:
        """Forget commands and gains: the stream that they came by has gone, or the run has ended."""
        self.command: JointCommand | None = None
        self._received_us = 0
        self._gains: JointGains | None = None

    # -- commands ----------------------------------------------------------------------------------

    def begin(self, pose: np.ndarray, now_us: int) -> None:
        """A run begins. Until its first command is in force the robot holds its pose with its own gains.

        Args:
            pose: rad, (25,).
            now_us: robot's clock.
        """
        self.runs += 1
        self._count_anew()
        self.running, self.ended = True, None
        self._frozen = None
        self._hold = JointTarget(pose[None])
        self._wait_until_us = now_us + round(self.config.wait_s * MICROSECONDS)
        self._heard_us = now_us
        if self.command is not None and now_us >= self.command.end_us:
            self.command = None

    def freeze(self, pose: np.ndarray) -> None:
        """Hold a pose with the robot's own gains until another command; ends a run."""
        self.end(RunEnd.OVERRIDDEN)
        self._frozen = JointTarget(pose[None])

    def end(self, why: RunEnd) -> None:
        """The run is over, for a reason. A held pose is given up, too."""
        self._frozen: JointTarget | None = None
        if self.running:
            self.running, self.ended = False, why
            self._counts_anew = True
            self.forget_stream()

    def take(self, command: JointCommand, now_us: int, realtime_us: int) -> Refusal | None:
        """Follow a joint command from now on, or once a run begins.

        Args:
            command: within its own limits; gains beyond the configured ones are clamped.
            now_us: robot's clock.
            realtime_us: the same in microseconds since 1970, for the echo.

        Returns:
            None, or why it is refused; the one before stays in force then.
        """
        if now_us >= command.end_us:
            return Refusal.EXPIRED
        if command.end_us - now_us > self.config.horizon_s * MICROSECONDS:
            return Refusal.TOO_DISTANT
        gains = self._gains
        if command.gains is not None:
            gains = command.gains.within(self.config.kp_limit, self.config.kd_limit)
        if gains is None:
            return Refusal.NO_GAINS
        self._gains, self.command = gains, command
        self._received_us = self._heard_us = now_us
        self.echo = Echo(command.key, realtime_us)
        self._count_anew()
        self.received += 1
        return None

    def _count_anew(self) -> None:
        if self._counts_anew:
            self.received, self._counts_anew = 0, False

    def clear_fault(self, number: int) -> bool:
        """Clear the fault of that number; False if there is no such fault."""
        if self.fault is None or self.fault.number != number:
            return False
        self.fault = None
        return True

    # -- the loop ----------------------------------------------------------------------------------

    @property
    def drives(self) -> bool:
        """Whether the joints follow this and not a trajectory."""
        return self.running or self._frozen is not None

    @property
    def frozen(self) -> bool:
        """Whether a pose is held."""
        return self._frozen is not None

    @property
    def advice(self) -> tuple[Advice, ...]:
        """Contact advice in force."""
        return self.command.advice if self.running and self.command is not None else _NO_ADVICE

    def check(self, speed: np.ndarray, now_us: int, realtime_us: int) -> RunEnd | None:
        """Look whether the run goes on; ends it if not, and says why.

        Args:
            speed: of the joints as measured, rad/s, (25,).
            now_us: robot's clock.
            realtime_us: the same in microseconds since 1970.
        """
        if not self.running:
            return None
        why = self._reason_to_end(speed, now_us, realtime_us)
        if why is not None:
            self.end(why)
        return why

    def _reason_to_end(self, speed: np.ndarray, now_us: int, realtime_us: int) -> RunEnd | None:
        command = self.command
        if command is None:
            return RunEnd.SILENT if now_us >= self._wait_until_us else None
        if now_us >= command.end_us:
            return RunEnd.EXPIRED
        silence = self.config.silence_s
        if silence is not None and now_us - self._heard_us >= silence * MICROSECONDS:
            return RunEnd.SILENT
        limit = command.velocity_limit
        if limit is not None and (fastest := float(np.abs(speed).max())) > limit:
            self._fault_number += 1
            joint = JOINT_NAMES[int(np.abs(speed).argmax())]
            self.fault = JointFault(self._fault_number, realtime_us, joint, fastest, limit)
            return RunEnd.FAULT
        return None

    def target(self, measured: np.ndarray, now_us: int) -> JointTarget:
        """The present joint target.

        Args:
            measured: pose, rad, (25,).
            now_us: robot's clock.

        Raises:
            RuntimeError: it does not drive the joints.
        """
        if self._frozen is not None:
            return self._frozen
        if not self.running:
            raise RuntimeError("joint control does not drive the joints: no run has begun")
        if self.command is None or self._gains is None:
            return self._hold
        target = desired_target(self.command, self._gains, self._received_us, now_us, measured, self.limits)
        if self._linkage.form == "linear":
            return target
        reached = self._linkage.reached_position(target.position)
        return JointTarget(reached, target.velocity, target.load, target.kp, target.kd)
