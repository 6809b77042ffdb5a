"""`asimov bench robot`: punctuality of the simulated robot in real time, and its speed in lockstep on one core."""

from __future__ import annotations

import json
import math
import os
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from asimov_gym.edge import Session, SimulatedRobot
    from asimov_gym.policy import PolicyRunner

STANDING = 3.0
"""Seconds from STAND to the velocity command."""
WARM_UP = 1.0
"""Seconds of walking that are not measured."""
VELOCITY = (0.4, 0.0, 0.0)
"""What the robot is asked to walk while it is measured: m/s, m/s, rad/s."""
SHORTEST, LONGEST = 1.0, 3600.0
TARGET = 20.0
"""Speed that lockstep is meant to reach on one core, as a multiple of real time."""


@dataclass(frozen=True)
class RealTimeResult:
    """Control steps at 200 Hz against the wall clock."""

    seconds: float
    """Length of the measurement."""
    steps: int
    factor: float
    """Simulated over real time; below 1 the machine was too slow and time was lost."""
    p50_ms: float
    """Half of the steps began at most this much after they were due."""
    p99_ms: float
    max_ms: float
    late_share: float
    """Share of steps that began a whole step (5 ms) or more after they were due."""
    walking: bool
    """Whether the robot walked all the time, as it should."""


@dataclass(frozen=True)
class LockstepResult:
    """Control steps as fast as they go on one core."""

    seconds: float
    """Simulated time of the measurement."""
    speed: float
    """Multiple of real time."""
    step_us: float
    """Real time of a control step, microseconds."""
    cpu_us: float
    """Processor time of it; where it is much less, other programs had the core."""
    pinned: bool
    """Whether the process was held to one core; not every system can."""
    walking: bool
    """Whether the robot walked all the time, as it should."""


@dataclass(frozen=True)
class BenchRobot:
    """Measure the simulated robot with the policy walking: lateness of its 200 Hz loop in real time, and its speed in
    lockstep on one core.

    Exit code 0 when both were measured, 1 when the robot did not walk, 2 when it could not be tried.
    """

    seconds: float = 20.0
    """Length of each measurement: real seconds in real time, simulated seconds in lockstep."""
    policy: Path | None = None
    """ONNX policy; the shipped one by default."""
    udp: bool = False
    """Also serve the UDP lane, to a port of this process: state goes out 200 times a second."""
    record: bool = False
    """Also record, into a file that is thrown away."""
    json: Path | None = None
    """Write the figures to this file."""

    def run(self) -> int:
        """Measure, print a table."""
        from asimov_gym.assets import asset_path
        from asimov_gym.policy import load_policy

        if not SHORTEST <= self.seconds <= LONGEST:
            allowed = f"between {SHORTEST:g} and {LONGEST:g}"
            print(f"asimov bench robot: --seconds must be {allowed}, got {self.seconds:g}", file=sys.stderr)
            return 2
        try:
            policy = load_policy(self.policy or asset_path("policies", "asimov_walk.onnx"))
        except (FileNotFoundError, ValueError) as error:
            print(f"asimov bench robot: {error}", file=sys.stderr)
            return 2
        lockstep = self.lockstep(policy)
        real_time = self.real_time(policy)
        _print(real_time, lockstep, self.udp, self.record)
        if self.json is not None:
            figures = {"real_time": asdict(real_time), "lockstep": asdict(lockstep)}
            figures |= {"udp": self.udp, "record": self.record, "cores": os.cpu_count()}
            self.json.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")
        if not (real_time.walking and lockstep.walking):
            print("asimov bench robot: the robot did not walk all the time; the figures do not count", file=sys.stderr)
            return 1
        return 0

    def real_time(self, policy: PolicyRunner) -> RealTimeResult:
        """Walk against the wall clock for `seconds`."""
        import numpy as np

        from asimov_gym.edge import SimulatedRobot, connect
        from asimov_gym.firmware import WallClock

        robot = SimulatedRobot(policy, WallClock())
        with self._around(robot), robot, connect(robot, "bench") as session:
            session.stand()
            time.sleep(STANDING)
            session.velocity(*VELOCITY)
            time.sleep(WARM_UP)
            first, began = robot.firmware.ticks, time.perf_counter()
            robot.lateness_us.clear()
            time.sleep(self.seconds)
            late = np.array(robot.lateness_us) / 1000.0
            steps, took = robot.firmware.ticks - first, time.perf_counter() - began
            walking = _walks(robot)
        p50, p99 = np.percentile(late, (50, 99))
        return RealTimeResult(
            seconds=took,
            steps=steps,
            factor=steps * robot.physics.timestep / took,
            p50_ms=float(p50),
            p99_ms=float(p99),
            max_ms=float(late.max()),
            late_share=float(np.mean(late >= 1000.0 * robot.physics.timestep)),
            walking=walking,
        )

    def lockstep(self, policy: PolicyRunner) -> LockstepResult:
        """Walk for `seconds` of simulated time, on one core where the system allows it."""
        from asimov_gym.edge import SimulatedRobot, connect

        with _one_core() as pinned:
            robot = SimulatedRobot(policy)
            with self._around(robot), connect(robot, "bench") as session:
                _start_walking(robot, session)
                steps = math.ceil(self.seconds / robot.physics.timestep)
                began, cpu_began = time.perf_counter(), time.process_time()
                robot.advance(steps * robot.physics.timestep)
                took, cpu = time.perf_counter() - began, time.process_time() - cpu_began
                walking = _walks(robot)
        simulated = steps * robot.physics.timestep
        return LockstepResult(simulated, simulated / took, 1e6 * took / steps, 1e6 * cpu / steps, pinned, walking)

    @contextmanager
    def _around(self, robot: SimulatedRobot) -> Iterator[None]:
        """The lanes and the recorder that were asked for."""
        import socket

        from asimov_gym.edge.transports.udp import UdpLane
        from asimov_gym.recording import Recorder

        with ExitStack() as stack:
            if self.udp:
                sink = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
                sink.bind(("127.0.0.1", 0))  # never read: what does not fit its buffer is lost, as with a slow client
                stack.enter_context(UdpLane(robot.edge, 0, "127.0.0.1", sink.getsockname()[1]))
            if self.record:
                folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="asimov-bench-"))
                stack.enter_context(Recorder(Path(folder, "bench.mcap"), robot.edge))
            yield


def _start_walking(robot: SimulatedRobot, session: Session) -> None:
    session.stand()
    robot.advance(STANDING)
    session.velocity(*VELOCITY)
    robot.advance(WARM_UP)


def _walks(robot: SimulatedRobot) -> bool:
    from asimov_gym.firmware import State

    return robot.firmware.state is State.POLICY


@contextmanager
def _one_core() -> Iterator[bool]:
    """Hold this thread, and those it starts, to one core meanwhile; gives whether the system can."""
    if not hasattr(os, "sched_setaffinity"):
        yield False
        return
    allowed = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(allowed)})  # not the first core: interrupts gather there
    try:
        yield True
    finally:
        os.sched_setaffinity(0, allowed)


def _print(real_time: RealTimeResult, lockstep: LockstepResult, udp: bool, record: bool) -> None:
    from rich.console import Console
    from rich.table import Table

    extras = [name for name, on in (("UDP lane", udp), ("recorder", record)) if on]
    around = f" with {' and '.join(extras)}" if extras else ""
    table = Table(box=None, pad_edge=False, title=f"The simulated robot, walking{around}", title_justify="left")
    table.add_column("")
    table.add_column("", justify="right")
    table.add_column("")
    r, k = real_time, lockstep
    core = "one core" if k.pinned else "this system cannot hold a process to one core"
    goal = f"goal: {TARGET:g}" if k.speed < TARGET else f"goal of {TARGET:g} reached"
    table.add_row("lockstep", f"{k.speed:.1f} ×", f"real time, {core}; {goal}")
    table.add_row("", f"{k.step_us:.0f} µs", f"per control step, over {k.seconds:.0f} simulated seconds")
    table.add_row("", f"{k.cpu_us:.0f} µs", "of them processor time; the rest went to other programs")
    table.add_row("real time", f"{r.factor:.3f} ×", f"over {r.seconds:.0f} s, {r.steps} control steps at 200 Hz")
    table.add_row("", f"{r.p50_ms:.2f} ms", "lateness p50")
    table.add_row("", f"{r.p99_ms:.2f} ms", "lateness p99")
    table.add_row("", f"{r.max_ms:.2f} ms", "lateness, largest")
    table.add_row("", f"{100 * r.late_share:.2f} %", "of the steps a whole step (5 ms) late or more")
    Console().print(table, highlight=False)
