"""Time stamps and headers of the vendor's messages. Robot time is microseconds since 1970 everywhere else."""

from __future__ import annotations

from typing import Any

from google.protobuf.duration_pb2 import Duration
from google.protobuf.timestamp_pb2 import Timestamp

from asimov_gym.edge.transports.joint_control.vendor import header_pb2

_MICROSECONDS = 1_000_000


def stamp(microseconds: int) -> Timestamp:
    """A time stamp of microseconds since 1970."""
    seconds, rest = divmod(microseconds, _MICROSECONDS)
    return Timestamp(seconds=seconds, nanos=1000 * rest)


def microseconds(stamp: Timestamp | Duration) -> int:
    """Microseconds of a time stamp or a duration, rounded down. Any value that the message can hold is taken."""
    return stamp.seconds * _MICROSECONDS + stamp.nanos // 1000


def response_header(
    request: Any,
    received_us: int,
    now_us: int,
    code: Any = header_pb2.CommonError.CODE_OK,
    message: str = "",
) -> Any:
    """`ResponseHeader` of the answer to a request.

    Args:
        request: the request, whose own header is sent back; None where it could not be read.
        received_us: when it came in.
        now_us: robot time.
        code: a `CommonError.Code`; CODE_OK unless the request as such was wrong.
        message: for people.
    """
    return header_pb2.ResponseHeader(
        request_header=None if request is None else request.header,
        request_received_timestamp=stamp(received_us),
        response_timestamp=stamp(now_us),
        error=header_pb2.CommonError(code=code, message=message),
    )
