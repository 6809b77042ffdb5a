"""A simulated robot with everything around it: console, recording, UDP lane, facts endpoint, room, camera and sound.

What `asimov robot` runs and what tests can run without a terminal.
"""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from asimov_gym.edge import Dialect, SimulatedRobot
from asimov_gym.edge.console import Console
from asimov_gym.edge.lifecycle import Lifecycle
from asimov_gym.edge.status import robot_status
from asimov_gym.edge.transports import TransportError
from asimov_gym.edge.transports.facts_server import FACTS_PORT, FactsServer
from asimov_gym.edge.transports.udp import CONTROL_PORT, STATE_PORT, UdpLane
from asimov_gym.recording import Recorder

if TYPE_CHECKING:
    from asimov_gym.cli.motion_mode_lanes import MotionModeLanes, MotionModeOptions
    from asimov_gym.edge.transports.joint_control import JointControlLane
    from asimov_gym.edge.transports.livekit import LiveKitLane, Media


@dataclass(frozen=True)
class UdpOptions:
    """Where the UDP lane and its facts endpoint are. Port 0 stands for any free one."""

    control_port: int = CONTROL_PORT
    state_host: str = "127.0.0.1"
    state_port: int = STATE_PORT
    facts_port: int = FACTS_PORT
    listen: str = "127.0.0.1"
    """Address that takes commands and answers for facts."""


@dataclass(frozen=True)
class RoomOptions:
    """Which LiveKit room to join, and what to show and hear there."""

    url: str
    token: str = field(repr=False)
    dialects: tuple[Dialect, ...] = (Dialect.CLOUD,)
    cameras: tuple[str, ...] = ()
    """Of the model; none by default, they cost a core or two."""
    microphone: str | None = None
    """`silence`, `tone`, `tone:HZ` or a WAV file."""
    speaker: Path | None = None
    """WAV file that gets what clients say."""


@dataclass(frozen=True)
class JointControlOptions:
    """Where joint control is served."""

    port: int
    """TCP; 0 stands for any free one."""
    listen: str = "127.0.0.1"


class RobotService(Lifecycle):
    """Runs one robot between `start` and `stop`, or as a context manager.

    Args:
        robot: with a `WallClock` it runs in its own thread; in lockstep the caller advances it.
        console: path of the console's socket; None for no console.
        udp: None for no UDP lane and no facts endpoint.
        room: None for no room.
        recording: MCAP file to record into.
        motion_modes: None for no such lane.
        joint_control: None for no such lane.
    """

    def __init__(
        self,
        robot: SimulatedRobot,
        console: Path | None = None,
        udp: UdpOptions | None = None,
        room: RoomOptions | None = None,
        recording: Path | None = None,
        motion_modes: MotionModeOptions | None = None,
        joint_control: JointControlOptions | None = None,
    ) -> None:
        self.robot = robot
        self.udp: UdpLane | None = None
        self.facts: FactsServer | None = None
        self.room: LiveKitLane | None = None
        self.recorder: Recorder | None = None
        self.console: Console | None = None
        self.motion_modes: MotionModeLanes | None = None
        self.joint_control: JointControlLane | None = None
        self._console_path = console
        self._udp_options = udp
        self._room_options = room
        self._recording = recording
        self._motion_mode_options = motion_modes
        self._joint_control_options = joint_control
        self._open = ExitStack()

    # -- life --------------------------------------------------------------------------------------

    def start(self) -> None:
        """Open everything, then let the robot run.

        Raises:
            TransportError: something cannot be opened; one line that says what and what to do. Nothing stays open then.
        """
        with ExitStack() as stack:
            self._start(stack)
            self._open = stack.pop_all()

    def _start(self, stack: ExitStack) -> None:
        edge = self.robot.edge
        if self._console_path is not None:  # first: it claims the robot's name
            self.console = stack.enter_context(Console(self.robot, self._console_path, self._parts))
        if self._recording is not None:
            self.recorder = stack.enter_context(_recorder(self._recording, self.robot))
        if self._udp_options is not None:
            o = self._udp_options
            self.facts = stack.enter_context(FactsServer(o.facts_port, o.listen))
            self.udp = UdpLane(edge, o.control_port, o.state_host, o.state_port, o.listen)
            stack.enter_context(self.udp)
        if self._room_options is not None:
            from asimov_gym.edge.transports.livekit import LiveKitLane  # needs an optional package

            o = self._room_options
            self.room = LiveKitLane(edge, o.url, o.token, o.dialects, self._media(stack, o))
            stack.enter_context(self.room)
        if self._motion_mode_options is not None:
            from asimov_gym.cli.motion_mode_lanes import MotionModeLanes

            self.motion_modes = MotionModeLanes(edge, self._motion_mode_options, stack)
        if self._joint_control_options is not None:
            from asimov_gym.edge.transports.joint_control import JointControlLane

            options = self._joint_control_options
            self.joint_control = stack.enter_context(JointControlLane(edge, options.port, options.listen))
        stack.enter_context(self.robot)  # last to run, first to stop: everybody sees its first and its last event

    def _media(self, stack: ExitStack, options: RoomOptions) -> Media | None:
        if not (options.cameras or options.microphone or options.speaker):
            return None
        from asimov_gym.edge.media import CameraConfig, Microphone, SpeakerFile, VideoSource, sound
        from asimov_gym.edge.transports.livekit import Media

        video = microphone = speaker = None
        try:
            if options.cameras:
                video = stack.enter_context(VideoSource(self.robot, CameraConfig(options.cameras)))
            if options.microphone is not None:
                microphone = stack.enter_context(Microphone(sound(options.microphone), self.robot.clock))
            if options.speaker is not None:
                speaker = stack.enter_context(SpeakerFile(options.speaker))
        except OSError as problem:
            raise TransportError(f"--speaker {options.speaker}: {problem.strerror}") from None
        except (RuntimeError, ValueError) as problem:
            raise TransportError(str(problem)) from None
        return Media(video, microphone, speaker)

    def stop(self) -> None:
        """Stop the robot, close everything and finish the recording. No effect if nothing is open.

        Raises:
            RuntimeError: the robot had died of an error, which is the cause; everything is closed all the same.
        """
        stack, self._open = self._open, ExitStack()
        stack.close()

    # -- what it says of itself ----------------------------------------------------------------------

    def status(self) -> dict[str, Any]:
        """`robot_status` with `recording` and `udp` (null where there is none)."""
        with self.robot.edge.lock:
            return {**robot_status(self.robot), **self._parts()}

    def _parts(self) -> dict[str, Any]:
        recorder, udp = self.recorder, self.udp
        return {
            "recording": None
            if recorder is None
            else {"file": str(recorder.path), "messages": recorder.written.total(), "failure": recorder.failure},
            "udp": None if udp is None else {"control_port": udp.control_port, "state": dict(vars(udp.states))},
        }

    def connect_lines(self) -> list[tuple[str, str]]:
        """How to reach the robot: for each kind of client its name and what to type."""
        lines = []
        if self.udp is not None and self.facts is not None:
            lines += _udp_lines(self.udp, self.facts)
        if self.room is not None and self._room_options is not None:
            lines.append(("room", self.room.connect_line))
            lines.append(("", f"asimov drive --livekit {self._room_options.url}, with the token in LIVEKIT_TOKEN"))
        if self.joint_control is not None:
            from asimov_gym.edge.transports.joint_control import LICENCE_LINE

            lines += [("joints", self.joint_control.connect_line), ("", LICENCE_LINE)]
        if self.motion_modes is not None:
            lines += self.motion_modes.connect_lines()
        if self.console is not None:
            lines.append(("faults", self.console.connect_line))
        if self.recorder is not None:
            lines.append(("recording", str(self.recorder.path)))
        return lines


def _recorder(path: Path, robot: SimulatedRobot) -> Recorder:
    try:
        return Recorder(path, robot.edge)
    except FileExistsError:
        raise TransportError(f"--record {path}: there is such a file; nothing recorded is overwritten") from None
    except OSError as problem:
        raise TransportError(f"--record {path}: {problem.strerror}") from None


def _udp_lines(udp: UdpLane, facts: FactsServer) -> list[tuple[str, str]]:
    """Lines with those ports that differ from what clients take by themselves."""
    host = "127.0.0.1" if udp.listen in ("0.0.0.0", "::", "localhost") else udp.listen
    standard_ports = (CONTROL_PORT, STATE_PORT, FACTS_PORT)
    ports = (udp.control_port, udp.state_port, facts.port)
    target = f"udp://{host}" if ports[0] == CONTROL_PORT else f"udp://{host}:{ports[0]}"
    options = "" if ports[1] == STATE_PORT else f", state_port={ports[1]}"
    options += "" if ports[2] == FACTS_PORT else f", facts_port={ports[2]}"
    flags = "" if target == "udp://127.0.0.1" else f" --target {target}"
    flags += "" if ports[1] == STATE_PORT else f" --state-port {ports[1]}"
    flags += "" if ports[2] == FACTS_PORT else f" --facts-port {ports[2]}"
    sdk = f'"{host}"'
    if ports != standard_ports:
        sdk += f', command_port={ports[0]}, state_bind=("{udp.state_host}", {ports[1]}), version_port={ports[2]}'
    return [
        ("UDP", f"{udp.connect_line}; facts {facts.connect_line}"),
        ("keyboard", f"asimov drive{flags}"),
        ("script", f'asimov drive{flags} "stand for 3; velocity 0.4 0 0 for 5; stop for 1; damp"'),
        ("Python", f'asimov_gym.edge.connect("{target}"{options})'),
        ("menlo-sdk", f'Robot(ConnectionConfig(udp=UdpConfig({sdk}))).connect("udp")'),
    ]
