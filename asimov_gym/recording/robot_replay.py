"""Runs a recording again: its commands go into a fresh simulated robot, whose telemetry is compared with the recorded.

A lockstep recording that begins with the robot repeats to the bit on the machine that made it, until somebody touched
the robot in another way than by commands: pushed it, injected a fault, moved the gantry. Restarts, the emergency stop
and clients that left are repeated; the rest is listed in `RobotReplay.left_out`. A recording made in real time repeats
roughly: its commands fall between control steps.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from asimov_gym.assets import asset_path
from asimov_gym.edge import Client, Code, Dialect, EdgeListener, SimulatedRobot, Source
from asimov_gym.edge.motion_modes_service import KINDS as MOTION_MODE_KINDS
from asimov_gym.edge.motion_modes_service import MotionModes
from asimov_gym.edge.verdict import DropReason
from asimov_gym.edge.wire import cloud_pb2
from asimov_gym.firmware import MICROSECONDS, StepClock
from asimov_gym.physics import TIMESTEP, CPhysics
from asimov_gym.policy import Policy, load_policy
from asimov_gym.recording.notes import NO_POLICY, RunSettings, read_settings
from asimov_gym.recording.reader import Entry, read_recording
from asimov_gym.recording.schemas import COMMANDS, STATE, SYSTEM

ARRAYS = ("joint_pos", "joint_vel", "joint_current", "joint_temp", "imu_quat", "imu_gyro", "imu_gravity")
"""Fields of telemetry that are compared by their largest difference."""
DISCRETE = ("fw_mode", "error_flags", "alert_count")
"""Fields that are compared by how many frames differ."""
_STEP_US = round(TIMESTEP * MICROSECONDS)
_MATCH_US = 60_000
"""A frame of a real-time recording is compared with the one at most this far from it: they come every 100 ms."""
_UNREPEATABLE = {Code.CONSOLE.value, Code.OVERLOAD.value}


@dataclass(frozen=True)
class Difference:
    """How far the replay is from the recording in one field."""

    field: str
    largest: float
    """In the field's unit; for `DISCRETE` fields the number of frames that differ."""
    at: float | None
    """When it was largest, or first, s since the robot's start; None without a difference."""


@dataclass(frozen=True)
class RobotReplay:
    """How a second run went. Times are seconds since the robot's start."""

    seconds: float
    """Simulated time."""
    commands: int
    """Packets that were sent again."""
    changed_verdicts: int
    """How many of them got another verdict than in the recording."""
    frames: int
    """Recorded telemetry frames that were compared."""
    unmatched: int
    """Recorded frames without a counterpart in time."""
    equal_until: float
    """Time of the last frame before the first that is not equal in every value."""
    differences: tuple[Difference, ...]
    left_out: tuple[str, ...]
    """What was not repeated, or is not known to be the same, in words."""

    @property
    def identical(self) -> bool:
        """Whether every frame and every verdict is the recorded one."""
        return (
            self.frames > 0
            and self.unmatched == self.changed_verdicts == 0
            and all(difference.at is None for difference in self.differences)
        )


def replay_robot(
    path: str | Path,
    policy: str | Path | Policy | None = None,
    seed: int | None = None,
    physics: CPhysics | None = None,
) -> RobotReplay:
    """Send a recording's commands to a fresh robot in lockstep at their recorded times.

    Args:
        path: a recording that begins with the robot's start.
        policy: the network that drove the robot; None for the shipped one, if that is the one that the file names.
        seed: of the robot's sensor noise; None for the one that the file names, or 0.
        physics: one robot under other physics, where the recorded one had such.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: it is not a recording, begins later than the robot, or names another policy.
    """
    path = Path(path)
    settings = read_settings(path)
    left_out: list[str] = []
    runner = _policy(settings, policy, left_out)
    if seed is None and settings.seed is None:
        left_out.append("the recording does not name its seed: 0 is taken, so measured currents may differ")
    left_out += [f"made with {name} {was}; this is {name} {now}" for name, was, now in settings.other_versions()]
    if settings.lockstep is False:
        left_out.append("the recording was made in real time: commands fall on the control step that follows")
    entries = list(read_recording(path, [COMMANDS, STATE, SYSTEM]))
    epoch_us = _epoch_us(path, entries)
    robot = SimulatedRobot(
        runner,
        StepClock(epoch_us),
        seed=settings.seed or 0 if seed is None else seed,
        config=settings.config,
        physics=physics,
    )
    run = _Run(robot, epoch_us, left_out)
    for entry in entries:
        run.take(entry)
    return run.outcome([entry for entry in entries if entry.topic == STATE])


def _policy(settings: RunSettings, given: str | Path | Policy | None, left_out: list[str]) -> Policy | None:
    if given is not None and not isinstance(given, str | Path):
        return given
    if settings.policy == NO_POLICY and given is None:
        return None
    file = Path(given) if given is not None else asset_path("policies", "asimov_walk.onnx")
    runner = load_policy(file)
    if settings.policy_sha256 is None:
        left_out.append(f"the recording does not know its policy by hash: {file.name} is taken")
    elif runner.sha256 != settings.policy_sha256:
        which = f"{settings.policy} (SHA-256 {settings.policy_sha256[:12]}...)"
        raise ValueError(
            f"the recording was made with policy {which}, and {file} is another: name the file with --policy"
        )
    return runner


def _epoch_us(path: Path, entries: list[Entry]) -> int:
    """Edge wall clock when the robot was made: one control step before its first boot was reported."""
    for entry in entries:
        message: Any = entry.message
        if entry.topic == SYSTEM and (message.error.code, message.error.message) == (Code.BOOT.value, "boot 1"):
            return entry.time_us - _STEP_US
        if entry.topic == STATE:
            break
    raise ValueError(f"{path} begins later than its robot, whose state then is not known: it cannot be replayed")


class _Run(EdgeListener):
    """A robot that gets the recorded commands, and what it reported."""

    def __init__(self, robot: SimulatedRobot, epoch_us: int, left_out: list[str]) -> None:
        self._robot = robot
        self._epoch_us = epoch_us
        self._left_out = left_out
        self._clients: dict[str, Client] = {}
        self._frames: dict[int, cloud_pb2.EdgeTelemetry] = {}
        self._steps = 0
        self._restarts = 0
        self._commands = 0
        self._changed_verdicts = 0
        self._untouchable: Counter[str] = Counter()
        self._joint_control = False
        self._motion_modes = MotionModes(robot.edge)
        self._motion_modes.start()
        robot.edge.attach(self)

    def on_telemetry(self, timestamp_us: int, packet: bytes) -> None:
        self._frames[timestamp_us] = cloud_pb2.EdgeTelemetry.FromString(packet)

    def take(self, entry: Entry) -> None:
        """Bring the robot to the time of an entry, and do to it what the entry says was done."""
        message: Any = entry.message
        steps = (entry.time_us - self._epoch_us) // _STEP_US
        if entry.topic == SYSTEM and message.error.code == Code.BOOT.value:
            # Reported a step after the fact. A restart from the console has an event of its own at the right time.
            number = int(message.error.message.split()[-1])
            self._advance(steps - 1)
            self._restart(number - 1)
        self._advance(steps)
        if entry.topic == COMMANDS:
            self._send(message)
        elif entry.topic == SYSTEM:
            self._repeat_event(message, (entry.time_us - self._epoch_us) / MICROSECONDS)

    def _advance(self, steps: int) -> None:
        if steps > self._steps:
            self._robot.advance((steps - self._steps) * TIMESTEP)
            self._steps = steps

    def _send(self, command: Any) -> None:
        source = Source[command.source] if command.source else Source.IN_PROCESS
        if source is Source.JOINT_CONTROL:  # in messages that only its own lane can read, which is an optional one
            if not self._joint_control:
                self._joint_control = True
                self._left_out.append("joint control: its messages are not sent again")
            return
        self._commands += 1
        dialects = tuple(Dialect(name) for name in command.client_dialects) or (Dialect.CLOUD,)
        client = self._clients[command.client] = Client(source, command.client, dialects)
        if command.kind in MOTION_MODE_KINDS:
            verdict = self._motion_modes.repeat(command.payload)
        else:
            # Only a streamed command can be stale, and one that was not stale did the same as a reliable one.
            stale = command.verdict == DropReason.STALE.name
            verdict = self._robot.edge.receive(command.payload, client, streamed=stale)
        self._changed_verdicts += str(verdict) != command.verdict

    def _repeat_event(self, event: cloud_pb2.EdgeEvent, time: float) -> None:
        if event.WhichOneof("event") == "controller":
            client = self._clients.get(event.controller.previous)
            if event.controller.reason == "left" and client is not None:
                self._robot.edge.leave(client)
        elif event.error.code == Code.E_STOP.value:
            self._robot.edge.e_stop(event.error.message == "pressed")
        elif event.error.code == Code.CONSOLE.value and event.error.message.startswith("restart"):
            self._restart(self._restarts + 1)
        elif event.error.code in _UNREPEATABLE:
            words = f"{event.error.code}: {event.error.message}"
            if event.error.code not in self._untouchable:
                self._left_out.append(f"at {time:.3f} s {words}")
            self._untouchable[event.error.code] += 1

    def _restart(self, number: int) -> None:
        """Restart the firmware unless it was restarted so often already."""
        if number > self._restarts:
            self._robot.restart()
            self._restarts = number

    def outcome(self, recorded: list[Entry]) -> RobotReplay:
        times = np.array(sorted(self._frames))
        pairs, unmatched = [], 0
        for entry in recorded:
            near = int(times[np.abs(times - entry.time_us).argmin()]) if len(times) else None
            if near is None or abs(near - entry.time_us) > _MATCH_US:
                unmatched += 1
            else:
                pairs.append(((entry.time_us - self._epoch_us) / MICROSECONDS, entry.message, self._frames[near]))
        for code, count in self._untouchable.items():
            if count > 1:
                self._left_out.append(f"{count - 1} more of {code}")
        return RobotReplay(
            seconds=self._steps * TIMESTEP,
            commands=self._commands,
            changed_verdicts=self._changed_verdicts,
            frames=len(pairs),
            unmatched=unmatched,
            equal_until=_equal_until(pairs),
            differences=tuple(_differences(pairs)),
            left_out=tuple(self._left_out),
        )


_Pairs = list[tuple[float, Any, Any]]
"""Time, recorded frame, replayed frame."""


def _equal_until(pairs: _Pairs) -> float:
    last = 0.0
    for time, recorded, replayed in pairs:
        if any(getattr(recorded, field) != getattr(replayed, field) for field in ARRAYS + DISCRETE):
            break
        last = time
    return last


def _differences(pairs: _Pairs) -> list[Difference]:
    found = []
    times = np.array([time for time, _, _ in pairs])
    for field in ARRAYS:
        each = [_distance(getattr(a, field), getattr(b, field)) for _, a, b in pairs]
        place = int(np.argmax(each)) if each else 0
        largest = float(each[place]) if each else 0.0
        found.append(Difference(field, largest, float(times[place]) if largest > 0.0 else None))
    for field in DISCRETE:
        differ = [getattr(a, field) != getattr(b, field) for _, a, b in pairs]
        found.append(Difference(field, float(sum(differ)), float(times[differ.index(True)]) if any(differ) else None))
    return found


def _distance(recorded: Any, replayed: Any) -> float:
    if len(recorded) != len(replayed):
        return np.inf
    return float(np.max(np.abs(np.array(recorded) - np.array(replayed)), initial=0.0))
