"""Topics of a recording and the protobuf schemas that describe them to other programs."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from google.protobuf import descriptor_pb2
from google.protobuf.message import Message

from asimov_gym.edge.wire import cloud_pb2, recording_pb2

COMMANDS = "/commands"
"""Every packet that came in, with its verdict: `RecordedCommand`."""
STATE = "/state"
"""Every telemetry frame: `EdgeTelemetry`."""
SYSTEM = "/system"
"""Every event: `EdgeEvent`."""

TOPICS: Mapping[str, type[Message]] = MappingProxyType(
    {COMMANDS: recording_pb2.RecordedCommand, STATE: cloud_pb2.EdgeTelemetry, SYSTEM: cloud_pb2.EdgeEvent}
)
"""Message type by topic."""


def descriptor_set(message: type[Message]) -> bytes:
    """The serialized FileDescriptorSet that MCAP wants as a protobuf schema: the type's file after all it imports."""
    files: dict[str, Any] = {}

    def collect(file: Any) -> None:  # a FileDescriptor, of whichever protobuf implementation is installed
        for dependency in file.dependencies:
            collect(dependency)
        files.setdefault(file.name, file)

    collect(message.DESCRIPTOR.file)
    result = descriptor_pb2.FileDescriptorSet()
    for file in files.values():
        file.CopyToProto(result.file.add())
    return result.SerializeToString()
