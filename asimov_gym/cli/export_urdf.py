"""`asimov export-urdf`: the robot's description for tools that read URDF."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro


@dataclass(frozen=True)
class ExportUrdf:
    """Write the robot as URDF: links, masses, joints, limits and collision shapes, made from the MuJoCo model.

    Exit code 2 when the file cannot be written.
    """

    file: Annotated[Path, tyro.conf.Positional] = Path("asimov1.urdf")
    """File to write; - for the terminal."""
    leg_frames: Literal["shifted", "cad"] = "shifted"
    """Axes of the legs: the newest model file's, or those of the link meshes."""
    foot: Literal["rigid", "toe"] = "rigid"
    """The newest foot, or the one with a passive toe."""

    def run(self) -> int:
        """Make it and write it."""
        from asimov_gym.robot.urdf import urdf

        text = urdf(self.leg_frames, self.foot)
        if str(self.file) == "-":
            sys.stdout.write(text)
            return 0
        try:
            self.file.write_text(text, encoding="utf-8")
        except OSError as problem:
            print(f"asimov export-urdf: {self.file}: {problem.strerror}", file=sys.stderr)
            return 2
        print(f"wrote {self.file}")
        return 0
