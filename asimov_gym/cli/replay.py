"""`asimov replay`: what a recording holds; plots, a video and a motion of it; and its run over again."""

from __future__ import annotations

import logging
import sys
from collections import Counter
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

if TYPE_CHECKING:
    from asimov_gym.recording.robot_replay import RobotReplay
    from asimov_gym.recording.summary import Summary

FURTHER = (
    "More: --events lists what happened, --plots DIR draws it, --video OUT.mp4 shows the movement, --robot runs it\n\
again, --motion OUT.npz makes it a reference motion for Asimov-Trajectory-v0."
)


@dataclass(frozen=True)
class Replay:
    """Say what a recording holds, draw it, or run it again in a fresh simulated robot.

    A file that was cut off, by a kill or a full disk, is read as far as it goes. Exit code 0 when all was done, 1 when
    a run that must repeat to the bit did not, 2 for a file that is no recording or a wish that cannot be tried.
    """

    file: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")]
    """The recording: an .mcap file, such as `asimov robot --record` writes."""
    events: bool = False
    """List every event and log line."""
    plots: Path | None = None
    """Draw modes, commands, velocities, motors and temperatures into PNG files in this folder."""
    video: Path | None = None
    """Draw the movement into this MP4 file. Where the robot went is estimated from its legs."""
    motion: Path | None = None
    """Write the movement to this .npz file, a reference motion for Asimov-Trajectory-v0."""
    start: float = 0.0
    """Start of the part for --motion, s."""
    stop: float | None = None
    """End of the part for --motion, s."""
    robot: bool = False
    """Send the recorded commands to a fresh robot in lockstep and compare its telemetry with the recorded."""
    policy: Path | None = None
    """For --robot: the ONNX policy of the recorded run, where it was not the shipped one."""
    seed: int | None = None
    """For --robot: seed of the sensor noise, where the recording does not name it."""

    def run(self) -> int:
        """Do what the flags ask for."""
        logging.getLogger("asimov_gym.recording.reader").addFilter(_Once())
        try:
            return self._run()
        except OSError as error:
            reason = f"{error.filename}: {error.strerror}" if error.filename else str(error)
            print(f"asimov replay: {reason}", file=sys.stderr)
        except ValueError as error:
            print(f"asimov replay: {error}", file=sys.stderr)
        return 2

    def _run(self) -> int:
        from asimov_gym.recording.summary import summarize

        summary = summarize(self.file)
        print_summary(self.file, summary)
        if self.events:
            print()
            for event in sorted((*summary.events, *summary.log), key=lambda event: event.time):
                print(f"{event.time:10.3f}  {event.code:<14} {event.text}")
        if self.plots is not None:
            self._plot(self.plots)
        if self.motion is not None:
            self._write_motion(self.motion)
        code = 0
        if self.video is not None:
            code = max(code, self._draw(self.video))
        if self.robot:
            code = max(code, self._rerun())
        if not (self.events or self.plots or self.motion or self.video or self.robot):
            print(FURTHER)
        return code

    def _plot(self, folder: Path) -> None:
        from asimov_gym.recording.plots import save_plots

        for path in save_plots(self.file, folder):
            print(f"plot       {path}")

    def _write_motion(self, path: Path) -> None:
        from asimov_gym.recording.motion import reference_motion
        from asimov_gym.tasks.trajectory import save_motion

        motion = reference_motion(self.file, self.start, self.stop)
        save_motion(path, motion)
        print(f'motion     {path}, {motion.duration:.1f} s: gymnasium.make("Asimov-Trajectory-v0", motion="{path}")')

    def _draw(self, path: Path) -> int:
        from asimov_gym.cli.video import FPS, VideoWriter
        from asimov_gym.recording.odometry import estimate_motion
        from asimov_gym.recording.series import read_telemetry
        from asimov_gym.rendering.backends import headless_backend, install_line

        backend = headless_backend()
        if backend is None:
            print(f"asimov replay: {install_line()}", file=sys.stderr)
            return 2
        poses = estimate_motion(read_telemetry(self.file)).poses(1.0 / FPS)
        path.parent.mkdir(parents=True, exist_ok=True)
        with VideoWriter(path, backend) as video:
            for pose in poses:
                video.write(pose)
            if not video.finish():
                print(f"asimov replay: no video: {video.error}", file=sys.stderr)
                return 2
        print(f"video      {path} ({backend})")
        return 0

    def _rerun(self) -> int:
        from asimov_gym.recording.robot_replay import replay_robot

        replay = replay_robot(self.file, self.policy, self.seed)
        print_replay(replay)
        return 0 if replay.identical or replay.left_out else 1


class _Once(logging.Filter):
    """Lets each line pass once: several parts of a command read the same file."""

    def __init__(self) -> None:
        super().__init__()
        self._seen: set[str] = set()

    def filter(self, record: logging.LogRecord) -> bool:
        line = record.getMessage()
        if line in self._seen:
            return False
        self._seen.add(line)
        return True


def print_summary(path: Path, summary: Summary) -> None:
    """Print what a recording holds."""
    notes = summary.notes
    began = datetime.fromtimestamp(summary.start_us / 1e6, UTC).isoformat(" ", "milliseconds").removesuffix("+00:00")
    whole = "" if summary.complete else ", cut off"
    print(f"{path}: {summary.duration:.1f} s from {began} UTC on the robot's clock{whole}")
    made = (f"{name} {notes[name]}" for name in ("asimov_gym", "mujoco", "time", "policy", "seed") if name in notes)
    print(f"  made with  {', '.join(made)}")
    print(f"  messages   {', '.join(f'{topic} {count}' for topic, count in summary.counts.items())}")
    missing = f"{summary.missing_frames} frames missing" if summary.missing_frames else "no frame missing"
    print(f"  telemetry  largest gap {summary.largest_gap:.3f} s at {summary.largest_gap_at:.1f} s, {missing}")
    by_client: dict[str, list[str]] = {}
    for (client, kind, verdict), count in sorted(summary.commands.items()):
        by_client.setdefault(client, []).append(f"{count} {kind} {verdict}")
    for client, counts in by_client.items():
        print(f"  commands   {client}: {', '.join(counts)}")
    if not by_client:
        print("  commands   none")
    print(f"  modes      {', '.join(f'{span.state} at {span.start:.2f} s' for span in summary.modes) or 'none'}")
    for alert in summary.alerts:
        until = "to the end" if alert.stop is None else f"to {alert.stop:.2f} s"
        print(f"  alert      {alert.start:.2f} s {until}: {alert.text}")
    print(f"  faults     {f'error_flags 0x{summary.error_flags:x}' if summary.error_flags else 'none'}")
    if summary.log:
        levels = Counter(line.code.lower() for line in summary.log)
        print(f"  log        {', '.join(f'{count} {level}' for level, count in levels.items())}")


def print_replay(replay: RobotReplay) -> None:
    """Print how a second run compares with the recorded one."""
    print(f"replayed   {replay.commands} commands in {replay.seconds:.1f} s of robot time")
    for line in replay.left_out:
        print(f"  note     {line}")
    if replay.identical:
        print(f"  equal    all {replay.frames} telemetry frames and all verdicts, to the bit")
        return
    print(f"  equal    telemetry until {replay.equal_until:.1f} s of {replay.frames} frames")
    for difference in replay.differences:
        if difference.at is not None:
            print(f"  differs  {difference.field}: {difference.largest:.4g} at {difference.at:.1f} s")
    if replay.changed_verdicts:
        print(f"  differs  verdict of {replay.changed_verdicts} commands")
    if replay.unmatched:
        print(f"  differs  {replay.unmatched} recorded frames have no counterpart")
