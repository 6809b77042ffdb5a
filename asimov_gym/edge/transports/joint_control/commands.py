"""Commands of the vendor's command service: begin, stop, stand, freeze, power off, feedback, clear a fault."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass
from typing import Any

from asimov_gym.edge.joint_control import JointControlPort
from asimov_gym.edge.transports.joint_control.command_messages import set_outcome
from asimov_gym.edge.transports.joint_control.stamps import response_header
from asimov_gym.edge.transports.joint_control.state_messages import StateMessages
from asimov_gym.edge.transports.joint_control.time_sync import TimeSync
from asimov_gym.edge.transports.joint_control.vendor import (
    basic_command_pb2,
    header_pb2,
    robot_command_pb2,
)
from asimov_gym.edge.verdict import DropReason, Verdict
from asimov_gym.firmware import RunEnd, State

MAX_COMMANDS = 64
"""Commands whose feedback can still be asked for."""

_Status = basic_command_pb2.RobotCommandFeedbackStatus
_Joint = basic_command_pb2.JointCommand.Feedback
_Stand = basic_command_pb2.StandCommand.Feedback

_JOINTS, _STOP, _STAND, _FREEZE, _POWER_OFF = "joints", "stop", "stand", "freeze", "power off"
_FULL_BODY = {
    "joint_request": _JOINTS,
    "stop_request": _STOP,
    "freeze_request": _FREEZE,
    "safe_power_off_request": _POWER_OFF,
}
_MOBILITY = {"stand_request": _STAND, "stop_request": _STOP, "freeze_request": _FREEZE}


@dataclass(frozen=True)
class _Issued:
    """A command that was taken."""

    what: str
    run: int
    """Number of the run that it began; 0 for other commands."""
    synchronized: bool
    """Whether it came as a synchronized command, and wants its feedback as such."""


class CommandDesk:
    """Answers the unary calls of the command service for one port.

    Args:
        port: that carries them out.
        states: for what is said of faults.
        time_sync: knows the clients that have synchronised their clocks.
    """

    def __init__(self, port: JointControlPort, states: StateMessages, time_sync: TimeSync) -> None:
        self._port = port
        self._states = states
        self._time_sync = time_sync
        self._number = 0
        self._issued: OrderedDict[int, _Issued] = OrderedDict()

    # -- RobotCommand ------------------------------------------------------------------------------

    def command(self, request: Any, payload: bytes, received_us: int) -> Any:
        """Answer a `RobotCommandRequest` with a `RobotCommandResponse`, and carry it out if it is one of ours.

        Stopping, freezing and powering off need no synchronised clock.
        """
        clock = self._port.edge.clock
        what, synchronized = _wanted(request.command)
        response = robot_command_pb2.RobotCommandResponse()
        with self._port.edge.lock:
            verdict = self._carry_out(what, request, payload)
            if set_outcome(response, verdict):
                run = self._port.edge.firmware.joints.runs if what == _JOINTS else 0
                response.robot_command_id = self._remember(_Issued(what, run, synchronized))
        response.header.CopyFrom(response_header(request, received_us, clock.realtime_us()))
        return response

    def _carry_out(self, what: str, request: Any, payload: bytes) -> Verdict:
        port = self._port
        if not what:
            given = request.command.WhichOneof("command") is not None
            reason = DropReason.JOINT_UNSUPPORTED if given else DropReason.JOINT_INVALID
            return port.refuse("joint_other", reason, payload)
        if what in (_JOINTS, _STAND) and not self._time_sync.knows(request.clock_identifier):
            return port.refuse("joint_start", DropReason.JOINT_NO_TIMESYNC, payload)
        match what:
            case "joints":
                return port.begin(payload)
            case "freeze":
                return port.freeze(payload)
            case "power off":
                return port.power_off(payload)
        return port.stand(payload)

    def _remember(self, issued: _Issued) -> int:
        self._number += 1
        self._issued[self._number] = issued
        if len(self._issued) > MAX_COMMANDS:
            self._issued.popitem(last=False)
        return self._number

    # -- RobotCommandFeedback ----------------------------------------------------------------------

    def feedback(self, request: Any, received_us: int) -> Any:
        """Answer a `RobotCommandFeedbackRequest`: how a command fares. Number 0 stands for the last one."""
        edge = self._port.edge
        with edge.lock:
            number = request.robot_command_id or self._number
            issued = self._issued.get(number)
            response = robot_command_pb2.RobotCommandFeedbackResponse()
            if issued is None:
                code, problem = header_pb2.CommonError.CODE_INVALID_REQUEST, f"there is no command {number}"
                now_us = edge.clock.realtime_us()
                response.header.CopyFrom(response_header(request, received_us, now_us, code, problem))
                return response
            self._set_feedback(response.feedback, issued, latest=number == self._number)
            response.header.CopyFrom(response_header(request, received_us, edge.clock.realtime_us()))
            return response

    def _set_feedback(self, feedback: Any, issued: _Issued, latest: bool) -> None:
        status = self._status(issued, latest)
        if issued.synchronized:
            mobility = feedback.synchronized_feedback.mobility_command_feedback
            mobility.status = status
            self._set_mobility(mobility, issued)
            return
        whole = feedback.full_body_feedback
        whole.status = status
        match issued.what:
            case "joints":
                joints = self._port.edge.firmware.joints
                whole.joint_feedback.status = (
                    _Joint.STATUS_ACTIVE if status == _Status.STATUS_PROCESSING else _Joint.STATUS_ERROR
                )
                if issued.run == joints.runs:
                    whole.joint_feedback.num_messages_received = joints.received
            case "freeze":
                whole.freeze_feedback.SetInParent()
            case "power off":
                whole.safe_power_off_feedback.status = basic_command_pb2.SafePowerOffCommand.Feedback.STATUS_POWERED_OFF
            case _:
                whole.stop_feedback.SetInParent()

    def _set_mobility(self, mobility: Any, issued: _Issued) -> None:
        firmware = self._port.edge.firmware
        match issued.what:
            case "stand":
                stands = firmware.state is State.STAND and not firmware.rising
                mobility.stand_feedback.status = _Stand.STATUS_IS_STANDING if stands else _Stand.STATUS_IN_PROGRESS
            case "freeze":
                mobility.freeze_feedback.SetInParent()
            case _:
                mobility.stop_feedback.SetInParent()

    def _status(self, issued: _Issued, latest: bool) -> int:
        firmware = self._port.edge.firmware
        if firmware.e_stopped or firmware.alerts.latched:
            return _Status.STATUS_ROBOT_FROZEN
        if issued.what == _JOINTS:
            joints = firmware.joints
            if issued.run != joints.runs:
                return _Status.STATUS_COMMAND_OVERRIDDEN
            match joints.ended:
                case None:
                    return _Status.STATUS_PROCESSING
                case RunEnd.EXPIRED | RunEnd.SILENT:
                    return _Status.STATUS_COMMAND_TIMED_OUT
                case RunEnd.FAULT | RunEnd.STOPPED:
                    return _Status.STATUS_ROBOT_FROZEN
            return _Status.STATUS_COMMAND_OVERRIDDEN
        held = {
            _STAND: firmware.state is State.STAND,
            _STOP: firmware.state is State.STAND,
            _FREEZE: firmware.joints.frozen,
            _POWER_OFF: firmware.state is State.DAMP,
        }
        return _Status.STATUS_PROCESSING if latest and held[issued.what] else _Status.STATUS_COMMAND_OVERRIDDEN

    # -- ClearBehaviorFault ------------------------------------------------------------------------

    def clear_fault(self, request: Any, payload: bytes, received_us: int) -> Any:
        """Answer a `ClearBehaviorFaultRequest`: clear the fault of joint control.

        A latched alert is not among its faults: a restart of the firmware clears that.
        """
        edge, answer = self._port.edge, robot_command_pb2.ClearBehaviorFaultResponse
        with edge.lock:
            wanted = request.behavior_fault_id
            known = [fault for fault in self._states.faults() if fault.behavior_fault_id == wanted]
            cleared = self._port.clear_fault(wanted, payload).accepted
            return answer(
                header=response_header(request, received_us, edge.clock.realtime_us()),
                status=answer.STATUS_CLEARED if cleared else answer.STATUS_NOT_CLEARED,
                behavior_fault=known[0] if known else None,
            )


def _wanted(command: Any) -> tuple[str, bool]:
    """Which of our commands a command is, empty for none, and whether it came as a synchronized one."""
    if command.HasField("full_body_command"):
        return _FULL_BODY.get(command.full_body_command.WhichOneof("command") or "", ""), False
    if command.HasField("synchronized_command"):
        parts = command.synchronized_command
        if parts.HasField("arm_command") or parts.HasField("gripper_command"):
            return "", True
        return _MOBILITY.get(parts.mobility_command.WhichOneof("command") or "", ""), True
    return "", False
