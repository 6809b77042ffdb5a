"""`asimov robot`: the simulated robot as a program of its own, for clients on this machine and elsewhere."""

from __future__ import annotations

import logging
import math
import os
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from asimov_gym.cli.console_client import DEFAULT_NAME, console_path

if TYPE_CHECKING:
    from asimov_gym.cli.drive_script import Step
    from asimov_gym.cli.robot_log import RobotLog
    from asimov_gym.cli.robot_service import RobotService, RoomOptions, UdpOptions
    from asimov_gym.cli.robot_window import RobotWindow
    from asimov_gym.cli.scripted_drive import Pace
    from asimov_gym.cli.status_line import StatusLine
    from asimov_gym.cli.stop_signals import StopSignals
    from asimov_gym.edge import SimulatedRobot

SLICE = 0.05
"""Between two looks at the robot, s."""
REFRESH = 0.2
"""Between two pictures of the status line, s of real time."""
CAMERAS = {"first": ("first_person",), "third": ("third_person",), "both": ("first_person", "third_person")}


@dataclass(frozen=True)
class Robot:
    """Run the simulated robot until Ctrl-C: real time, UDP lane and facts endpoint on loopback.

    Everything stays on this machine unless --listen, --udp-state-host or --livekit say otherwise. `asimov drive` moves
    the robot, `asimov fault` breaks and restarts it.

    Exit code 0 when it ran and ended in order, 1 when it died, its script failed or its recording did, 2 when it could
    not be started.
    """

    policy: Path | None = None
    """ONNX policy to walk with, or the folder of a training run; the shipped one by default."""
    name: str = DEFAULT_NAME
    """Name for `asimov fault --name`, where several robots run on one machine."""
    gantry: Literal["auto", "hold", "off"] = "auto"
    """Rope from above: auto hangs the robot in DAMP and lets go as it stands, hold keeps it taut, off removes it."""
    seed: int = 0
    """Seed of the simulated sensors' noise."""
    ankle: Literal["linear", "exact"] = "linear"
    """Mechanics of the ankle linkage: as the robot's firmware computes it, or exact."""
    can_ages: bool = False
    """Let each joint reading be as old as its motor's slot on the CAN bus makes it."""

    udp: bool = True
    """UDP lane and facts endpoint."""
    udp_control_port: int = 8850
    """UDP port that takes commands; 0 for any free one."""
    udp_state_host: str = "127.0.0.1"
    """Where the state goes, 200 times a second."""
    udp_state_port: int = 8851
    """UDP port that the state goes to."""
    facts_port: int = 3000
    """TCP port that tells the robot's model and version; 0 for any free one."""
    listen: str = "127.0.0.1"
    """Address for commands and facts. Nothing on UDP, ROS 2 or rosbridge is authenticated: on any other than a loopback
    address, whoever reaches it can drive the robot."""

    livekit: str | None = None
    """Join a LiveKit room: ws://HOST:PORT or wss://HOST. Or set LIVEKIT_URL and LIVEKIT_TOKEN."""
    token: str | None = field(default=None, repr=False)
    """Token for the room. Better put it in the environment as LIVEKIT_TOKEN: other users see the command line."""
    dialect: Literal["cloud", "io", "both"] = "cloud"
    """What is spoken in the room; UDP is always io."""
    camera: Literal["first", "third", "both"] | None = None
    """Show the robot's cameras in the room. Drawing and coding them takes a core or two."""
    microphone: str | None = None
    """What the robot hears, into the room: silence, tone, tone:HZ or a WAV file."""
    speaker: Path | None = None
    """WAV file that gets what clients of the room say."""

    joint_control: int | None = None
    """Serve joint control over gRPC on this TCP port, too; 0 for any free one. Needs bosdyn-api, whose licence allows
    it with a simulator and forbids it with hardware of other makers. Not authenticated either."""
    motion_modes: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """Serve AimDK motion modes, too: ros2, in the domain ROS_DOMAIN_ID, or rosbridge:PORT. Give it once for each."""

    record: Path | None = None
    """Record commands, telemetry, events and log into this MCAP file."""
    view: bool = False
    """Show the robot in a window; closing it ends the run."""
    lockstep: bool = False
    """Simulated time as fast as the machine can, the same in every run, instead of real time. There are no lanes then:
    --script drives the robot."""
    script: str | None = None
    """Drive the robot through these steps, as `asimov drive` would, and end."""
    seconds: float | None = None
    """End after this many seconds of the robot's time."""
    verbose: bool = False
    """Print more of the log."""

    def run(self) -> int:
        """Start, run, stop."""
        from asimov_gym.cli.stop_signals import StopSignals
        from asimov_gym.edge.transports import TransportError

        try:
            steps = self._steps()
            with StopSignals() as signals:
                return self._run(self._service(), steps, signals)
        except (FileNotFoundError, ImportError, TransportError, ValueError, _NoWindow) as error:
            print(f"asimov robot: {' '.join(str(error).split())}", file=sys.stderr)
            return 2

    # -- what was asked for ------------------------------------------------------------------------

    def _steps(self) -> tuple[Step, ...] | None:
        """The script, after a look at everything that can be refused without loading the robot."""
        from asimov_gym.cli.drive_script import parse_script
        from asimov_gym.cli.view import no_window_reason

        if self.seconds is not None and not (math.isfinite(self.seconds) and self.seconds > 0.0):
            raise ValueError(f"--seconds must be a finite number above 0, got {self.seconds:g}")
        if self.seed < 0:
            raise ValueError(f"--seed must be 0 or more, got {self.seed}")
        if self.lockstep and self.livekit is not None:
            raise ValueError("--lockstep has a time of its own and serves no room; leave --livekit out")
        if self.lockstep and self.joint_control is not None:
            raise ValueError("--lockstep has a time of its own and serves no lanes; leave --joint-control out")
        if self.lockstep and self.motion_modes:
            raise ValueError("--lockstep has a time of its own and serves no lanes; leave --motion-modes out")
        if (self.camera or self.microphone or self.speaker) and self._room() is None:
            raise ValueError("--camera, --microphone and --speaker belong to a room; name it with --livekit")
        if self.view and (reason := no_window_reason()):
            raise _NoWindow(f"--view: {reason.partition(';')[0]}")
        return None if self.script is None else parse_script(self.script)

    def _room(self) -> RoomOptions | None:
        from asimov_gym.cli.robot_service import RoomOptions
        from asimov_gym.edge import Dialect

        if self.lockstep:
            return None
        token = self.token or os.environ.get("LIVEKIT_TOKEN", "")
        url = self.livekit or (os.environ.get("LIVEKIT_URL", "") if token else "")
        if not url:
            if self.token is not None:
                raise ValueError("--token belongs to a room; name it with --livekit")
            return None
        if not token:
            raise ValueError("--livekit needs a token: set LIVEKIT_TOKEN, or give --token")
        dialects = tuple(Dialect) if self.dialect == "both" else (Dialect(self.dialect),)
        cameras = () if self.camera is None else CAMERAS[self.camera]
        return RoomOptions(url, token, dialects, cameras, self.microphone, self.speaker)

    def _udp(self) -> UdpOptions | None:
        from asimov_gym.cli.robot_service import UdpOptions

        if self.lockstep or not self.udp:
            return None
        return UdpOptions(self.udp_control_port, self.udp_state_host, self.udp_state_port, self.facts_port, self.listen)

    def _service(self) -> RobotService:
        from asimov_gym.cli.motion_mode_lanes import parse_motion_modes
        from asimov_gym.cli.robot_service import JointControlOptions, RobotService

        console, udp, room = console_path(self.name), self._udp(), self._room()
        motion_modes = parse_motion_modes(self.motion_modes, self.listen)
        joints = None if self.joint_control is None else JointControlOptions(self.joint_control, self.listen)
        return RobotService(self._robot(), console, udp, room, self.record, motion_modes, joints)

    def _robot(self) -> SimulatedRobot:
        from asimov_gym.assets import asset_path
        from asimov_gym.cli.view import policy_file
        from asimov_gym.edge import SimulatedRobot
        from asimov_gym.firmware import FirmwareConfig, StepClock, WallClock

        policy = asset_path("policies", "asimov_walk.onnx") if self.policy is None else policy_file(self.policy)
        config = FirmwareConfig(ankle=self.ankle, aged_readings=self.can_ages)
        clock = StepClock() if self.lockstep else WallClock()
        return SimulatedRobot(policy, clock, self.gantry, self.seed, config)

    # -- running ---------------------------------------------------------------------------------------

    def _run(self, service: RobotService, steps: tuple[Step, ...] | None, signals: StopSignals) -> int:
        from asimov_gym.cli.robot_log import RobotLog
        from asimov_gym.cli.status_line import StatusLine

        log = RobotLog(service.robot.clock.realtime_us(), logging.INFO if self.verbose else logging.WARNING)
        logger = logging.getLogger("asimov_gym")
        level = logger.level
        logger.setLevel(logging.INFO)  # for the recording; the terminal gets what RobotLog lets through
        logger.addHandler(log)
        service.robot.edge.attach(log)
        line = StatusLine()
        code = 0
        try:
            with ExitStack() as stack:
                stack.enter_context(line)
                stack.enter_context(service)
                window = stack.enter_context(_window(service.robot)) if self.view else None
                self._greet(service, line)
                code = self._live(service, steps, signals, line, log, window)
        except RuntimeError as death:
            if death.__cause__ is None:  # a refusal to start, such as a TransportError
                raise
            traceback.print_exception(death.__cause__)
            print(f"asimov robot: {death}", file=sys.stderr)
            code = 1
        finally:
            logger.removeHandler(log)
            logger.setLevel(level)
            for left in log.drain():
                line.say(left)
        return self._summary(service, code)

    def _greet(self, service: RobotService, line: StatusLine) -> None:
        policy = "the shipped policy" if self.policy is None else str(self.policy)
        pace = "lockstep" if self.lockstep else "real time"
        line.say(f"Simulated Asimov 1 {self.name!r}: {policy}, gantry {self.gantry}, {pace}. Ctrl-C ends it.")
        for kind, how in service.connect_lines():
            line.say(f"  {kind:<10} {how}")
        if self.token is not None:
            line.say(
                "warning: other users of this machine see --token in the list of processes; set LIVEKIT_TOKEN instead"
            )

    def _live(
        self,
        service: RobotService,
        steps: tuple[Step, ...] | None,
        signals: StopSignals,
        line: StatusLine,
        log: RobotLog,
        window: RobotWindow | None,
    ) -> int:
        """Until somebody or something ends it: 1 when the script failed, else 0."""
        from asimov_gym.cli.scripted_drive import DriveFailed, Lockstep, RealTime, ScriptedDrive
        from asimov_gym.edge import connect

        robot = service.robot
        pace: Pace = Lockstep(robot) if self.lockstep else RealTime()
        end = math.inf if self.seconds is None else pace.now() + self.seconds
        look = _Look(service, line, log, window)

        def stopped() -> bool:
            died = not self.lockstep and not robot.running
            return signals.stopped or died or (window is not None and window.closed) or end - pace.now() < 1e-9

        if steps is None:
            while not stopped():
                pace.pause(min(SLICE, max(0.0, end - pace.now())))
                look()
            return 0
        try:
            with connect(robot, "script") as session:
                ScriptedDrive(session, pace, lambda _: look(), line.say, stopped).run(steps)
        except DriveFailed as error:
            line.say(f"script failed: {error}")
            return 1
        return 0

    def _summary(self, service: RobotService, code: int) -> int:
        status = service.status()
        print(summary(status))
        recording = status["recording"]
        if recording is None:
            return code
        print(f"recording {recording['file']}: {recording['messages']} messages")
        if recording["failure"]:
            print(f"asimov robot: the recording is incomplete: {recording['failure']}", file=sys.stderr)
            return 1
        return code


class _NoWindow(Exception):
    """--view where no window can be opened."""


@contextmanager
def _window(robot: SimulatedRobot) -> Iterator[RobotWindow]:
    from asimov_gym.cli.robot_window import RobotWindow  # loads the window system

    window = RobotWindow(robot)
    try:
        window.__enter__()
    except RuntimeError as refusal:
        raise _NoWindow(f"--view: {refusal}") from None
    try:
        yield window
    finally:
        window.__exit__(None, None, None)


class _Look:
    """Brings terminal and window up to date, as often as makes sense."""

    def __init__(self, service: RobotService, line: StatusLine, log: RobotLog, window: RobotWindow | None) -> None:
        self._service = service
        self._line = line
        self._log = log
        self._draw: Callable[[], None] = (lambda: None) if window is None else window.draw
        self._shown = -math.inf

    def __call__(self) -> None:
        for news in self._log.drain():
            self._line.say(news)
        now = time.monotonic()
        if self._line.in_place and now - self._shown >= REFRESH:
            self._shown = now
            self._line.show(status_text(self._service.status()))
        self._draw()


def status_text(status: dict[str, Any]) -> str:
    """The status of `RobotService.status` on one line."""
    words = [f"{status['state']:<15}"]
    if status["realtime_factor"] is not None:
        late = status["lateness_ms"]["p99"]
        words.append(f"{status['realtime_factor']:.2f} × real time, p99 {late:.1f} ms late")
    else:
        words.append(f"{status['running_s']:.1f} s simulated")
    words.append(f"control: {status['controller'] or 'nobody'}")
    taken, dropped = (sum(status["commands"][kind].values()) for kind in ("taken", "dropped"))
    words.append(f"commands {taken} taken {dropped} dropped")
    if status["e_stop"]:
        words.append("E-STOP")
    if status["latched"]:
        words.append(f"FAULT 0x{status['error_flags']:x}")
    alerts = [alert.split()[0] for alert in status["alerts"]]
    words.append(", ".join(alerts) if alerts else "no alerts")
    return "  ".join(words)


def summary(status: dict[str, Any]) -> str:
    """What a run came to, in a sentence."""
    commands = status["commands"]
    dropped = ", ".join(f"{count} {reason}" for reason, count in sorted(commands["dropped"].items()))
    text = f"ended in {status['state']} after {status['running_s']:.1f} s: "
    text += f"{sum(commands['taken'].values())} commands taken, {sum(commands['dropped'].values())} dropped"
    return f"{text} ({dropped})" if dropped else text
