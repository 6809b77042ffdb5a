"""How well a walk follows its velocity command: samples, their moving mean, and the error in a stretch of time."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from asimov_gym.physics import Reading
from asimov_gym.robot.frames import as_command

CHANNELS = ("vx", "vy", "wz")
"""Order of the velocity entries: forward and left (m/s) in the heading frame, yaw rate about the world's z (rad/s)."""


@dataclass
class Tracking:
    """Commanded and true velocity of one robot, sampled at a fixed interval."""

    interval: float
    """Seconds between samples."""
    window: float
    """Width of the moving mean, s: one gait period, so that the sway of each step does not count as an error."""
    commands: list[np.ndarray] = field(default_factory=list)
    velocities: list[np.ndarray] = field(default_factory=list)

    def add(self, command: np.ndarray, velocity: np.ndarray) -> None:
        """Append a sample: command (3,) and velocity (3,), both in the order of `CHANNELS`."""
        self.commands.append(np.array(command, dtype=np.float64))
        self.velocities.append(np.array(velocity, dtype=np.float64))

    @property
    def time(self) -> np.ndarray:
        """Time of each sample, s, (n,)."""
        return self.interval * np.arange(1, len(self.commands) + 1)

    @property
    def command(self) -> np.ndarray:
        """Commands, (n, 3)."""
        return np.array(self.commands).reshape(-1, len(CHANNELS))

    @property
    def velocity(self) -> np.ndarray:
        """True velocities at each instant, (n, 3)."""
        return np.array(self.velocities).reshape(-1, len(CHANNELS))

    def smoothed(self) -> np.ndarray:
        """Moving mean of the velocity over `window`, centred, shortened at both ends, (n, 3)."""
        velocity = self.velocity
        width = min(max(1, round(self.window / self.interval)), len(velocity))
        kernel = np.ones(width)
        count = np.convolve(np.ones(len(velocity)), kernel, mode="same")
        return np.stack([np.convolve(column, kernel, mode="same") / count for column in velocity.T], axis=1)

    def error(self, start: float, stop: float) -> tuple[float, float]:
        """Mean error of the smoothed velocity between two times.

        Args:
            start: s, inclusive.
            stop: s, exclusive.

        Returns:
            Mean norm of the (vx, vy) error in m/s and mean absolute yaw-rate error in rad/s.

        Raises:
            ValueError: there is no sample between the two times.
        """
        inside = (self.time >= start) & (self.time < stop)
        if not inside.any():
            raise ValueError(
                f"no sample between {start} s and {stop} s; there are {len(self.time)} up to {self.time[-1:]}"
            )
        difference = (self.smoothed() - self.command)[inside]
        return float(np.linalg.norm(difference[:, :2], axis=1).mean()), float(np.abs(difference[:, 2]).mean())


def true_velocity(reading: Reading) -> np.ndarray:
    """Velocity of the first robot of a reading, (3,): pelvis forward and left in the heading frame, yaw rate."""
    return as_command(reading.base_quat, reading.base_velocity, reading.gravity, reading.gyro)[0]
