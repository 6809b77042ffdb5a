"""Asimov wiggles an arm while every other joint holds still: `python -m asimov_gym.examples.joint_wiggle`."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from asimov_gym.examples.joint_stream import Leg, run
from asimov_gym.robot.joints import joint_index

WIGGLE = {"right_shoulder_pitch_joint": -0.5, "right_elbow_joint": -0.6, "right_wrist_yaw_joint": 1.0}
"""rad, added to the standing pose, and taken away again for the wrist."""


@dataclass(frozen=True)
class JointWiggle:
    """Wiggle the right arm of a robot that serves joint control, and measure the loop."""

    target: str = "127.0.0.1:50051"
    """HOST:PORT that `asimov robot --joint-control 50051` serves."""
    seconds: float = 1.0
    """For each stretch."""
    repeats: int = 2
    """How often."""
    plot: Path = Path("joint_wiggle.png")
    """Histogram of the loop latency."""

    def legs(self, start: np.ndarray) -> list[Leg]:
        """There, the wrist to the other side, and back, from a standing pose (25,)."""
        there = start.copy()
        for joint, angle in WIGGLE.items():
            there[joint_index(joint)] += angle
        twisted = there.copy()
        wrist = joint_index("right_wrist_yaw_joint")
        twisted[wrist] = start[wrist] - WIGGLE["right_wrist_yaw_joint"]
        return [Leg(pose, self.seconds) for _ in range(self.repeats) for pose in (there, twisted, there, start)]


def main() -> int:
    """Run it."""
    wiggle = tyro.cli(JointWiggle)
    return run(wiggle.target, wiggle.legs, "Loop of joint control, wiggling an arm", wiggle.plot, gain=1.0)


if __name__ == "__main__":
    sys.exit(main())
