"""The motion-mode services on one robot, whatever lane they are called over.

What is asked for becomes commands of the robot's own firmware, under the edge's rules: one client in control at a time,
going limp is everybody's. Every answer is given at once; whether a switch is done is seen by asking for the mode.
"""

from __future__ import annotations

import json
import logging
import math
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from asimov_gym.edge.control import Client, Source
from asimov_gym.edge.edge import Edge
from asimov_gym.edge.lifecycle import Lifecycle
from asimov_gym.edge.listener import EdgeListener
from asimov_gym.edge.motion_modes import (
    LIMP,
    MODES,
    ActionStatus,
    CommonState,
    Fitness,
    MotionMode,
    MotionModesConfig,
    Refused,
    check_fitness,
    check_transition,
)
from asimov_gym.edge.motion_modes_input import InputAction, InputRefused, InputSource, InputSources
from asimov_gym.edge.motion_modes_messages import (
    GET_ACTION,
    GET_INPUT,
    SERVICES,
    SET_ACTION,
    SET_INPUT,
    TOPICS,
    VELOCITY,
    CommonResponse,
    CommonTaskResponse,
    GetCurrentInputSourceRequest,
    GetCurrentInputSourceResponse,
    GetMcActionRequest,
    GetMcActionResponse,
    McAction,
    McActionInfo,
    McActionStatus,
    McInputSource,
    McLocomotionVelocity,
    ResponseHeader,
    SetMcActionRequest,
    SetMcActionResponse,
    SetMcInputSourceRequest,
    SetMcInputSourceResponse,
    Time,
    from_json,
    to_json,
)
from asimov_gym.edge.motion_modes_messages import CommonState as CommonStateMessage
from asimov_gym.edge.verdict import DropReason, Note, Verdict
from asimov_gym.firmware import MICROSECONDS, Command, Damp, FirmwareState, Stand, State, Velocity

_log = logging.getLogger(__name__)

MODE_KIND = "motion_mode"
VELOCITY_KIND = "motion_velocity"
SOURCE_KIND = "motion_source"
KINDS = (MODE_KIND, VELOCITY_KIND, SOURCE_KIND)
"""Kinds of verdict, in counters and recordings."""

CLIENT = Client(Source.MOTION_MODES, "motion modes")
"""All callers together: the interface tells them apart by input source only."""

_COMMANDS: Mapping[MotionMode, Command] = MappingProxyType(
    {
        MotionMode.PASSIVE: Damp(limp=True),
        MotionMode.DAMPING: Damp(),
        MotionMode.JOINT: Stand(),
        MotionMode.STAND: Velocity(0.0, 0.0, 0.0),
        MotionMode.LOCOMOTION: Velocity(0.0, 0.0, 0.0),
    }
)


class MotionModes(Lifecycle, EdgeListener):
    """Serves the motion-mode messages between `start` and `stop`, or as a context manager. Several lanes share one.

    Args:
        edge: of the robot.
        config: what the vendor leaves open.
    """

    def __init__(self, edge: Edge, config: MotionModesConfig | None = None) -> None:
        self.config = config or MotionModesConfig()
        self._edge = edge
        self._sources = InputSources()
        self._boot = edge.firmware.boots
        self._asked_to_walk = False
        self._driver = ""  # the input source whose velocity was taken last
        self._verdict: Verdict | None = None  # the last one
        self._tasks = 0
        model = edge.firmware.physics.model
        weight = -float(model.opt.gravity[2] * model.body_subtreemass[0])
        self._foot_load = self.config.foot_load_share * weight
        self._stand_gravity_z = -math.cos(math.radians(self.config.stand_tilt_deg))
        self._answers: Mapping[str, Callable[[Any], Any]] = {
            GET_ACTION: self._get_action,
            SET_ACTION: self._set_action,
            SET_INPUT: self._set_input,
            GET_INPUT: self._get_input,
        }

    def start(self) -> None:
        """Follow the robot. Starting twice does nothing more."""
        self._edge.detach(self)
        self._edge.attach(self)

    def stop(self) -> None:
        """Leave the robot: control is free if it was ours, and it stops walking. Stopping twice does nothing more."""
        self._edge.detach(self)
        self._edge.leave(CLIENT)

    # -- what lanes use ----------------------------------------------------------------------------

    def call(self, service: str, request: Any) -> Any:
        """Answer a service request, at once.

        Args:
            service: a name of `SERVICES`.
            request: a message of that service's request class.

        Returns:
            A message of its response class.
        """
        with self._edge.lock:
            self._notice_restart()
            return self._answers[service](request)

    def publish(self, topic: str, message: Any) -> None:
        """Take a message of one of `TOPICS`. Nothing answers it; the verdict is counted and recorded."""
        assert topic == VELOCITY
        with self._edge.lock:
            self._notice_restart()
            self._velocity(message)

    def repeat(self, payload: bytes) -> Verdict | None:
        """Do again what a recorded payload did.

        Args:
            payload: of a command whose kind is one of `KINDS`.

        Returns:
            The verdict, or None where the request makes none.

        Raises:
            ValueError: it is no such payload.
        """
        entry = json.loads(payload)
        if not isinstance(entry, dict):
            raise ValueError("the payload of a motion-mode request must be a JSON object")
        service, topic = SERVICES.get(str(entry.get("service"))), TOPICS.get(str(entry.get("topic")))
        with self._edge.lock:
            self._verdict = None
            if service is not None:
                self.call(entry["service"], from_json(service.request, entry.get("request")))
            elif topic is not None:
                self.publish(entry["topic"], from_json(topic, entry.get("msg")))
            else:
                raise ValueError("the payload names neither a service nor a topic of the motion modes")
            return self._verdict

    # -- the mode ----------------------------------------------------------------------------------

    @property
    def mode(self) -> MotionMode:
        """The mode that the robot is in, or on its way to."""
        firmware = self._edge.firmware
        match firmware.state:
            case State.DAMP:
                fresh = firmware.damped_by is None
                return MotionMode.PASSIVE if fresh or firmware.limp else MotionMode.DAMPING
            case State.POLICY:
                walking = self._asked_to_walk or bool(firmware.velocity.any())
                return MotionMode.LOCOMOTION if walking else MotionMode.STAND
        return MotionMode.JOINT

    @property
    def status(self) -> ActionStatus:
        """Whether it is there."""
        return ActionStatus.TRANSITION if self._edge.firmware.rising else ActionStatus.RUNNING

    def on_tick(self, state: FirmwareState) -> None:
        """Forget what the robot has left behind."""
        self._notice_restart()
        if state.state is not State.POLICY:
            self._asked_to_walk = False

    def _notice_restart(self) -> None:
        """After a restart of the firmware everything is as at the start."""
        if self._boot != self._edge.firmware.boots:
            self._boot = self._edge.firmware.boots
            self._sources = InputSources()
            self._asked_to_walk = False

    def _get_action(self, request: GetMcActionRequest) -> GetMcActionResponse:
        mode = self.mode
        info = McActionInfo(McAction(mode.number), mode.value, McActionStatus(self.status))
        return GetMcActionResponse(self._header(), info)

    def _set_action(self, request: SetMcActionRequest) -> SetMcActionResponse:
        payload = _payload("service", SET_ACTION, "request", request)
        try:
            self._switch(request, payload)
        except Refused as refusal:
            _log.info("motion mode %r refused: %s", request.command.action_desc, refusal)
            return self._mode_response(refusal.state, str(refusal))
        return self._mode_response(CommonState.SUCCESS, "")

    def _switch(self, request: SetMcActionRequest, payload: bytes) -> None:
        """Take a request for a mode, or raise Refused; either way the verdict is reported."""
        present = self.mode
        known = self._sources.find(request.source) is not None
        notes = () if known else (Note.INPUT_SOURCE_UNKNOWN,)
        try:
            if self.config.strict_sources and not known:
                message = f"the input source {request.source!r} is not registered"
                raise Refused(CommonState.INVALID, DropReason.INPUT_SOURCE_UNKNOWN, message)
            goal = _mode(request.command.action_desc)
            if self._edge.firmware.state is State.TRAJECTORY and goal not in LIMP:
                message = "another interface drives the joints; only going limp is possible"
                raise Refused(CommonState.FAILURE, DropReason.MOTION_MODE_UNREACHABLE, message)
            if goal is present and goal not in LIMP:
                self._report(payload, Verdict(MODE_KIND, None, (*notes, Note.UNCHANGED)))
                return
            check_transition(present, goal, self.status is ActionStatus.TRANSITION, self.config)
            check_fitness(goal, self._fitness(), present)
        except Refused as refusal:
            self._report(payload, Verdict(MODE_KIND, refusal.reason))
            raise
        verdict = self._submit(_COMMANDS[goal], payload, MODE_KIND, notes)
        if verdict.reason is not None:
            foreign = verdict.reason is DropReason.NOT_IN_CONTROL
            state = CommonState.IN_MANUAL if foreign else CommonState.NOT_READY
            raise Refused(state, verdict.reason, self._why(verdict.reason))
        self._asked_to_walk = goal is MotionMode.LOCOMOTION

    def _fitness(self) -> Fitness:
        firmware = self._edge.firmware
        gravity_z = float(firmware.snapshot.imu_gravity[2])
        return Fitness(
            e_stopped=firmware.e_stopped,
            latched=firmware.alerts.latched,
            fallen=gravity_z > firmware.config.fall_gravity_z,
            leaning=gravity_z > self._stand_gravity_z,
            feet_loaded=bool((firmware.foot_load >= self._foot_load).all()),
            has_policy=firmware.policy is not None,
        )

    def _why(self, reason: DropReason) -> str:
        holder = self._edge.control.holder
        if reason is DropReason.NOT_IN_CONTROL and holder is not None:
            return f"another client is in control: {holder.name}"
        return reason.value

    # -- input sources -----------------------------------------------------------------------------

    def _set_input(self, request: SetMcInputSourceRequest) -> SetMcInputSourceResponse:
        payload = _payload("service", SET_INPUT, "request", request)
        wanted = request.input_source
        action = request.action.value
        source = InputSource(wanted.name, wanted.priority, wanted.timeout)
        try:
            self._sources.change(action, source)
        except InputRefused as refusal:
            _log.info("input source refused: %s", refusal)
            self._report(payload, Verdict(SOURCE_KIND, DropReason.INPUT_SOURCE_REFUSED))
            return SetMcInputSourceResponse(self._task_response(CommonState.INVALID))
        self._report(payload, Verdict(SOURCE_KIND))
        if action in (InputAction.DELETE, InputAction.DISABLE) and self._drives(wanted.name):
            self._edge.firmware.stop_walking()
        return SetMcInputSourceResponse(self._task_response(CommonState.SUCCESS))

    def _get_input(self, request: GetCurrentInputSourceRequest) -> GetCurrentInputSourceResponse:
        current = self._sources.current(self._edge.clock.now_us())
        told = McInputSource("", 0, 0) if current is None else _as_message(current)
        return GetCurrentInputSourceResponse(self._task_response(CommonState.SUCCESS), told)

    def _drives(self, name: str) -> bool:
        """Whether the robot's velocity is of this input source."""
        return self._edge.control.holder == CLIENT and self._driver == name

    # -- velocity ----------------------------------------------------------------------------------

    def _velocity(self, message: McLocomotionVelocity) -> None:
        payload = _payload("topic", VELOCITY, "msg", message)
        reason = self._velocity_fault(message)
        if reason is not None:
            self._report(payload, Verdict(VELOCITY_KIND, reason))
            return
        source = self._sources.find(message.source)
        assert source is not None
        wanted = np.array([message.forward_velocity, message.lateral_velocity, message.angular_velocity])
        limit = np.array(self.config.velocity_limit)
        velocity = np.clip(wanted, -limit, limit)
        notes = () if np.array_equal(wanted, velocity) else (Note.VELOCITY_CLAMPED,)
        if self.mode is MotionMode.STAND and velocity.any() and not self._starts(velocity):
            velocity[:] = 0.0
            notes = (*notes, Note.BELOW_START)
        vx, vy, vyaw = velocity.tolist()
        command = Velocity(vx, vy, vyaw, source.timeout_ms * 1000 / MICROSECONDS)
        if self._submit(command, payload, VELOCITY_KIND, notes).accepted:
            self._driver = source.name
            if velocity.any():
                self._asked_to_walk = False  # from now on the velocity says whether it walks

    def _velocity_fault(self, message: McLocomotionVelocity) -> DropReason | None:
        """Why a velocity is dropped before the firmware sees it. A valid one counts as a sign of life of its source."""
        values = (message.forward_velocity, message.lateral_velocity, message.angular_velocity)
        if not all(map(math.isfinite, values)):
            return DropReason.VELOCITY_NOT_FINITE
        if self._sources.find(message.source) is None:
            return DropReason.INPUT_SOURCE_UNKNOWN
        if not self._sources.is_enabled(message.source):
            return DropReason.INPUT_SOURCE_DISABLED
        if not self._sources.hear(message.source, self._edge.clock.now_us()):
            return DropReason.INPUT_SOURCE_OUTRANKED
        if self.mode in LIMP:
            return DropReason.VELOCITY_IN_DAMP
        if self.mode is MotionMode.JOINT:
            return DropReason.VELOCITY_NOT_BALANCING
        return None

    def _starts(self, velocity: np.ndarray) -> bool:
        return bool((np.abs(velocity) >= self.config.start_velocity).any())

    # -- verdicts ----------------------------------------------------------------------------------

    def _submit(self, command: Command, payload: bytes, kind: str, notes: tuple[Note, ...]) -> Verdict:
        self._verdict = self._edge.submit(command, CLIENT, payload, kind, notes)
        return self._verdict

    def _report(self, payload: bytes, verdict: Verdict) -> None:
        self._verdict = self._edge.report(CLIENT, payload, verdict)

    # -- responses ---------------------------------------------------------------------------------

    def _header(self, state: CommonState = CommonState.SUCCESS) -> ResponseHeader:
        now = self._edge.clock.realtime_us()
        stamp = Time(now // MICROSECONDS, now % MICROSECONDS * 1000)
        return ResponseHeader(stamp, 0 if state is CommonState.SUCCESS else int(state))

    def _mode_response(self, state: CommonState, message: str) -> SetMcActionResponse:
        return SetMcActionResponse(CommonResponse(self._header(state), CommonStateMessage(state), message))

    def _task_response(self, state: CommonState) -> CommonTaskResponse:
        self._tasks += 1
        return CommonTaskResponse(self._header(state), self._tasks, CommonStateMessage(state))


def _mode(name: str) -> MotionMode:
    if name not in MODES:
        message = f"there is no motion mode {name[:64]!r}; action_desc is one of {', '.join(MODES)}"
        raise Refused(CommonState.INVALID, DropReason.MOTION_MODE_UNKNOWN, message)
    return MODES[name]


def _as_message(source: InputSource) -> McInputSource:
    return McInputSource(source.name, source.priority, source.timeout_ms)


def _payload(what: str, name: str, part: str, message: Any) -> bytes:
    """What a recording holds of a request: its name and its fields, as JSON."""
    return json.dumps({what: name, part: to_json(message)}).encode()
