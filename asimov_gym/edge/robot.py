"""The simulated robot: physics, firmware and edge on one clock."""

from __future__ import annotations

import logging
import threading
from collections import deque
from dataclasses import replace
from pathlib import Path
from types import TracebackType

from asimov_gym.edge.edge import Edge
from asimov_gym.edge.events import Code, error
from asimov_gym.firmware import MICROSECONDS, Clock, Firmware, FirmwareConfig, GantryMode, StepClock
from asimov_gym.physics import CPhysics
from asimov_gym.policy import Policy, load_policy

_log = logging.getLogger(__name__)


class SimulatedRobot:
    """A robot to connect to.

    With a `StepClock` (the default) it runs in lockstep: time stands still until `advance`. With a `WallClock` it runs
    by itself in a thread between `start` and `stop`, or inside `with robot:`.

    Args:
        policy: ONNX file or loaded network for MOVE/POLICY. Without one, velocities are dropped.
        clock: `StepClock()` or `WallClock()`.
        gantry: `auto`, `hold` or `off`; overrides the configuration's.
        seed: of the simulated sensors' noise. Same seed, same commands at the same times: same telemetry.
        config: times, thresholds, gantry and motor figures.
        physics: one robot under other physics, such as another model revision.

    Raises:
        FileNotFoundError, ValueError: the policy is not there, or the robot cannot honour it.
    """

    BACKLOG_US = MICROSECONDS // 10
    """In real time, how far behind the loop may fall and still catch up; beyond it the time is lost."""
    OVERLOAD_FACTOR = 0.95
    """Slower than this many times real time over a second is reported as overload."""
    LATENESS_SAMPLES = 60_000
    """Steps of the loop of which the lateness is kept: five minutes, one while joint control is open."""

    def __init__(
        self,
        policy: str | Path | Policy | None = None,
        clock: Clock | None = None,
        gantry: GantryMode | None = None,
        seed: int = 0,
        config: FirmwareConfig | None = None,
        physics: CPhysics | None = None,
    ) -> None:
        config = config or FirmwareConfig()
        if gantry is not None:
            config = replace(config, gantry=replace(config.gantry, mode=gantry))
        runner = load_policy(policy) if isinstance(policy, str | Path) else policy
        self.clock = clock or StepClock()
        self.physics = physics or CPhysics(1, "evaluation")
        self.firmware = Firmware(self.physics, self.clock, runner, config, seed)
        self.edge = Edge(self.firmware, self.clock)
        self.realtime_factor = 1.0
        """Simulated over real time in the last second; only with a `WallClock`."""
        self.lateness_us: deque[int] = deque(maxlen=self.LATENESS_SAMPLES)
        """How late each of the last steps of the loop began, microseconds; only with a `WallClock`."""
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self._failure: BaseException | None = None

    # -- lockstep ----------------------------------------------------------------------------------

    def advance(self, seconds: float) -> None:
        """Run the robot for a time that is a multiple of its 5 ms control step, whatever the physics step is.

        Raises:
            RuntimeError: the robot runs in real time.
            ValueError: the time is negative or no multiple of the control step.
        """
        if not isinstance(self.clock, StepClock):
            raise RuntimeError("this robot runs in real time: use start() and stop(), or build it with a StepClock")
        period = self.firmware.period_us / MICROSECONDS
        steps = seconds / period
        if steps < 0 or abs(steps - round(steps)) > 1e-6:
            raise ValueError(f"seconds must be a multiple >= 0 of the control step, {period} s; got {seconds}")
        for _ in range(round(steps)):
            self._step()
            while not self.firmware.between_steps:
                self._step()

    # -- real time ---------------------------------------------------------------------------------

    def start(self) -> None:
        """Run in real time, in a thread, until `stop`.

        Raises:
            RuntimeError: the robot is in lockstep, or already runs.
        """
        if isinstance(self.clock, StepClock):
            raise RuntimeError("this robot is in lockstep: use advance(), or build it with a WallClock")
        if self._thread is not None:
            raise RuntimeError("the robot already runs")
        self._stop.clear()
        self.firmware.resume()
        self._thread = threading.Thread(target=self._run, name="simulated-robot", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Stop running. No effect if it does not run.

        Raises:
            RuntimeError: the loop had died of an error, which is the cause.
        """
        if self._thread is None:
            return
        self._stop.set()
        self._thread.join()
        self._thread = None
        self.edge.emit(error(Code.SHUTDOWN, "the simulated robot stops"))
        if self._failure is not None:
            failure, self._failure = self._failure, None
            raise RuntimeError("the simulated robot died") from failure

    @property
    def running(self) -> bool:
        """Whether the real-time loop is alive."""
        return self._thread is not None and self._thread.is_alive()

    def __enter__(self) -> SimulatedRobot:
        if not isinstance(self.clock, StepClock):
            self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    # -- what a bench operator can do --------------------------------------------------------------

    def restart(self) -> None:
        """Restart the firmware: clears a latched fault. The robot stays where it is; the gantry hoists it in DAMP."""
        with self.edge.lock:
            self.edge.error(Code.CONSOLE, "restart of the firmware")
            self.firmware.restart()

    # -- the loop ----------------------------------------------------------------------------------

    def _step(self) -> int:
        """One step of the loop: a control step, or a fifth of one while joint control is open. Its length in
        microseconds."""
        firmware, edge = self.firmware, self.edge
        with edge.lock:
            if firmware.between_steps:
                firmware.fast = edge.wants_samples
            length = firmware.step_us
            if isinstance(self.clock, StepClock):
                self.clock.advance(length)
            state = firmware.tick()
            if length < firmware.period_us:
                edge.sample()
            if firmware.between_steps:
                edge.tick(state)
        return length

    def _run(self) -> None:
        due = window_start = self.clock.now_us()
        simulated = 0
        try:
            while not self._stop.is_set():
                self.lateness_us.append(max(0, self.clock.now_us() - due))
                length = self._step()
                simulated += length
                due += length
                now = self.clock.now_us()
                if now < due:
                    self._stop.wait((due - now) / MICROSECONDS)
                elif now - due > self.BACKLOG_US:
                    due = now
                if now - window_start >= MICROSECONDS:
                    self.realtime_factor = simulated / (now - window_start)
                    if self.realtime_factor < self.OVERLOAD_FACTOR:
                        self.edge.overload(self.realtime_factor)
                    window_start, simulated = now, 0
        except BaseException as failure:  # the thread's owner hears of it in stop()
            _log.exception("the simulated robot died")
            self._failure = failure
