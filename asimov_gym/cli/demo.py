"""`asimov demo`: the simulated robot walks the shipped policy on commands sent through its protobuf interface."""

from __future__ import annotations

import math
import time
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from asimov_gym.rendering.backends import headless_backend, install_line
from asimov_gym.robot.safety_limits import FALL_GRAVITY_Z, FALL_HEIGHT

if TYPE_CHECKING:
    from rich.console import Console

    from asimov_gym.cli.progress import Progress
    from asimov_gym.cli.tracking import Tracking
    from asimov_gym.cli.video import VideoWriter
    from asimov_gym.edge import Session, SimulatedRobot
    from asimov_gym.policy import PolicyRunner

PLOT, MOVIE, RECORDING = "velocity.png", "walk.mp4", "recording.mcap"
LINEAR_BOUND = 0.10
"""Largest mean error of (vx, vy) in the steady part of a phase, m/s."""
YAW_BOUND = 0.15
"""Largest mean error of the yaw rate in the steady part of a phase, rad/s."""
SETTLING = 2.0
"""Seconds after a new velocity command that are not judged."""
INTERVAL = 0.02
"""Seconds of simulated time between samples: one policy step."""
SAMPLES_PER_FRAME = 2
"""A frame of the video every other sample: 25 a second."""
LARGEST_TILT = math.degrees(math.acos(-FALL_GRAVITY_Z))
"""A tilt of more than this is a fall, degrees."""


@dataclass(frozen=True)
class Phase:
    """A stretch of the route during which one command holds."""

    name: str
    verb: str
    """`stand`, `damp` or `velocity`."""
    seconds: float
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """vx, vy (m/s) and yaw rate (rad/s) of a `velocity` phase."""


ROUTE = (
    Phase("DAMP", "damp", 1.0),
    Phase("STAND", "stand", 2.5),
    Phase("forward", "velocity", 5.0, (0.5, 0.0, 0.0)),
    Phase("turn", "velocity", 4.5, (0.0, 0.0, 0.5)),
    Phase("sideways", "velocity", 4.5, (0.0, 0.25, 0.0)),
    Phase("stop", "velocity", 3.0),
    Phase("STAND", "stand", 2.0),
    Phase("DAMP", "damp", 1.5),
)


@dataclass(frozen=True)
class PhaseResult:
    """How a phase went."""

    phase: Phase
    start: float
    """s."""
    stop: float
    """s."""
    linear_error: float | None = None
    """Mean error of (vx, vy), m/s; None for a phase without a velocity command."""
    yaw_error: float | None = None
    """Mean error of the yaw rate, rad/s; None for a phase without a velocity command."""

    @property
    def followed(self) -> bool:
        """Whether both errors are within their bounds."""
        if self.linear_error is None or self.yaw_error is None:
            return True
        return self.linear_error <= LINEAR_BOUND and self.yaw_error <= YAW_BOUND


@dataclass
class Walk:
    """What was seen while the robot walked the route."""

    tracking: Tracking
    phases: list[tuple[Phase, float, float]] = field(default_factory=list)
    """Each phase with its start and stop, s."""
    lowest: float = np.inf
    """Lowest pelvis outside DAMP, m."""
    largest_tilt: float = 0.0
    """Largest tilt outside DAMP, degrees."""
    rope_force: float = 0.0
    """Largest force of the gantry while the robot walked, N."""
    error_flags: int = 0
    """All fault bits seen in telemetry."""
    last_mode: int = -1
    """Firmware mode of the last telemetry frame."""

    def results(self) -> list[PhaseResult]:
        """Each phase with its tracking errors. Its start, and half a smoothing window before its end, do not count."""
        results = []
        for phase, start, stop in self.phases:
            if phase.verb == "velocity":
                linear, yaw = self.tracking.error(start + SETTLING, stop - self.tracking.window / 2)
                results.append(PhaseResult(phase, start, stop, linear, yaw))
            else:
                results.append(PhaseResult(phase, start, stop))
        return results

    def failures(self) -> list[str]:
        """What went wrong, in words; empty if the robot stayed up and followed."""
        from asimov_gym.edge.wire import cloud_pb2

        failures = []
        if self.lowest < FALL_HEIGHT or self.largest_tilt > LARGEST_TILT:
            failures.append(f"the robot fell: pelvis down to {self.lowest:.2f} m, tilt up to {self.largest_tilt:.0f}°")
        if self.error_flags:
            failures.append(f"the firmware reported a fault: error_flags 0x{self.error_flags:x}")
        if self.rope_force > 0.0:
            failures.append(f"the gantry carried up to {self.rope_force:.0f} N while the robot walked")
        if self.last_mode != cloud_pb2.FW_MODE_DAMP:
            failures.append(f"the robot did not end in DAMP but in mode {self.last_mode}")
        for result in self.results():
            if not result.followed:
                failures.append(
                    f"{result.phase.name}: error {result.linear_error:.3f} m/s, {result.yaw_error:.3f} rad/s; "
                    f"allowed: {LINEAR_BOUND} m/s, {YAW_BOUND} rad/s"
                )
        return failures


@dataclass(frozen=True)
class Demo:
    """Walk the shipped policy in the simulated robot and leave a plot, a video and a recording.

    DAMP, STAND, forward, turn, sideways, stop, STAND, DAMP, in lockstep and without a display. Exit code 0 only if the
    robot stayed up and followed: mean error in the steady part of each phase at most 0.10 m/s and 0.15 rad/s.
    """

    out: Path = Path("demo")
    """Folder for velocity.png, walk.mp4 and recording.mcap."""
    policy: Path | None = None
    """ONNX policy to walk with; the shipped one by default."""
    video: bool = True
    """Whether to make the video."""
    seed: int = 0
    """Seed of the simulated sensors' noise."""

    def run(self) -> int:
        """Walk the route, write the files, say how it went."""
        from rich.console import Console

        from asimov_gym.assets import asset_path
        from asimov_gym.cli import velocity_plot
        from asimov_gym.policy import load_policy

        console = Console()
        began = time.perf_counter()
        try:
            policy = load_policy(self.policy or asset_path("policies", "asimov_walk.onnx"))
        except (FileNotFoundError, ValueError) as error:
            console.print(f"No policy to walk with: {error}", markup=False)
            return 2
        self.out.mkdir(parents=True, exist_ok=True)
        for name in (PLOT, MOVIE, RECORDING):  # files of an earlier run must not pass for this one's
            (self.out / name).unlink(missing_ok=True)
        walk = self._walk(policy, console)
        plot = self.out / PLOT
        spans = [(start, stop, phase.name) for phase, start, stop in walk.phases]
        velocity_plot.save(plot, walk.tracking, spans, "Asimov 1 on velocity commands, simulated")
        console.print(f"plot       {plot}")
        _print_results(walk, console)
        failures = walk.failures()
        for failure in failures:
            console.print(f"[red]failed[/red]  {failure}")
        if not failures:
            console.print("[green]The robot stayed up and followed.[/green]")
        simulated = walk.tracking.time[-1]
        console.print(f"{simulated:.0f} s of walking, simulated and drawn in {time.perf_counter() - began:.0f} s.")
        return 1 if failures else 0

    def _walk(self, policy: PolicyRunner, console: Console) -> Walk:
        """Run the route in lockstep; the video is drawn beside it."""
        from asimov_gym.cli.progress import Progress
        from asimov_gym.cli.tracking import Tracking
        from asimov_gym.cli.video import VideoWriter
        from asimov_gym.edge import SimulatedRobot, connect
        from asimov_gym.recording import Recorder

        frequency = policy.contract.gait_frequency_hz
        # Without a clock the gait's period is not known: the evaluation's window then.
        walk = Walk(Tracking(INTERVAL, 1.0 / frequency if frequency else 0.7))
        backend = headless_backend() if self.video else None
        with ExitStack() as stack:
            video = None if backend is None else stack.enter_context(VideoWriter(self.out / MOVIE, backend))
            with (
                SimulatedRobot(policy, seed=self.seed) as robot,
                Recorder(self.out / RECORDING, robot.edge),
                connect(robot, "demo") as session,
                Progress(console, sum(phase.seconds for phase in ROUTE)) as progress,
            ):
                for phase in ROUTE:
                    _command(session, phase)
                    _advance(robot, session, phase, walk, video, progress)
            console.print(f"recording  {self.out / RECORDING}")
            if video is not None:
                with console.status("Drawing the video") as status:
                    sent = video.sent
                    video.finish(lambda done: status.update(f"Drawing the video: {done} of {sent} frames"))
        if video is not None and not video.error:
            console.print(f"video      {self.out / MOVIE} ({backend})")
        elif self.video:
            reason = install_line() if video is None else f"the drawing process failed: {video.error}"
            console.print(f"no video   {reason}", markup=False)
        return walk


def _command(session: Session, phase: Phase) -> None:
    """Send a phase's one command; the robot holds on to it."""
    if phase.verb == "stand":
        session.stand()
    elif phase.verb == "damp":
        session.damp()
    else:
        session.velocity(*phase.velocity)


def _advance(
    robot: SimulatedRobot, session: Session, phase: Phase, walk: Walk, video: VideoWriter | None, progress: Progress
) -> None:
    """Let a phase's time pass, and look at the robot every `INTERVAL`."""
    from asimov_gym.cli.tracking import true_velocity

    start = len(walk.tracking.commands)
    samples = round(phase.seconds / INTERVAL)
    for sample in range(start, start + samples):
        robot.advance(INTERVAL)
        reading = robot.physics.read()
        velocity = true_velocity(reading)
        height = float(reading.base_position[0, 2])
        walk.tracking.add(np.array(phase.velocity), velocity)
        telemetry = session.state.get()
        walk.error_flags |= telemetry.error_flags
        walk.last_mode = telemetry.fw_mode
        if phase.verb != "damp":
            walk.lowest = min(walk.lowest, height)
            tilt = float(np.degrees(np.arccos(np.clip(-reading.gravity[0, 2], -1.0, 1.0))))
            walk.largest_tilt = max(walk.largest_tilt, tilt)
        if phase.verb == "velocity":
            walk.rope_force = max(walk.rope_force, robot.firmware.snapshot.gantry_force)
        if video is not None and sample % SAMPLES_PER_FRAME == 0:
            video.write(robot.physics.state().qpos[0])
        progress.show(phase.name, phase.velocity, (sample + 1) * INTERVAL, velocity, height, telemetry)
    walk.phases.append((phase, start * INTERVAL, (start + samples) * INTERVAL))
    progress.close_phase(phase.name, (start + samples) * INTERVAL, height, telemetry)


def _print_results(walk: Walk, console: Console) -> None:
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    for column in ("phase", "asked (vx, vy, wz)", "error m/s", "error rad/s"):
        table.add_column(column, justify="left" if column == "phase" else "right")
    for result in walk.results():
        if result.linear_error is None or result.yaw_error is None:
            continue
        asked = ", ".join(f"{value:+.2f}" for value in result.phase.velocity)
        colour = "green" if result.followed else "red"
        table.add_row(
            result.phase.name,
            asked,
            f"[{colour}]{result.linear_error:.3f}[/{colour}]",
            f"[{colour}]{result.yaw_error:.3f}[/{colour}]",
        )
    console.print(table)
