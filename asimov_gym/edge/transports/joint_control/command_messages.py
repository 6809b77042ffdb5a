"""Joint commands out of the vendor's messages, and what became of a command as the vendor's statuses."""

from __future__ import annotations

from typing import Any

import numpy as np

from asimov_gym.edge.transports.joint_control.stamps import microseconds
from asimov_gym.edge.transports.joint_control.vendor import basic_command_pb2, lease_pb2, robot_command_pb2
from asimov_gym.edge.verdict import DropReason, Note, Verdict
from asimov_gym.firmware import Advice, JointCommand, JointGains

_StreamStatus = robot_command_pb2.JointControlStreamResponse
_CommandStatus = robot_command_pb2.RobotCommandResponse
_ContactAdvice = basic_command_pb2.JointCommand.ContactAdvice

STREAM_STATUS = {
    DropReason.JOINT_INVALID: _StreamStatus.STATUS_INVALID_REQUEST,
    DropReason.JOINT_NO_GAINS: _StreamStatus.STATUS_INVALID_REQUEST,
    DropReason.JOINT_SECOND_STREAM: _StreamStatus.STATUS_INVALID_REQUEST,
    DropReason.JOINT_INACTIVE: _StreamStatus.STATUS_INACTIVE,
    DropReason.NOT_IN_CONTROL: _StreamStatus.STATUS_INACTIVE,
    DropReason.JOINT_EXPIRED: _StreamStatus.STATUS_EXPIRED,
    DropReason.JOINT_TOO_DISTANT: _StreamStatus.STATUS_TOO_DISTANT,
}
"""How a stream is ended when an update of it is dropped."""

_COMMAND_STATUS = {
    DropReason.E_STOPPED: _CommandStatus.STATUS_NOT_POWERED_ON,
    DropReason.FAULT_LATCHED: _CommandStatus.STATUS_BEHAVIOR_FAULT,
    DropReason.JOINT_FAULT: _CommandStatus.STATUS_BEHAVIOR_FAULT,
    DropReason.JOINT_INVALID: _CommandStatus.STATUS_INVALID_REQUEST,
    DropReason.JOINT_NO_TIMESYNC: _CommandStatus.STATUS_NO_TIMESYNC,
    DropReason.JOINT_UNSUPPORTED: _CommandStatus.STATUS_UNSUPPORTED,
}
_NO_EFFECT = {
    Note.E_STOPPED: _CommandStatus.STATUS_NOT_POWERED_ON,
    Note.LATCHED: _CommandStatus.STATUS_BEHAVIOR_FAULT,
}
"""STAND is always taken, as over the robot's own interface; what it has no effect for is told here all the same."""

_ADVICE = {
    _ContactAdvice.ADVICE_IN_CONTACT: Advice.IN_CONTACT,
    _ContactAdvice.ADVICE_NOT_IN_CONTACT: Advice.NOT_IN_CONTACT,
}


def joint_command(request: Any, to_clock_us: int) -> JointCommand:
    """The joint command of an update.

    Args:
        request: one message of the stream, a `JointControlStreamRequest`.
        to_clock_us: added to robot time gives the robot's clock, microseconds.

    Raises:
        ValueError: something is missing or impossible; the message names the field.
    """
    if not request.HasField("joint_command"):
        raise ValueError("joint_command is missing")
    update = request.joint_command
    if not update.HasField("end_time"):
        raise ValueError("end_time is missing")
    gains = None
    if update.HasField("gains"):
        gains = JointGains(_array(update.gains.k_q_p), _array(update.gains.k_qd_p))
    fields: dict[str, Any] = {}
    if request.HasField("contact_advice") and request.contact_advice.contact_advice:
        given = request.contact_advice.contact_advice
        fields["advice"] = tuple(_ADVICE.get(advice, Advice.NONE) for advice in given)
    if update.HasField("reference_time"):
        fields["reference_us"] = microseconds(update.reference_time) + to_clock_us
    if update.HasField("extrapolation_duration"):
        fields["extrapolation_us"] = microseconds(update.extrapolation_duration)
    if update.HasField("velocity_safety_limit"):
        fields["velocity_limit"] = update.velocity_safety_limit.value
    return JointCommand(
        position=_array(update.position),
        velocity=_array(update.velocity),
        load=_array(update.load),
        end_us=microseconds(update.end_time) + to_clock_us,
        gains=gains,
        key=update.user_command_key,
        **fields,
    )


def _array(values: object) -> np.ndarray:
    return np.array(values, dtype=np.float64)


def set_outcome(response: Any, verdict: Verdict) -> bool:
    """Write what became of a command into its `RobotCommandResponse`; True if it is carried out."""
    if verdict.reason is DropReason.NOT_IN_CONTROL:
        response.lease_use_result.status = lease_pb2.LeaseUseResult.STATUS_OLDER
    status = _CommandStatus.STATUS_OK
    if verdict.reason is not None:
        status = _COMMAND_STATUS.get(verdict.reason, _CommandStatus.STATUS_UNKNOWN)
        response.message = verdict.reason.value
    for note in verdict.notes:
        if note in _NO_EFFECT:
            status, response.message = _NO_EFFECT[note], note.value
    response.status = status
    return status == _CommandStatus.STATUS_OK
