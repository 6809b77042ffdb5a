"""Arming: in dialect `io` the robot leaves STAND only after it was held upright for half a second."""

from __future__ import annotations

import math

from asimov_gym.firmware import MICROSECONDS, FirmwareState, State

ARMING_GRAVITY_Z = -math.cos(math.radians(30.0))
"""Upright is a tilt under 30 degrees: the body-frame gravity's z is below this, about -0.87."""


class Arming:
    """Since when STAND has been held upright.

    Measured on the clock, in wall-clock time where the robot runs in real time: the public client counts its own half
    second and sends its next command once. MOVE stays armed, so that STAND after MOVE needs no new wait.
    """

    def __init__(self) -> None:
        self._since_us: int | None = None
        self._moving = False

    def disarm(self) -> None:
        """DAMP was commanded; it may be left again before a control step sees it."""
        self._since_us, self._moving = None, False

    def update(self, state: FirmwareState, now_us: int) -> None:
        """Take the state after a control step."""
        self._moving = state.state in (State.POLICY, State.TRAJECTORY)
        if self._moving:
            self._since_us = now_us - MICROSECONDS if self._since_us is None else self._since_us
        elif state.state is State.DAMP or float(state.imu_gravity[2]) > ARMING_GRAVITY_Z:
            self._since_us = None
        elif self._since_us is None:
            self._since_us = now_us

    def armed(self, now_us: int, after_s: float) -> bool:
        """Whether it has been upright in STAND for `after_s` seconds, or is in MOVE."""
        if after_s <= 0.0 or self._moving:
            return True
        return self._since_us is not None and now_us - self._since_us >= after_s * MICROSECONDS
