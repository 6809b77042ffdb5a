"""Topics of a recording and the protobuf schemas that describe them to other programs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from google.protobuf import descriptor_pb2
from google.protobuf.message import Message

from asimov_gym.edge.wire import cloud_pb2, io_pb2, recording_pb2

COMMANDS = "/commands"
"""Every packet that came in, with its verdict: `RecordedCommand`."""
STATE = "/state"
"""Every telemetry frame, 10 a second: `EdgeTelemetry`."""
ROBOT_STATE = "/robot_state"
"""Every frame of the other dialect, 200 a second while somebody wants them: `RobotState`."""
SYSTEM = "/system"
"""Every event: `EdgeEvent`."""
LOG = "/log"
"""Every line of the log: `LogLine`, described as `foxglove.Log`."""

TOPICS: Mapping[str, type[Message]] = MappingProxyType(
    {
        COMMANDS: recording_pb2.RecordedCommand,
        STATE: cloud_pb2.EdgeTelemetry,
        ROBOT_STATE: io_pb2.RobotState,
        SYSTEM: cloud_pb2.EdgeEvent,
        LOG: recording_pb2.LogLine,
    }
)
"""Message type by topic."""

FOXGLOVE_LOG = "foxglove.Log"


@dataclass(frozen=True)
class Schema:
    """What an MCAP file says of the messages of a topic."""

    name: str
    """Full name of the message type."""
    data: bytes
    """A serialized FileDescriptorSet: the type's file after all it imports."""


def schema(topic: str) -> Schema:
    """The schema under which a topic is written.

    Raises:
        KeyError: there is no such topic.
    """
    message = TOPICS[topic]
    files = _files(message.DESCRIPTOR.file)
    if message is recording_pb2.LogLine:
        files[-1] = _as_foxglove_log(files[-1])
        return Schema(FOXGLOVE_LOG, _set(files))
    return Schema(message.DESCRIPTOR.full_name, _set(files))


def _set(files: list[descriptor_pb2.FileDescriptorProto]) -> bytes:
    return descriptor_pb2.FileDescriptorSet(file=files).SerializeToString(deterministic=True)


def _files(file: Any) -> list[descriptor_pb2.FileDescriptorProto]:
    """A FileDescriptor (of whichever protobuf implementation is installed) after all it imports."""
    found: dict[str, descriptor_pb2.FileDescriptorProto] = {}

    def collect(file: Any) -> None:
        for dependency in file.dependencies:
            collect(dependency)
        if file.name not in found:
            found[file.name] = descriptor_pb2.FileDescriptorProto()
            file.CopyToProto(found[file.name])

    collect(file)
    return list(found.values())


def _as_foxglove_log(file: descriptor_pb2.FileDescriptorProto) -> descriptor_pb2.FileDescriptorProto:
    """The file of `LogLine` under the names that Foxglove's log panel looks for.

    Only the description in the recording is renamed. A module of that name in this process would clash with
    Foxglove's own where somebody imports both.
    """
    (line,) = (message for message in file.message_type if message.name == recording_pb2.LogLine.DESCRIPTOR.name)
    package, _, line.name = FOXGLOVE_LOG.rpartition(".")
    own_name = f".{recording_pb2.LogLine.DESCRIPTOR.full_name}."
    for field in line.field:
        if field.type_name.startswith(own_name):
            field.type_name = f".{FOXGLOVE_LOG}.{field.type_name.removeprefix(own_name)}"
    return descriptor_pb2.FileDescriptorProto(
        name="foxglove/Log.proto", package=package, dependency=file.dependency, message_type=[line], syntax=file.syntax
    )
