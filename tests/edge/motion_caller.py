"""A caller of the motion-mode services below any lane."""

from __future__ import annotations

from typing import Any

from asimov_gym.edge import Client, EdgeListener, SimulatedRobot, Verdict
from asimov_gym.edge.motion_modes import ActionStatus, CommonState, MotionMode, MotionModesConfig
from asimov_gym.edge.motion_modes_messages import (
    GET_ACTION,
    GET_INPUT,
    SET_ACTION,
    SET_INPUT,
    VELOCITY,
    GetCurrentInputSourceRequest,
    GetMcActionRequest,
    McActionCommand,
    McInputAction,
    McInputSource,
    McLocomotionVelocity,
    SetMcActionRequest,
    SetMcInputSourceRequest,
)
from asimov_gym.edge.motion_modes_service import CLIENT, MotionModes

PASSIVE, DAMPING, JOINT, STAND, LOCOMOTION = MotionMode
ADD, MODIFY, DELETE, ENABLE, DISABLE = 1001, 1002, 1003, 2001, 2002


class Caller:
    """Someone who calls the services, and sees the robot's verdicts."""

    def __init__(self, robot: SimulatedRobot, config: MotionModesConfig | None = None) -> None:
        self.robot = robot
        self.modes = MotionModes(robot.edge, config)
        self.modes.start()
        self.verdicts: list[Verdict] = []
        caller = self

        class Witness(EdgeListener):
            def on_command(self, received_us: int, client: Client, packet: bytes, verdict: Verdict) -> None:
                if client == CLIENT:
                    caller.verdicts.append(verdict)

        robot.edge.attach(Witness())

    @property
    def now(self) -> tuple[MotionMode, ActionStatus]:
        info = self.modes.call(GET_ACTION, GetMcActionRequest()).info
        mode = MotionMode(info.action_desc)
        assert info.current_action.value == mode.number
        return mode, ActionStatus(info.status.value)

    @property
    def mode(self) -> MotionMode:
        return self.now[0]

    def ask(self, name: str | MotionMode, source: str = "pnc") -> Any:
        """The response of SetMcAction; its code and state agree."""
        wanted = name.value if isinstance(name, MotionMode) else name
        request = SetMcActionRequest(source=source, command=McActionCommand(action_desc=wanted))
        response = self.modes.call(SET_ACTION, request).response
        assert (response.header.code == 0) == (response.status.value == CommonState.SUCCESS) == (not response.message)
        return response

    def state(self, name: str | MotionMode, source: str = "pnc") -> CommonState:
        return CommonState(self.ask(name, source).status.value)

    def velocity(self, forward: float, lateral: float = 0.0, angular: float = 0.0, source: str = "pnc") -> Verdict:
        message = McLocomotionVelocity(
            source=source, forward_velocity=forward, lateral_velocity=lateral, angular_velocity=angular
        )
        self.modes.publish(VELOCITY, message)
        return self.verdicts[-1]

    def input(self, action: int, name: str, priority: int = 40, timeout: int = 1000) -> int:
        """Code of SetMcInputSource; 0 is success."""
        request = SetMcInputSourceRequest(
            action=McInputAction(action), input_source=McInputSource(name, priority, timeout)
        )
        return self.modes.call(SET_INPUT, request).response.header.code

    @property
    def current(self) -> str:
        return self.modes.call(GET_INPUT, GetCurrentInputSourceRequest()).input_source.name

    def go(self, goal: MotionMode) -> None:
        """The way from start-up to a mode, as a person would go it."""
        way = {
            PASSIVE: [PASSIVE],
            DAMPING: [DAMPING],
            JOINT: [JOINT],
            STAND: [JOINT, STAND],
            LOCOMOTION: [JOINT, STAND, LOCOMOTION],
        }[goal]
        for step in way:
            assert self.state(step) is CommonState.SUCCESS
            self.robot.advance(2.2 if step is JOINT else 0.1)
        assert self.now == (goal, ActionStatus.RUNNING)
