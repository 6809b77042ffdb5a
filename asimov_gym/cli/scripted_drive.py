"""Drives a robot through a script over a session, in real time or in lockstep, and notices when it does not follow."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Protocol

from asimov_gym.cli.drive_script import Step, Verb
from asimov_gym.cli.telemetry_line import fault_names, mode_name, telemetry_line
from asimov_gym.edge.wire import cloud_pb2

if TYPE_CHECKING:
    from asimov_gym.edge import Session, SimulatedRobot

PATIENCE = 3.0
"""A robot that does not report the mode it was sent to for so long does not follow, s."""
SEND_AGAIN = 0.5
"""Until then the command is sent again this often, s: over UDP it may be lost, or come before the robot is armed."""
LOST = 2.0
"""Without a sample for so long the link is lost, s."""
SLICE = 0.05
"""Between two looks at the robot, s."""
STALE = 0.3
"""A sample that comes this long after a command shows the robot after it, s: telemetry comes at 10 Hz or more."""

_MODES = {
    Verb.STAND: cloud_pb2.FW_MODE_STAND,
    Verb.VELOCITY: cloud_pb2.FW_MODE_MOVE,
    Verb.STOP: cloud_pb2.FW_MODE_MOVE,
    Verb.DAMP: cloud_pb2.FW_MODE_DAMP,
}


class DriveFailed(RuntimeError):
    """The robot did not follow, has a fault, or is gone; one line that says which."""


class Pace(Protocol):
    """How time passes for a driver."""

    def now(self) -> float:
        """s."""
        ...

    def pause(self, seconds: float) -> None:
        """Let time pass."""
        ...


class RealTime:
    """The wall clock."""

    def now(self) -> float:
        return time.monotonic()

    def pause(self, seconds: float) -> None:
        time.sleep(seconds)


class Lockstep:
    """The simulated time of a robot in this process, which moves only here."""

    def __init__(self, robot: SimulatedRobot) -> None:
        self._robot = robot

    def now(self) -> float:
        return self._robot.clock.now_us() / 1e6

    def pause(self, seconds: float) -> None:
        step = self._robot.physics.timestep
        self._robot.advance(max(1, round(seconds / step)) * step)


class ScriptedDrive:
    """Runs the steps of a script.

    Args:
        session: to the robot.
        pace: how time passes.
        show: takes the telemetry line, several times a second.
        say: takes a line for each step.
        stopped: asked between two looks; the drive ends early when it says so.
    """

    def __init__(
        self,
        session: Session,
        pace: Pace,
        show: Callable[[str], None] = lambda line: None,
        say: Callable[[str], None] = lambda line: None,
        stopped: Callable[[], bool] = lambda: False,
    ) -> None:
        self._session = session
        self._pace = pace
        self._show = show
        self._say = say
        self._stopped = stopped
        self._expected: cloud_pb2.FirmwareMode.ValueType | None = None

    def run(self, steps: Sequence[Step]) -> None:
        """Go through all steps.

        Raises:
            DriveFailed: a fault, a lost link, or a command without its effect.
        """
        began = self._pace.now()
        for step in steps:
            if self._stopped():
                return
            self._say(f"{self._pace.now() - began:8.1f} s  {step}")
            self._send_until_followed(step)
            self._wait(step)
        final = self._session.state.get()
        self._say(f"{self._pace.now() - began:8.1f} s  done: {telemetry_line(final)}")
        if final.error_flags:
            raise DriveFailed(_fault(final))

    def _send_until_followed(self, step: Step) -> None:
        if step.verb is Verb.WAIT:
            return
        wanted = _MODES[step.verb]
        began = sent = self._pace.now()
        sequence = self._send(step)
        while not self._stopped():
            self._pace.pause(SLICE)
            now = self._pace.now()
            sample = self._look(damped=step.verb is Verb.DAMP)
            # An older sample tells of the mode before.
            newer = sample.applied_cmd.seq == sequence or now - began >= STALE
            if newer and sample.fw_mode == wanted:
                break
            if now - began > PATIENCE:
                raise DriveFailed(self._why_not(step))
            if now - sent >= SEND_AGAIN:
                sequence, sent = self._send(step), now
        self._expected = wanted

    def _send(self, step: Step) -> int:
        """The command's sequence number."""
        try:
            match step.verb:
                case Verb.STAND:
                    return self._session.stand()
                case Verb.DAMP:
                    return self._session.damp()
                case _:
                    return self._session.velocity(*step.velocity)
        except ConnectionError as error:
            raise DriveFailed(f"link lost: {error}") from None

    def _wait(self, step: Step) -> None:
        end = self._pace.now() + step.seconds
        while (left := end - self._pace.now()) > 1e-9 and not self._stopped():
            self._pace.pause(min(SLICE, left))
            sample = self._look(damped=self._expected == cloud_pb2.FW_MODE_DAMP)
            if self._expected is not None and sample.fw_mode != self._expected:
                left_mode = cloud_pb2.FirmwareMode.Name(self._expected).removeprefix("FW_MODE_")
                raise DriveFailed(
                    f"the robot left {left_mode} during {step}: it is in {mode_name(sample)}; did somebody else act?"
                )

    def _look(self, damped: bool) -> cloud_pb2.EdgeTelemetry:
        """The latest sample. A fault is no reason not to damp, so it is let pass where that is asked for."""
        if self._session.state.lost is not None:
            raise DriveFailed(f"link lost: {self._session.state.lost}")
        if self._session.state.age > LOST:
            raise DriveFailed(f"link lost: no telemetry for {LOST:g} s")
        sample = self._session.state.get()
        self._show(telemetry_line(sample))
        if sample.error_flags and not damped:
            raise DriveFailed(_fault(sample))
        return sample

    def _why_not(self, step: Step) -> str:
        mode = mode_name(self._session.state.get())
        if step.verb in (Verb.VELOCITY, Verb.STOP) and mode == "DAMP":
            return f"{step} has no effect in DAMP; let the robot stand first"
        return (
            f"{step} had no effect within {PATIENCE:g} s, the robot is in {mode}; another client may be in control, "
            "its emergency stop may be pressed, or it has no policy to walk with"
        )


def _fault(sample: cloud_pb2.EdgeTelemetry) -> str:
    names = ", ".join(fault_names(sample.error_flags)) or "latched"
    return f"the robot has a fault: {names} (error_flags 0x{sample.error_flags:x}); only a restart clears it"
