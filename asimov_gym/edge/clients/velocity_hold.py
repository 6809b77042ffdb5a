"""A velocity in force: said again where the lane lets it expire, and given up when the robot does not walk by it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from asimov_gym.edge.clients.reports import Arrival
from asimov_gym.edge.wire import cloud_pb2

PERIOD_S = 0.1
"""A held velocity is sent this often, where it is sent again at all."""
SILENCE_S = 2.0
"""Without a report for this long a held velocity ends: one zero is sent, and no more."""
SETTLE_S = 1.0
"""This long after a velocity was first sent the robot must report MOVE: arming takes 0.5 s, the lane a little."""


class VelocityHold:
    """Holds the last velocity that a session sent.

    A hold ends with the next verb, with `close`, when the robot reports another mode than MOVE or has restarted (after
    somebody's DAMP and STAND it must not walk off by itself), and after 2 s without a report.

    Args:
        send: sends a velocity; called with `lock` held, from a thread of the hold.
        lock: held by the session while it sends. A re-sent velocity thus never follows a newer verb.
        report_age: seconds since the last report.
        repeat: whether to send again; without it the hold only remembers that a velocity is in force.
    """

    def __init__(
        self,
        send: Callable[[float, float, float], object],
        lock: threading.Condition,
        report_age: Callable[[], float],
        repeat: bool,
    ) -> None:
        self._send = send
        self._condition = lock
        self._report_age = report_age
        self._repeat = repeat
        self._velocity: tuple[float, float, float] | None = None
        self._since = 0.0
        self._due = 0.0
        self._revoked = False
        self._closed = False
        self._thread: threading.Thread | None = None

    @property
    def active(self) -> bool:
        """Whether a velocity is in force, as far as is known."""
        return self._velocity is not None and not self._revoked

    def hold(self, velocity: tuple[float, float, float]) -> None:
        """A velocity has just been sent; a zero ends the hold. With the lock held."""
        if not any(velocity):
            self.release()
            return
        self._velocity, self._revoked = velocity, False
        self._since = time.monotonic()
        self._due = self._since + PERIOD_S
        if self._repeat and self._thread is None:
            self._thread = threading.Thread(target=self._run, name="velocity-hold", daemon=True)
            self._thread.start()
        self._condition.notify_all()

    def release(self) -> None:
        """Another command has been sent. With the lock held."""
        self._velocity = None

    def close(self) -> None:
        """End the thread. With the lock held; does not wait."""
        self._closed = True
        self._velocity = None
        self._condition.notify_all()

    def watch(self, sample: cloud_pb2.EdgeTelemetry, arrival: Arrival) -> None:
        """A report came in. Takes no lock: reports come on the robot's or the lane's own thread."""
        walks = sample.fw_mode == cloud_pb2.FW_MODE_MOVE
        if arrival is Arrival.RESTART or (not walks and time.monotonic() - self._since > SETTLE_S):
            self._revoked = True

    def _run(self) -> None:
        with self._condition:
            while not self._closed:
                if not self.active:
                    self._velocity = None
                    self._condition.wait()
                elif (left := self._due - time.monotonic()) > 0.0:
                    self._condition.wait(left)
                else:
                    self._say_again()

    def _say_again(self) -> None:
        assert self._velocity is not None
        velocity = self._velocity
        if self._report_age() > SILENCE_S:
            velocity = (0.0, 0.0, 0.0)
            self._velocity = None
        self._due = time.monotonic() + PERIOD_S
        try:
            self._send(*velocity)
        except ConnectionError:
            self._velocity = None
