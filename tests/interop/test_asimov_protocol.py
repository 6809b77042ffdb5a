"""Our messages against the published `asimov-protocol` package: same bytes, every field, both ways, both dialects."""

from __future__ import annotations

from collections.abc import Iterator
from types import ModuleType
from typing import Any

import pytest
from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.message import Message

from asimov_gym.edge.wire import cloud_pb2, io_pb2

pytest.importorskip("asimov_protocol", reason="the robot's published messages: pip install asimov-protocol==1.3.0rc4")

from asimov_protocol.v1 import (
    asimov_command_pb2,
    asimov_common_pb2,
    asimov_diagnostics_pb2,
    asimov_state_pb2,
    edge_cloud_pb2,
    edge_pb2,
)

DIALECTS: list[tuple[ModuleType, tuple[ModuleType, ...]]] = [
    (cloud_pb2, (edge_cloud_pb2,)),
    (
        io_pb2,
        (asimov_command_pb2, asimov_state_pb2, asimov_common_pb2, asimov_diagnostics_pb2, edge_pb2),
    ),
]


def named(modules: tuple[ModuleType, ...], kind: str) -> dict[str, Any]:
    return {name: item for module in modules for name, item in getattr(module.DESCRIPTOR, kind).items()}


def message_pairs() -> Iterator[tuple[type[Message], type[Message]]]:
    for ours, theirs in DIALECTS:
        for module in theirs:
            for name in module.DESCRIPTOR.message_types_by_name:
                yield getattr(ours, name), getattr(module, name)


PAIRS = list(message_pairs())
IDS = [pair[1].DESCRIPTOR.full_name for pair in PAIRS]
SCALARS = {
    FieldDescriptor.CPPTYPE_FLOAT: (0.5, -1.25),
    FieldDescriptor.CPPTYPE_UINT32: (7, 2**32 - 1),
    FieldDescriptor.CPPTYPE_UINT64: (9, 2**64 - 1),
    FieldDescriptor.CPPTYPE_INT64: (-3, 2**63 - 1),
    FieldDescriptor.CPPTYPE_BOOL: (True,),
    FieldDescriptor.CPPTYPE_STRING: ("a", "wärme"),
}


def set_field(message: Message, field: Any) -> None:
    """Give a field distinct values that are not the default; messages inside are filled whole."""
    if field.message_type is not None:
        if field.is_repeated:
            for _ in range(2):
                fill(getattr(message, field.name).add())
        else:
            getattr(message, field.name).SetInParent()
            fill(getattr(message, field.name))
        return
    if field.enum_type is not None:
        setattr(message, field.name, field.enum_type.values[-1].number)
        return
    values = SCALARS[field.cpp_type]
    if field.is_repeated:
        getattr(message, field.name).extend([values[0]] * 24 + [values[-1]])
    else:
        setattr(message, field.name, values[-1])


def fill(message: Message) -> None:
    for field in message.DESCRIPTOR.fields:
        set_field(message, field)  # of a oneof, the last member stays


def shape(message: Any) -> dict[str, tuple[object, ...]]:
    """What the wire and the accessors depend on, by field name."""
    return {
        field.name: (
            field.number,
            field.type,
            field.is_repeated,
            field.is_repeated and field.is_packed,
            field.containing_oneof.name if field.containing_oneof else None,
            field.message_type.name if field.message_type else None,
            field.enum_type.name if field.enum_type else None,
        )
        for field in message.fields
    }


@pytest.mark.parametrize(("ours", "theirs"), DIALECTS, ids=["cloud", "io"])
def test_both_sides_have_the_same_messages_and_enums(ours: ModuleType, theirs: tuple[ModuleType, ...]) -> None:
    assert named((ours,), "message_types_by_name").keys() == named(theirs, "message_types_by_name").keys()
    our_enums, their_enums = named((ours,), "enum_types_by_name"), named(theirs, "enum_types_by_name")
    assert our_enums.keys() == their_enums.keys()
    for name in our_enums:
        values = [[(v.name, v.number) for v in enums[name].values] for enums in (our_enums, their_enums)]
        assert values[0] == values[1], name


@pytest.mark.parametrize(("ours", "theirs"), PAIRS, ids=IDS)
def test_fields_agree(ours: type[Message], theirs: type[Message]) -> None:
    assert shape(ours.DESCRIPTOR) == shape(theirs.DESCRIPTOR)


@pytest.mark.parametrize(("ours", "theirs"), PAIRS, ids=IDS)
def test_every_field_crosses_both_ways(ours: type[Message], theirs: type[Message]) -> None:
    for sender, receiver in ((ours, theirs), (theirs, ours)):
        for field in sender.DESCRIPTOR.fields:
            sent = sender()
            set_field(sent, field)
            received = receiver.FromString(sent.SerializeToString(deterministic=True))
            assert [found.name for found, _ in received.ListFields()] == [field.name]
            assert received.SerializeToString(deterministic=True) == sent.SerializeToString(deterministic=True)
            expected = receiver()
            set_field(expected, receiver.DESCRIPTOR.fields_by_name[field.name])
            assert received == expected, field.full_name


@pytest.mark.parametrize(("ours", "theirs"), PAIRS, ids=IDS)
def test_whole_message_crosses_both_ways(ours: type[Message], theirs: type[Message]) -> None:
    sent = theirs()
    fill(sent)
    back = theirs.FromString(ours.FromString(sent.SerializeToString()).SerializeToString())
    assert back == sent


def test_published_client_drives_our_robot() -> None:
    from asimov_gym.edge import Client, SimulatedRobot, Source

    robot = SimulatedRobot()
    stand = edge_cloud_pb2.CloudCommand(mode=edge_cloud_pb2.ModeCommand(mode=edge_cloud_pb2.MODE_STAND))
    assert robot.edge.receive(stand.SerializeToString(), Client(Source.IN_PROCESS, "theirs")).accepted
    robot.advance(0.1)
    sample = edge_cloud_pb2.EdgeTelemetry.FromString(robot.edge.latest)
    assert sample.fw_mode == edge_cloud_pb2.FW_MODE_STAND
    assert len(sample.joint_pos) == 25
