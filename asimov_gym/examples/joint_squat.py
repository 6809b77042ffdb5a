"""Asimov squats, joint by joint: `python -m asimov_gym.examples.joint_squat`.

The ankle ends its travel at 0.35 rad, so the robot bends its hips and leans forward, as a person in stiff boots does.
The pose was found by hand: flat feet, ankles short of their end, centre of mass over the middle of the soles.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from asimov_gym.examples.joint_stream import Leg, run
from asimov_gym.robot.joints import joint_index

SQUAT = {"hip_pitch": -1.05, "knee": 0.9, "ankle_pitch": -0.33}
"""rad, left leg; the right one is its mirror image, every angle negated."""


@dataclass(frozen=True)
class JointSquat:
    """Squat twice against a robot that serves joint control, and measure the loop."""

    target: str = "127.0.0.1:50051"
    """HOST:PORT that `asimov robot --joint-control 50051` serves."""
    seconds: float = 2.0
    """For each way down or up."""
    repeats: int = 2
    """How often."""
    plot: Path = Path("joint_squat.png")
    """Histogram of the loop latency."""

    def legs(self, start: np.ndarray) -> list[Leg]:
        """Down and up again, from a standing pose (25,)."""
        low = start.copy()
        for side, sign in (("left", 1.0), ("right", -1.0)):
            for joint, angle in SQUAT.items():
                low[joint_index(f"{side}_{joint}_joint")] = sign * angle
        return [Leg(pose, self.seconds) for _ in range(self.repeats) for pose in (low, start)]


def main() -> int:
    """Run it."""
    squat = tyro.cli(JointSquat)
    return run(squat.target, squat.legs, "Loop of joint control, squatting", squat.plot, gain=2.0)


if __name__ == "__main__":
    sys.exit(main())
