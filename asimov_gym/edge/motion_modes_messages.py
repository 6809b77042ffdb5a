"""Messages of the motion-mode interface, by the layouts of the vendor's message package 1.0.0, and their JSON form.

Each class is one message definition: its annotations are the fields with their types, in order. Both lanes are made
from these classes, so a layout stands here once.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from functools import cache
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, TypeVar, get_args, get_type_hints

Int32 = Annotated[int, "int32"]
UInt32 = Annotated[int, "uint32"]
Int64 = Annotated[int, "int64"]
UInt64 = Annotated[int, "uint64"]
Float64 = Annotated[float, "float64"]
String = Annotated[str, "string"]

RANGES = MappingProxyType(
    {
        "int32": (-(1 << 31), (1 << 31) - 1),
        "uint32": (0, (1 << 32) - 1),
        "int64": (-(1 << 63), (1 << 63) - 1),
        "uint64": (0, (1 << 64) - 1),
    }
)
"""Least and greatest value of the integer types."""


@dataclass(frozen=True)
class Time:
    """A time, seconds and nanoseconds since 1970."""

    type_name: ClassVar[str] = "builtin_interfaces/msg/Time"
    sec: Int32 = 0
    nanosec: UInt32 = 0


@dataclass(frozen=True)
class RequestHeader:
    """Head of a request."""

    type_name: ClassVar[str] = "aimdk_msgs/msg/RequestHeader"
    stamp: Time = field(default_factory=Time)


@dataclass(frozen=True)
class CommonRequest:
    """A request that says nothing more."""

    type_name: ClassVar[str] = "aimdk_msgs/msg/CommonRequest"
    header: RequestHeader = field(default_factory=RequestHeader)


@dataclass(frozen=True)
class ResponseHeader:
    """Head of a response; code 0 is success."""

    type_name: ClassVar[str] = "aimdk_msgs/msg/ResponseHeader"
    stamp: Time = field(default_factory=Time)
    code: Int64 = 0


@dataclass(frozen=True)
class CommonState:
    """A number of `motion_modes.CommonState`."""

    type_name: ClassVar[str] = "aimdk_msgs/msg/CommonState"
    value: Int32 = 0


@dataclass(frozen=True)
class CommonResponse:
    """What became of a request, and why."""

    type_name: ClassVar[str] = "aimdk_msgs/msg/CommonResponse"
    header: ResponseHeader = field(default_factory=ResponseHeader)
    status: CommonState = field(default_factory=CommonState)
    message: String = ""


@dataclass(frozen=True)
class CommonTaskResponse:
    """What became of a request, which has a number."""

    type_name: ClassVar[str] = "aimdk_msgs/msg/CommonTaskResponse"
    header: ResponseHeader = field(default_factory=ResponseHeader)
    task_id: UInt64 = 0
    state: CommonState = field(default_factory=CommonState)


@dataclass(frozen=True)
class McAction:
    """A mode by its integer, which clients are not to use."""

    type_name: ClassVar[str] = "aimdk_msgs/msg/McAction"
    value: Int32 = 0


@dataclass(frozen=True)
class McActionStatus:
    """A number of `motion_modes.ActionStatus`."""

    type_name: ClassVar[str] = "aimdk_msgs/msg/McActionStatus"
    value: Int32 = 0


@dataclass(frozen=True)
class McActionInfo:
    """The present mode."""

    type_name: ClassVar[str] = "aimdk_msgs/msg/McActionInfo"
    current_action: McAction = field(default_factory=McAction)
    action_desc: String = ""
    status: McActionStatus = field(default_factory=McActionStatus)


@dataclass(frozen=True)
class McActionCommand:
    """The mode asked for, by name."""

    type_name: ClassVar[str] = "aimdk_msgs/msg/McActionCommand"
    action: McAction = field(default_factory=McAction)
    action_desc: String = ""


@dataclass(frozen=True)
class McInputAction:
    """A number of `motion_modes_input.InputAction`."""

    type_name: ClassVar[str] = "aimdk_msgs/msg/McInputAction"
    value: Int32 = 0


@dataclass(frozen=True)
class McInputSource:
    """An input source; the time-out in milliseconds."""

    type_name: ClassVar[str] = "aimdk_msgs/msg/McInputSource"
    name: String = ""
    priority: Int32 = 0
    timeout: Int32 = 1000


@dataclass(frozen=True)
class MessageHeader:
    """Head of a message on a topic."""

    type_name: ClassVar[str] = "aimdk_msgs/msg/MessageHeader"
    stamp: Time = field(default_factory=Time)
    frame_id: String = ""
    sequence: UInt32 = 0
    meas_stamp: Time = field(default_factory=Time)


@dataclass(frozen=True)
class McLocomotionVelocity:
    """A velocity: forward and to the left in m/s, counter-clockwise in rad/s."""

    type_name: ClassVar[str] = "aimdk_msgs/msg/McLocomotionVelocity"
    header: MessageHeader = field(default_factory=MessageHeader)
    source: String = ""
    forward_velocity: Float64 = 0.0
    lateral_velocity: Float64 = 0.0
    angular_velocity: Float64 = 0.0


@dataclass(frozen=True)
class GetMcActionRequest:
    """Asks for the present mode."""

    type_name: ClassVar[str] = "aimdk_msgs/srv/GetMcAction_Request"
    request: CommonRequest = field(default_factory=CommonRequest)


@dataclass(frozen=True)
class GetMcActionResponse:
    """Tells it."""

    type_name: ClassVar[str] = "aimdk_msgs/srv/GetMcAction_Response"
    header: ResponseHeader = field(default_factory=ResponseHeader)
    info: McActionInfo = field(default_factory=McActionInfo)


@dataclass(frozen=True)
class SetMcActionRequest:
    """Asks for a mode."""

    type_name: ClassVar[str] = "aimdk_msgs/srv/SetMcAction_Request"
    header: RequestHeader = field(default_factory=RequestHeader)
    source: String = ""
    command: McActionCommand = field(default_factory=McActionCommand)


@dataclass(frozen=True)
class SetMcActionResponse:
    """Says whether the robot goes there."""

    type_name: ClassVar[str] = "aimdk_msgs/srv/SetMcAction_Response"
    response: CommonResponse = field(default_factory=CommonResponse)


@dataclass(frozen=True)
class SetMcInputSourceRequest:
    """Asks for a change of the input sources."""

    type_name: ClassVar[str] = "aimdk_msgs/srv/SetMcInputSource_Request"
    request: CommonRequest = field(default_factory=CommonRequest)
    action: McInputAction = field(default_factory=McInputAction)
    input_source: McInputSource = field(default_factory=McInputSource)


@dataclass(frozen=True)
class SetMcInputSourceResponse:
    """Says whether it was made."""

    type_name: ClassVar[str] = "aimdk_msgs/srv/SetMcInputSource_Response"
    response: CommonTaskResponse = field(default_factory=CommonTaskResponse)


@dataclass(frozen=True)
class GetCurrentInputSourceRequest:
    """Asks whose velocities count."""

    type_name: ClassVar[str] = "aimdk_msgs/srv/GetCurrentInputSource_Request"
    request: CommonRequest = field(default_factory=CommonRequest)


@dataclass(frozen=True)
class GetCurrentInputSourceResponse:
    """Tells it; an empty name is nobody."""

    type_name: ClassVar[str] = "aimdk_msgs/srv/GetCurrentInputSource_Response"
    response: CommonTaskResponse = field(default_factory=CommonTaskResponse)
    input_source: McInputSource = field(default_factory=McInputSource)


@dataclass(frozen=True)
class Service:
    """Type of a service."""

    type_name: str
    request: type
    response: type


GET_ACTION = "/aimdk_5Fmsgs/srv/GetMcAction"
SET_ACTION = "/aimdk_5Fmsgs/srv/SetMcAction"
SET_INPUT = "/aimdk_5Fmsgs/srv/SetMcInputSource"
GET_INPUT = "/aimdk_5Fmsgs/srv/GetCurrentInputSource"
VELOCITY = "/aima/mc/locomotion/velocity"

SERVICES = MappingProxyType(
    {
        GET_ACTION: Service("aimdk_msgs/srv/GetMcAction", GetMcActionRequest, GetMcActionResponse),
        SET_ACTION: Service("aimdk_msgs/srv/SetMcAction", SetMcActionRequest, SetMcActionResponse),
        SET_INPUT: Service("aimdk_msgs/srv/SetMcInputSource", SetMcInputSourceRequest, SetMcInputSourceResponse),
        GET_INPUT: Service(
            "aimdk_msgs/srv/GetCurrentInputSource", GetCurrentInputSourceRequest, GetCurrentInputSourceResponse
        ),
    }
)
"""Services by name. The `_5F` is part of the names."""
TOPICS: Mapping[str, type] = MappingProxyType({VELOCITY: McLocomotionVelocity})
"""Message classes of the topics that the robot takes, by name."""


# -- fields and JSON -------------------------------------------------------------------------------


class MessageError(ValueError):
    """What is given is no such message; names the field."""


_M = TypeVar("_M")


@cache
def layout(message: type) -> tuple[tuple[str, Any], ...]:
    """Name and type of each field of a message class: the name of a primitive type, or another message class."""
    hints = get_type_hints(message, include_extras=True)
    found = []
    for each in fields(message):
        hint = hints[each.name]
        found.append((each.name, hint if is_dataclass(hint) else get_args(hint)[1]))
    return tuple(found)


def to_json(message: Any) -> dict[str, Any]:
    """A message as JSON would have it; a float that is not finite becomes null."""
    values = ((name, kind, getattr(message, name)) for name, kind in layout(type(message)))
    return {name: _plain(value) if isinstance(kind, str) else to_json(value) for name, kind, value in values}


def _plain(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def from_json(message: type[_M], value: Any, place: str = "") -> _M:
    """A message from what JSON had. Missing fields take their defaults; null is a float that is not a number.

    Args:
        message: its class.
        value: an object, or a list of the fields in order.
        place: where in a greater message this is, for errors.

    Raises:
        MessageError: a field is unknown, of the wrong type or out of its range.
    """
    expected = layout(message)
    if isinstance(value, list) and len(value) <= len(expected):
        value = {name: each for (name, _), each in zip(expected, value, strict=False)}
    if not isinstance(value, dict):
        raise MessageError(f"{place or 'the message'} must be an object with the fields of {_type_name(message)}")
    unknown = sorted(map(str, value.keys() - {name for name, _ in expected}))
    if unknown:
        raise MessageError(f"{_type_name(message)} has no field {place}{unknown[0]!r}")
    return message(**{name: _field(kind, value[name], place + name) for name, kind in expected if name in value})


def _field(kind: Any, value: Any, place: str) -> Any:
    if not isinstance(kind, str):
        return from_json(kind, value, f"{place}.")
    if kind == "string":
        if not isinstance(value, str):
            raise MessageError(f"{place} must be a string")
        try:
            value.encode()
        except UnicodeEncodeError:
            raise MessageError(f"{place} must be text without lone surrogates") from None
        return value
    if kind == "float64":
        if value is None:
            return math.nan
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise MessageError(f"{place} must be a number")
        try:
            return float(value)
        except OverflowError:
            return math.inf
    low, high = RANGES[kind]
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise MessageError(f"{place} must be an integer from {low} to {high}")
    return value


def _type_name(message: type) -> str:
    return getattr(message, "type_name", message.__name__)
