"""From the bytes of a packet to a checked firmware command: which dialect it is, then that dialect's rules.

A packet says nowhere what it is. A RobotCommand always states its protocol version, 1; no CloudCommand uses that field.
So where a client may speak both, a version other than 0 makes it dialect `io`, and a command of one dialect can never
act as one of the other.
"""

from __future__ import annotations

from dataclasses import dataclass

from google.protobuf.message import DecodeError

from asimov_gym.edge import cloud_commands, io_commands
from asimov_gym.edge.control import Client, Dialect
from asimov_gym.edge.verdict import Dropped, DropReason, Note
from asimov_gym.edge.wire import cloud_pb2, io_pb2
from asimov_gym.firmware import Command, Linkage

MAX_PACKET_BYTES = 16_384
"""A larger packet is refused unread. The longest sensible command, 25 positions with gains, is 330 bytes."""

Message = cloud_pb2.CloudCommand | io_pb2.RobotCommand


@dataclass(frozen=True)
class Parsed:
    """A packet read as a message, its values not yet looked at."""

    dialect: Dialect
    message: Message
    kind: str
    """`velocity`, `trajectory`, `mode`, `eol`, or empty."""

    @property
    def sequence(self) -> int:
        """The sender's counter."""
        return self.message.sequence


@dataclass(frozen=True)
class Decoded:
    """A command that passed every check, and what was changed in it."""

    command: Command
    notes: tuple[Note, ...] = ()


def parse(packet: bytes, dialects: tuple[Dialect, ...] = (Dialect.CLOUD,)) -> Parsed:
    """Read a packet as a message of one of the dialects.

    Raises:
        Dropped: it is too large, or the bytes are no such message.
    """
    if len(packet) > MAX_PACKET_BYTES:
        raise Dropped(DropReason.TOO_LARGE)
    if Dialect.IO in dialects:
        message = _read(io_pb2.RobotCommand, packet)
        alone = len(dialects) == 1
        if message is None and alone:
            raise Dropped(DropReason.MALFORMED)
        if message is not None and (alone or message.protocol_version != 0):
            return Parsed(Dialect.IO, message, io_commands.KINDS[message.WhichOneof("command_data")])
    message = _read(cloud_pb2.CloudCommand, packet)
    if message is None:
        raise Dropped(DropReason.MALFORMED)
    return Parsed(Dialect.CLOUD, message, message.WhichOneof("command") or "")


def decode(parsed: Parsed, linkage: Linkage, client: Client, epoch: int) -> Decoded:
    """Check a message and turn it into a firmware command.

    Args:
        parsed: the message.
        linkage: of the ankles.
        client: who sent it.
        epoch: of the present run of the firmware.

    Raises:
        Dropped: it has no effect, for the reason given.
    """
    if isinstance(parsed.message, cloud_pb2.CloudCommand):
        command, notes = cloud_commands.command(parsed.message, linkage)
    else:
        command, notes = io_commands.command(parsed.message, linkage, client.source, epoch)
    return Decoded(command, tuple(dict.fromkeys(notes)))


def _read(kind: type, packet: bytes):  # -> the message, or None: protobuf's stubs have no common generic type for this
    try:
        return kind.FromString(packet)
    except DecodeError:
        return None
