"""Dialect `cloud`: from a CloudCommand to a checked firmware command."""

from __future__ import annotations

import numpy as np

from asimov_gym.edge.command_values import joint_position, limited_gains, limited_velocity, trajectory
from asimov_gym.edge.control import Dialect
from asimov_gym.edge.dialect import KD_RANGE, KP_RANGE, RULES
from asimov_gym.edge.verdict import Dropped, DropReason, Note
from asimov_gym.edge.wire import cloud_pb2
from asimov_gym.firmware import Command, Damp, Linkage, Stand
from asimov_gym.robot.joints import JOINT_NAMES

_RULES = RULES[Dialect.CLOUD]
_MODES = {cloud_pb2.MODE_STAND: Stand(), cloud_pb2.MODE_DAMP: Damp()}


def command(message: cloud_pb2.CloudCommand, linkage: Linkage) -> tuple[Command, list[Note]]:
    """The firmware command in a message, and what was changed in it.

    Raises:
        Dropped: it has no effect, for the reason given.
    """
    member = message.WhichOneof("command")
    if member == "mode":
        # The member is present, so a missing number really is STAND = 0; an unknown number is no command at all.
        if message.mode.mode not in _MODES:
            raise Dropped(DropReason.UNKNOWN_MODE)
        return _MODES[message.mode.mode], []
    if member == "velocity":
        v = message.velocity
        return limited_velocity((v.vx, v.vy, v.vyaw), _RULES, None)
    if member == "trajectory":
        return _trajectory(message.trajectory, linkage)
    raise Dropped(DropReason.NO_COMMAND)


def _trajectory(message: cloud_pb2.TrajectoryRequest, linkage: Linkage) -> tuple[Command, list[Note]]:
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
    last = segments[-1]
    position = joint_position(np.array(last.positions), _RULES, linkage, notes)
    kp = limited_gains(last.kp, KP_RANGE, _RULES, notes)
    kd = limited_gains(last.kd, KD_RANGE, _RULES, notes)
    return trajectory(position, kp, kd, _RULES, linkage), notes
