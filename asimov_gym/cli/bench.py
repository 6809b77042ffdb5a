"""`asimov bench`: how fast things run on this machine, one subcommand for each thing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import tyro

from asimov_gym.cli.bench_robot import BenchRobot

Subject = Annotated[BenchRobot, tyro.conf.subcommand("robot")] | Annotated[None, tyro.conf.Suppress]
"""What can be measured. `None` is never chosen: a choice of one would not be a subcommand."""


@dataclass(frozen=True)
class Bench:
    """Measure how fast the simulation is on this machine."""

    subject: tyro.conf.OmitArgPrefixes[Subject]

    def run(self) -> int:
        return 2 if self.subject is None else self.subject.run()
