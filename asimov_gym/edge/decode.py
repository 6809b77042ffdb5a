"""From the bytes of a CloudCommand to a checked firmware command: what is dropped, what is clamped, what is defaulted.

Pure functions; the rules are those of the robot's interface. Trajectories of this dialect hold motor values in the
ankle slots: positions go through the linkage to pitch and roll, and explicit gains act at the motors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from google.protobuf.message import DecodeError

from asimov_gym.edge.verdict import Dropped, DropReason, Note
from asimov_gym.edge.wire import cloud_pb2
from asimov_gym.firmware import Command, Damp, Linkage, Stand, Trajectory, Velocity
from asimov_gym.robot import ankle
from asimov_gym.robot.joints import JOINT_NAMES, RANGE

VELOCITY_LIMIT = np.array([2.0, 1.0, 2.0])
"""Published range of |vx|, |vy| (m/s) and |vyaw| (rad/s); beyond it a velocity is clamped."""
KP_RANGE = (0.0, 500.0)
"""Position gain of a motor, N·m/rad."""
KD_RANGE = (0.0, 5.0)
"""Damping gain of a motor, N·m·s/rad."""

_MODES = {cloud_pb2.MODE_STAND: Stand(), cloud_pb2.MODE_DAMP: Damp()}


@dataclass(frozen=True)
class Decoded:
    """A command that passed every check, and what was changed in it."""

    command: Command
    notes: tuple[Note, ...] = ()


def parse(packet: bytes) -> cloud_pb2.CloudCommand:
    """The message in a packet.

    Raises:
        Dropped: the bytes do not parse.
    """
    try:
        return cloud_pb2.CloudCommand.FromString(packet)
    except DecodeError:
        raise Dropped(DropReason.MALFORMED) from None


def decode(message: cloud_pb2.CloudCommand, linkage: Linkage) -> Decoded:
    """Check a message and turn it into a firmware command.

    Args:
        message: the command.
        linkage: of the ankles, whose motors a trajectory names.

    Raises:
        Dropped: it has no effect, for the reason given.
    """
    member = message.WhichOneof("command")
    if member == "mode":
        return _mode(message.mode)
    if member == "velocity":
        return _velocity(message.velocity)
    if member == "trajectory":
        return _trajectory(message.trajectory, linkage)
    raise Dropped(DropReason.NO_COMMAND)


def _mode(message: cloud_pb2.ModeCommand) -> Decoded:
    # The member is present, so a missing number really is STAND = 0; a number that we do not know is no command at all.
    if message.mode not in _MODES:
        raise Dropped(DropReason.UNKNOWN_MODE)
    return Decoded(_MODES[message.mode])


def _velocity(message: cloud_pb2.VelocityCommand) -> Decoded:
    wanted = np.array([message.vx, message.vy, message.vyaw])
    if not np.isfinite(wanted).all():
        raise Dropped(DropReason.VELOCITY_NOT_FINITE)
    limited = np.clip(wanted, -VELOCITY_LIMIT, VELOCITY_LIMIT)
    notes = () if np.array_equal(limited, wanted) else (Note.VELOCITY_CLAMPED,)
    return Decoded(Velocity(*(float(value) for value in limited)), notes)


def _trajectory(message: cloud_pb2.TrajectoryRequest, linkage: Linkage) -> Decoded:
    source = message.WhichOneof("source")
    if source == "id":
        raise Dropped(DropReason.TRAJECTORY_BY_ID)
    if source is None:
        raise Dropped(DropReason.TRAJECTORY_NO_SOURCE)
    segments = message.full.segments
    if not segments:
        raise Dropped(DropReason.TRAJECTORY_EMPTY)
    for segment in segments:
        if len(segment.positions) != len(JOINT_NAMES):
            raise Dropped(DropReason.TRAJECTORY_LENGTH)
        if not np.isfinite(segment.positions).all():
            raise Dropped(DropReason.TRAJECTORY_NOT_FINITE)
    notes = []
    if len(segments) > 1:
        notes.append(Note.EARLIER_SEGMENTS)
    if message.upper_only or any(segment.duration for segment in segments):
        notes.append(Note.FIELD_IGNORED)
    return _segment(segments[-1], linkage, notes)


def _segment(segment: cloud_pb2.JointSegment, linkage: Linkage, notes: list[Note]) -> Decoded:
    wanted = linkage.joint_position(np.array(segment.positions))
    position = np.clip(wanted, RANGE[:, 0], RANGE[:, 1])
    # A telemetry sample sent straight back comes as 32-bit floats through the linkage: that is no clamp worth a note.
    if np.abs(position - wanted).max() > 1e-5:
        notes.append(Note.POSITION_CLAMPED)
    kp = _gains(segment.kp, KP_RANGE, notes)
    kd = _gains(segment.kd, KD_RANGE, notes)
    return Decoded(Trajectory(position, kp, kd), tuple(dict.fromkeys(notes)))


def _gains(values: Sequence[float], limits: tuple[float, float], notes: list[Note]) -> np.ndarray | None:
    """Gains at the joints from gains at the motors, or None for the defaults."""
    if len(values) == 0:
        return None
    if len(values) != len(JOINT_NAMES):
        notes.append(Note.GAINS_WRONG_COUNT)
        return None
    wanted = np.array(values)
    if not np.isfinite(wanted).all():
        notes.append(Note.GAINS_NOT_FINITE)
        return None
    limited = np.clip(wanted, *limits)
    if not np.array_equal(limited, wanted):
        notes.append(Note.GAIN_CLAMPED)
    joint_gains, _ = ankle.gains_to_joint(limited, limited)  # the same map for stiffness and damping
    return joint_gains
