"""Dialect `io`: from a RobotCommand to a checked firmware command.

A command is routed on the member of `command_data`, never on `mode`, whose default reads DAMP; so the version, which
has no default that is valid, is checked first.
"""

from __future__ import annotations

import numpy as np

from asimov_gym.edge.command_values import joint_position, limited_gains, limited_velocity, trajectory
from asimov_gym.edge.control import Dialect, Source
from asimov_gym.edge.dialect import KD_RANGE, KP_RANGE, PROTOCOL_VERSION, RULES
from asimov_gym.edge.verdict import Dropped, DropReason, Note
from asimov_gym.edge.wire import io_pb2
from asimov_gym.firmware import Command, Damp, Linkage, Stand
from asimov_gym.robot.joints import JOINT_NAMES

_RULES = RULES[Dialect.IO]
_MODES = {io_pb2.CONTROL_MODE_STAND: Stand(), io_pb2.CONTROL_MODE_DAMP: Damp()}
KINDS = {"policy": "velocity", "all_trajectory": "trajectory", "eol": "eol", None: "mode"}
"""Kind of a command, in the words of the verdict, by member of `command_data`."""


def command(message: io_pb2.RobotCommand, linkage: Linkage, source: Source, epoch: int) -> tuple[Command, list[Note]]:
    """The firmware command in a message, and what was changed in it.

    Args:
        message: the command.
        linkage: of the ankles.
        source: lane that it came by; decides how long a velocity holds.
        epoch: of the present run of the firmware.

    Raises:
        Dropped: it has no effect, for the reason given.
    """
    if message.protocol_version != PROTOCOL_VERSION:
        raise Dropped(DropReason.WRONG_VERSION)
    if message.firmware_epoch_id not in (0, epoch):
        raise Dropped(DropReason.WRONG_EPOCH)
    member = message.WhichOneof("command_data")
    if member == "policy":
        v = message.policy
        return limited_velocity((v.vx, v.vy, v.vyaw), _RULES, _RULES.velocity_timeout_s.get(source))
    if member == "all_trajectory":
        return _trajectory(message.all_trajectory, linkage)
    if member == "eol":
        raise Dropped(DropReason.FACTORY_TEST)
    if message.mode not in _MODES:
        raise Dropped(DropReason.UNKNOWN_MODE)
    return _MODES[message.mode], []


def _trajectory(message: io_pb2.AllTrajectory, linkage: Linkage) -> tuple[Command, list[Note]]:
    if len(message.positions) != len(JOINT_NAMES):
        raise Dropped(DropReason.TRAJECTORY_LENGTH)
    if not np.isfinite(message.positions).all():
        raise Dropped(DropReason.TRAJECTORY_NOT_FINITE)
    notes: list[Note] = []
    position = joint_position(np.array(message.positions), _RULES, linkage, notes)
    kp = limited_gains(message.kp, KP_RANGE, _RULES, notes)
    kd = limited_gains(message.kd, KD_RANGE, _RULES, notes)
    if (kp is None) != (kd is None):
        notes.append(Note.GAINS_LONE)
        kp = kd = None
    return trajectory(position, kp, kd, _RULES, linkage), notes
