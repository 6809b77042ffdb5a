"""Drives a robot by the keys of the terminal.

A terminal tells when a key is pressed and never when it is released, so keys are steps and not levers: each press, and
each repeat of a held key, changes the velocity a little, and the robot keeps it until the next key.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from asimov_gym.cli.keyboard import Keyboard
from asimov_gym.cli.scripted_drive import LOST, DriveFailed
from asimov_gym.cli.telemetry_line import fault_names, mode_name, telemetry_line
from asimov_gym.edge.dialect import RULES
from asimov_gym.edge.wire import cloud_pb2

if TYPE_CHECKING:
    from asimov_gym.edge import Session

STEP_LINEAR = 0.1
"""Change of the velocity for each press, m/s."""
STEP_YAW = 0.2
"""The same for the yaw rate, rad/s."""
LOOK = 0.1
"""Between two looks at the robot, s."""

CHANGES = {
    "up": (STEP_LINEAR, 0.0, 0.0),
    "w": (STEP_LINEAR, 0.0, 0.0),
    "down": (-STEP_LINEAR, 0.0, 0.0),
    "x": (-STEP_LINEAR, 0.0, 0.0),
    "a": (0.0, STEP_LINEAR, 0.0),
    "page up": (0.0, STEP_LINEAR, 0.0),
    "d": (0.0, -STEP_LINEAR, 0.0),
    "page down": (0.0, -STEP_LINEAR, 0.0),
    "left": (0.0, 0.0, STEP_YAW),
    "right": (0.0, 0.0, -STEP_YAW),
}
"""Change of (vx, vy, yaw rate) by key."""
HELP = """\
s or enter         stand                     space     damp (go limp)
up, down or w, x   forward, backward         0 or end  walk on the spot
a, d               sideways, left and right  q         stop walking and leave
left, right        turn
Each press is a step of 0.1 m/s or 0.2 rad/s, a held key repeats; the robot keeps its velocity until the next key."""


class KeyboardDrive:
    """Takes keys until `q`.

    Args:
        session: to the robot.
        show: takes the telemetry line, several times a second.
        say: takes lines that are to stay.
    """

    def __init__(self, session: Session, show: Callable[[str], None], say: Callable[[str], None]) -> None:
        self._session = session
        self._show = show
        self._say = say
        self._limits = RULES[session.dialect].velocity_limit
        self.velocity = (0.0, 0.0, 0.0)
        """What was last asked for: vx, vy (m/s), yaw rate (rad/s)."""
        self._mode = ""
        self._faulted = False

    def run(self, keyboard: Keyboard) -> None:
        """Drive until `q`.

        Raises:
            DriveFailed: the link is lost.
        """
        self._say(HELP)
        try:
            while (key := keyboard.key(LOOK)) != "q":
                if key is not None:
                    self.press(key)
                self.look()
        except ConnectionError as error:
            raise DriveFailed(f"link lost: {error}") from None
        except EOFError as error:
            raise DriveFailed(str(error)) from None

    def press(self, key: str) -> None:
        """Do what a key means; others mean nothing."""
        if key == "space":
            self.velocity = (0.0, 0.0, 0.0)
            self._session.damp()
        elif key in ("s", "enter"):
            self.velocity = (0.0, 0.0, 0.0)
            self._session.stand()
        elif key in ("0", "end"):
            self._walk((0.0, 0.0, 0.0))
        elif key in CHANGES:
            changed = (value + step for value, step in zip(self.velocity, CHANGES[key], strict=True))
            vx, vy, yaw = (
                round(max(-limit, min(limit, value)), 3) for value, limit in zip(changed, self._limits, strict=True)
            )
            self._walk((vx, vy, yaw))

    def _walk(self, velocity: tuple[float, float, float]) -> None:
        if self._session.state.get().fw_mode == cloud_pb2.FW_MODE_DAMP:
            self._say("in DAMP the robot takes no velocity; s lets it stand")
            return
        self.velocity = velocity
        self._session.velocity(*velocity)

    def look(self) -> None:
        """Show the latest sample, and forget the velocity when the robot no longer walks by it.

        Raises:
            ConnectionError: the link is lost.
        """
        if self._session.state.lost is not None or self._session.state.age > LOST:
            raise ConnectionError(self._session.state.lost or f"no telemetry for {LOST:g} s")
        sample = self._session.state.get()
        mode = mode_name(sample)
        if mode != self._mode:
            if self._mode == "MOVE":
                self.velocity = (0.0, 0.0, 0.0)
            self._mode = mode
        if sample.error_flags and not self._faulted:
            names = ", ".join(fault_names(sample.error_flags)) or "latched"
            self._say(f"fault: {names}; only a restart clears it (asimov fault restart)")
        self._faulted = bool(sample.error_flags)
        vx, vy, yaw = self.velocity
        self._show(f"vx {vx:+.1f}  vy {vy:+.1f} m/s  yaw {yaw:+.1f} rad/s   {telemetry_line(sample)}")
