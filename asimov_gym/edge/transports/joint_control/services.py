"""The gRPC services by name, each method a function from bytes to bytes."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from typing import Any

import grpc
import grpc.aio
from google.protobuf.message import DecodeError, Message

from asimov_gym.edge.joint_control import JointControlPort
from asimov_gym.edge.transports.joint_control.commands import CommandDesk
from asimov_gym.edge.transports.joint_control.stamps import response_header
from asimov_gym.edge.transports.joint_control.state_messages import StateMessages
from asimov_gym.edge.transports.joint_control.streams import MAX_STATE_STREAMS, CommandIntake, StateFeed
from asimov_gym.edge.transports.joint_control.time_sync import TimeSync
from asimov_gym.edge.transports.joint_control.vendor import (
    header_pb2,
    robot_command_pb2,
    robot_state_pb2,
    time_sync_pb2,
)

MAX_MESSAGE_BYTES = 64 * 1024
"""A joint command with everything in it is under 1 KB."""
_UNREADABLE = header_pb2.CommonError.CODE_INVALID_REQUEST


class Services:
    """Everything that is served for one robot.

    Args:
        port: of the robot.
        loop: event loop that serves.
    """

    def __init__(self, port: JointControlPort, loop: asyncio.AbstractEventLoop) -> None:
        self._port = port
        self._edge = port.edge
        self._loop = loop
        self._states = StateMessages(port.edge.firmware)
        self._time_sync = TimeSync()
        self._desk = CommandDesk(port, self._states, self._time_sync)
        self._feed = StateFeed(port, self._states, loop)

    def handlers(self) -> tuple[grpc.GenericRpcHandler, ...]:
        """For `grpc.aio.Server.add_generic_rpc_handlers`."""
        command, state = robot_command_pb2, robot_state_pb2
        methods = {
            "RobotCommandService": {
                "RobotCommand": self._unary(
                    command.RobotCommandRequest, command.RobotCommandResponse, self._desk.command
                ),
                "RobotCommandFeedback": self._unary(
                    command.RobotCommandFeedbackRequest,
                    command.RobotCommandFeedbackResponse,
                    lambda request, _, received_us: self._desk.feedback(request, received_us),
                ),
                "ClearBehaviorFault": self._unary(
                    command.ClearBehaviorFaultRequest, command.ClearBehaviorFaultResponse, self._desk.clear_fault
                ),
            },
            "RobotCommandStreamingService": {
                "JointControlStream": grpc.stream_unary_rpc_method_handler(self._take_commands)
            },
            "RobotStateService": {
                "GetRobotState": self._unary(state.RobotStateRequest, state.RobotStateResponse, self._robot_state),
                "GetRobotHardwareConfiguration": self._unary(
                    state.RobotHardwareConfigurationRequest, state.RobotHardwareConfigurationResponse, self._hardware
                ),
            },
            "RobotStateStreamingService": {
                "GetRobotStateStream": grpc.unary_stream_rpc_method_handler(self._give_states)
            },
            "TimeSyncService": {
                "TimeSyncUpdate": self._unary(
                    time_sync_pb2.TimeSyncUpdateRequest, time_sync_pb2.TimeSyncUpdateResponse, self._synchronize
                )
            },
        }
        return tuple(
            grpc.method_handlers_generic_handler(f"bosdyn.api.{service}", named) for service, named in methods.items()
        )

    def _unary(
        self, request_type: Any, response_type: Any, answer: Callable[[Any, bytes, int], Message]
    ) -> grpc.RpcMethodHandler:
        """A method that reads its request, or says in the answer's header that it cannot be read."""

        async def call(payload: bytes, context: grpc.aio.ServicerContext) -> bytes:
            received_us = self._edge.clock.realtime_us()
            try:
                request = request_type.FromString(payload)
            except DecodeError:
                text = f"the bytes are no {request_type.DESCRIPTOR.name}"
                header = response_header(None, received_us, received_us, _UNREADABLE, text)
                return response_type(header=header).SerializeToString()
            return answer(request, payload, received_us).SerializeToString()

        return grpc.unary_unary_rpc_method_handler(call)

    # -- one call, one answer ----------------------------------------------------------------------

    def _robot_state(self, request: Any, payload: bytes, received_us: int) -> Message:
        with self._edge.lock:
            whole = self._states.whole()
        header = response_header(request, received_us, self._edge.clock.realtime_us())
        return robot_state_pb2.RobotStateResponse(header=header, robot_state=whole)

    def _hardware(self, request: Any, payload: bytes, received_us: int) -> Message:
        hardware = self._states.hardware()
        header = response_header(request, received_us, self._edge.clock.realtime_us())
        return robot_state_pb2.RobotHardwareConfigurationResponse(header=header, hardware_configuration=hardware)

    def _synchronize(self, request: Any, payload: bytes, received_us: int) -> Message:
        return self._time_sync.update(request, received_us, self._edge.clock.realtime_us())

    # -- streams -----------------------------------------------------------------------------------

    async def _take_commands(self, requests: AsyncIterator[bytes], context: grpc.aio.ServicerContext) -> bytes:
        return await CommandIntake(self._port, self._loop).serve(requests)

    async def _give_states(self, payload: bytes, context: grpc.aio.ServicerContext) -> AsyncIterator[bytes]:
        stream = self._feed.open()
        if stream is None:
            await context.abort(grpc.StatusCode.RESOURCE_EXHAUSTED, f"{MAX_STATE_STREAMS} state streams are open")
        try:
            while True:
                yield await stream.next()
        finally:
            self._feed.close(stream)
