"""The motion-mode messages as DDS types, as a ROS 2 node on Cyclone DDS would name and lay them out.

A service's messages carry 16 bytes in front of their fields, which say whose request it is and which one. That is the
way of `rmw_cyclonedds_cpp`; other ROS 2 middlewares pair a reply with its request in another, and do not meet it.
"""

from __future__ import annotations

from functools import cache
from typing import Any

from cyclonedds.idl import IdlStruct, make_idl_struct
from cyclonedds.idl.types import float64, int32, int64, uint32, uint64

from asimov_gym.edge.motion_modes_messages import layout

_PRIMITIVES = {
    "int32": int32,
    "uint32": uint32,
    "int64": int64,
    "uint64": uint64,
    "float64": float64,
    "string": str,
}
_PAIRING = {"client_id": uint64, "sequence_number": int64}


@cache
def dds_type(message: type) -> type[IdlStruct]:
    """The DDS type of a message class."""
    return make_idl_struct(message.__name__, _dds_name(message), _members(message))


@cache
def paired_dds_type(message: type) -> type[IdlStruct]:
    """The DDS type of a request or response class, with the members `client_id` and `sequence_number` in front."""
    return make_idl_struct(message.__name__, _dds_name(message), {**_PAIRING, **_members(message)})


def to_dds(message: Any, kind: type[IdlStruct], **pairing: int) -> IdlStruct:
    """A message as a sample of its DDS type.

    Args:
        message: of a class of `motion_modes_messages`.
        kind: what `dds_type` or `paired_dds_type` gives for that class.
        pairing: the members that only the paired type has.
    """
    values = {}
    for name, part in layout(type(message)):
        value = getattr(message, name)
        values[name] = value if isinstance(part, str) else to_dds(value, dds_type(part))
    return kind(**pairing, **values)


def from_dds(message: type, sample: Any) -> Any:
    """A sample as a message of this class."""
    values = {}
    for name, part in layout(message):
        value = getattr(sample, name)
        values[name] = value if isinstance(part, str) else from_dds(part, value)
    return message(**values)


def _members(message: type) -> dict[str, Any]:
    return {name: _PRIMITIVES[part] if isinstance(part, str) else dds_type(part) for name, part in layout(message)}


def _dds_name(message: type) -> str:
    """`package/msg/Name` as `package.msg.dds_.Name_`; the dots stand for the colons of the type's name."""
    package, folder, name = message.type_name.split("/")  # type: ignore[attr-defined]
    return f"{package}.{folder}.dds_.{name}_"
