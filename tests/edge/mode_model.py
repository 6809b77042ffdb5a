"""The interface's rules once more, written down from its document and not from the code: what the mode machine, the
time-outs, the arming and the hand-over of control must do. Plain Python over whole control steps of 5 ms."""

from __future__ import annotations

from dataclasses import dataclass, field

STEP_MS = 5
DAMP, STAND, POLICY, TRAJECTORY = "DAMP", "STAND", "MOVE/POLICY", "MOVE/TRAJECTORY"
PRIORITY = ["e-stop", "console", "process", "udp", "room"]
"""Clients of the test, strongest first."""
TRAJECTORY_TIMEOUT_MS = {"cloud": 200, "io": 2000}
ARMING_STEPS = 101
"""Half a second of upright STAND after the first control step that sees it."""
CONTROL_SILENCE_MS = 2000


@dataclass
class ModeModel:
    """What the robot must be doing."""

    mode: str = DAMP
    latched: bool = False
    e_stop: bool = False
    velocity: float = 0.0
    now_ms: int = 0
    trajectory_end_ms: int = 0
    velocity_end_ms: int | None = None
    holder: str | None = None
    heard_ms: int = 0
    stand_steps: int = 0
    armed: bool = False
    drops: dict[str, int] = field(default_factory=dict)

    def step(self) -> None:
        """5 ms pass."""
        self.now_ms += STEP_MS
        if self.mode == TRAJECTORY and self.now_ms >= self.trajectory_end_ms:
            self.mode = DAMP
        if self.mode == POLICY and self.velocity_end_ms is not None and self.now_ms >= self.velocity_end_ms:
            self.velocity, self.velocity_end_ms = 0.0, None
        if self.mode in (POLICY, TRAJECTORY):
            self.armed = True
        elif self.mode == STAND:
            self.stand_steps += 1
            self.armed |= self.stand_steps >= ARMING_STEPS
        else:
            self._disarm()

    def _disarm(self) -> None:
        self.stand_steps, self.armed = 0, False

    def fault(self) -> None:
        """A critical alert."""
        self.latched, self.mode, self.velocity = True, DAMP, 0.0

    def restart(self) -> None:
        """The firmware restarts."""
        self.latched, self.mode, self.velocity = False, DAMP, 0.0

    def press(self, pressed: bool) -> None:
        """The emergency stop."""
        if pressed:
            self.mode, self.velocity, self.holder = DAMP, 0.0, "e-stop"
        elif self.e_stop:
            self.holder = None
        self.e_stop = pressed
        self._disarm()

    def leave(self, client: str) -> None:
        """A client goes."""
        if self.holder == client:
            self.holder = None
            self.velocity, self.velocity_end_ms = 0.0, None

    def _claim(self, client: str) -> bool:
        free = self.holder is None
        silent = not free and self.now_ms - self.heard_ms >= CONTROL_SILENCE_MS
        stronger = not free and PRIORITY.index(client) < PRIORITY.index(self.holder or "")
        if free or silent or stronger or self.holder == client:
            self.holder, self.heard_ms = client, self.now_ms
            return True
        return False

    def damp(self, client: str) -> None:
        """DAMP: from anybody, always."""
        if self.holder == client:
            self.heard_ms = self.now_ms
        self.mode, self.velocity = DAMP, 0.0
        self._disarm()

    def command(self, client: str, dialect: str, what: str, velocity: float = 0.0) -> bool:
        """A well-formed STAND, velocity or trajectory. True if it is taken."""
        if not self.e_stop and not self._claim(client):
            return False
        if what == "stand":
            if not self.latched and not self.e_stop and self.mode != STAND:
                self.mode, self.velocity = STAND, 0.0
            return True
        if self.e_stop or self.latched:
            return False
        if self.mode == DAMP and (what == "velocity" or dialect == "io"):
            return False
        if self.mode == STAND and dialect == "io" and not self.armed:
            return False
        if what == "velocity":
            self.mode, self.velocity = POLICY, velocity
            self.velocity_end_ms = self.now_ms + 2000 if (dialect, client) == ("io", "udp") else None
        else:
            self.mode, self.velocity = TRAJECTORY, 0.0
            self.trajectory_end_ms = self.now_ms + TRAJECTORY_TIMEOUT_MS[dialect]
        return True
