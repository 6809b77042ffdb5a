"""Live progress of the demo in the terminal: mode, command, speed, height and the hottest joint."""

from __future__ import annotations

import time
from types import TracebackType

import numpy as np
from rich.console import Console, Group
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.text import Text

from asimov_gym.edge.wire.cloud_pb2 import EdgeTelemetry, FirmwareMode
from asimov_gym.robot.joints import MOTOR_NAMES

REFRESH = 0.1
"""Seconds of real time between pictures of the terminal."""


class Progress:
    """A few lines that change in place, with one line left behind for each phase. Use it as a context manager.

    Where the output is no terminal, only the lines of the phases are printed.

    Args:
        console: where to print.
        total: simulated seconds in all.
    """

    def __init__(self, console: Console, total: float) -> None:
        self._console = console
        self._total = total
        self._live = Live(console=console, transient=True, auto_refresh=False) if console.is_terminal else None
        self._drawn = 0.0
        self._began = time.perf_counter()

    def __enter__(self) -> Progress:
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if self._live is not None:
            self._live.stop()

    def show(
        self,
        phase: str,
        command: tuple[float, float, float],
        seconds: float,
        velocity: np.ndarray,
        height: float,
        telemetry: EdgeTelemetry,
    ) -> None:
        """Bring the lines up to date, at most every `REFRESH` seconds.

        Args:
            phase: name of the phase.
            command: vx, vy (m/s), yaw rate (rad/s) that were sent.
            seconds: simulated time.
            velocity: the robot's true velocity, as `command`.
            height: of the pelvis, m.
            telemetry: the latest sample.
        """
        now = time.perf_counter()
        if self._live is None or now - self._drawn < REFRESH:
            return
        self._drawn = now
        factor = seconds / (now - self._began)
        lines = [
            f"{_mode(telemetry):<6} {phase:<9} {seconds:5.1f} of {self._total:.0f} s, {factor:.1f} × real time",
            f"asked  vx {command[0]:+.2f}  vy {command[1]:+.2f} m/s  wz {command[2]:+.2f} rad/s",
            f"got    vx {velocity[0]:+.2f}  vy {velocity[1]:+.2f} m/s  wz {velocity[2]:+.2f} rad/s",
            f"pelvis {height:.3f} m    hottest {_hottest(telemetry)}",
        ]
        bar = ProgressBar(total=self._total, completed=seconds, width=60)
        self._live.update(Group(*(Text(line) for line in lines), bar), refresh=True)

    def close_phase(self, phase: str, seconds: float, height: float, telemetry: EdgeTelemetry) -> None:
        """Leave a line behind for a phase that ended at `seconds`."""
        line = (
            f"{seconds:5.1f} s  {phase:<9} {_mode(telemetry):<6} pelvis {height:.3f} m  hottest {_hottest(telemetry)}"
        )
        self._console.print(line, highlight=False)


def _mode(telemetry: EdgeTelemetry) -> str:
    return FirmwareMode.Name(telemetry.fw_mode).removeprefix("FW_MODE_")


def _hottest(telemetry: EdgeTelemetry) -> str:
    hottest = int(np.argmax(telemetry.joint_temp))
    return f"{MOTOR_NAMES[hottest]} {telemetry.joint_temp[hottest]:.1f} °C"
