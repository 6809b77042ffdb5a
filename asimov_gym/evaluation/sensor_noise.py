"""What the policy senses of a robot: the truth, or the truth with the training's noise on it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from asimov_gym.evaluation.scenario import Trial
from asimov_gym.physics import Reading
from asimov_gym.tasks.walk.config import NoiseConfig

_JOINTS = 25


class SensorNoise:
    """Uniform noise on every sensor, drawn anew each policy step, and an offset of each encoder, drawn once.

    Half-widths are those of `NoiseConfig` times the trial's noise level. Each robot draws from its own stream.
    """

    def __init__(self, trials: Sequence[Trial]) -> None:
        n, widths = len(trials), NoiseConfig()
        self._level = np.array([trial.scenario.conditions.noise for trial in trials])
        self._streams = [trial.generator("noise") for trial in trials]
        zero = [stream.uniform(-1.0, 1.0, _JOINTS) for stream in self._streams]
        self._zero = self._level[:, None] * widths.joint_zero * np.stack(zero)
        self._widths = np.repeat(
            [widths.gyro, widths.gravity, widths.joint_position, widths.joint_velocity], [3, 3, _JOINTS, _JOINTS]
        )
        self._noise = np.zeros((n, len(self._widths)))

    def sense(self, robots: np.ndarray, reading: Reading) -> dict[str, np.ndarray]:
        """Gyro, gravity, joint position and velocity by name, as `PolicyDriver.step` takes them.

        Args:
            robots: whose reading it is, (k,) int.
            reading: of those robots.
        """
        truth = {
            "gyro": reading.gyro,
            "gravity": reading.gravity,
            "joint_position": reading.joint_position,
            "joint_velocity": reading.joint_velocity,
        }
        level = self._level[robots]
        if not level.any():
            return truth
        for robot in robots[level > 0.0]:
            self._noise[robot] = self._streams[robot].uniform(-1.0, 1.0, len(self._widths))
        noise = level[:, None] * self._widths * self._noise[robots]
        parts = np.split(noise, [3, 6, 6 + _JOINTS], axis=1)
        parts[2] = parts[2] + self._zero[robots]
        return {name: value + part for (name, value), part in zip(truth.items(), parts, strict=True)}
