"""`asimov bench`: how fast things run on this machine, one subcommand for each thing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import tyro

from asimov_gym.cli.bench_env import BenchEnv
from asimov_gym.cli.bench_profiles import BenchProfiles
from asimov_gym.cli.bench_robot import BenchRobot
from asimov_gym.cli.bench_train import BenchTrain

Subject = (
    Annotated[BenchEnv, tyro.conf.subcommand("env")]
    | Annotated[BenchProfiles, tyro.conf.subcommand("profiles")]
    | Annotated[BenchRobot, tyro.conf.subcommand("robot")]
    | Annotated[BenchTrain, tyro.conf.subcommand("train")]
)
"""What can be measured."""


@dataclass(frozen=True)
class Bench:
    """Measure how fast the simulation is on this machine."""

    subject: tyro.conf.OmitArgPrefixes[Subject]

    def run(self) -> int:
        return self.subject.run()
