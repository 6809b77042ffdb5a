"""The `asimov` command. Each subcommand is a frozen dataclass of its flags with a `run()` that returns the exit code.

The modules imported here name flags only; MuJoCo and everything above it is imported inside `run()`, so that
`asimov --help` answers at once.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Annotated

import tyro

from asimov_gym.cli.bench import Bench
from asimov_gym.cli.demo import Demo
from asimov_gym.cli.doctor import Doctor
from asimov_gym.cli.drive import Drive
from asimov_gym.cli.evaluate import Evaluate
from asimov_gym.cli.export_urdf import ExportUrdf
from asimov_gym.cli.fault import Fault
from asimov_gym.cli.replay import Replay
from asimov_gym.cli.robot import Robot
from asimov_gym.cli.room import Room
from asimov_gym.cli.view import View

Command = (
    Annotated[Bench, tyro.conf.subcommand("bench")]
    | Annotated[Demo, tyro.conf.subcommand("demo")]
    | Annotated[Doctor, tyro.conf.subcommand("doctor")]
    | Annotated[Drive, tyro.conf.subcommand("drive")]
    | Annotated[Evaluate, tyro.conf.subcommand("eval")]
    | Annotated[ExportUrdf, tyro.conf.subcommand("export-urdf")]
    | Annotated[Fault, tyro.conf.subcommand("fault")]
    | Annotated[Replay, tyro.conf.subcommand("replay")]
    | Annotated[Robot, tyro.conf.subcommand("robot")]
    | Annotated[Room, tyro.conf.subcommand("room")]
    | Annotated[View, tyro.conf.subcommand("view")]
)


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point of `asimov`.

    Args:
        argv: arguments without the program's name; those of the process if None.

    Returns:
        The exit code of the subcommand: 0 for success, 1 when what was asked for failed, 2 when it could not be tried.
    """
    try:
        command = tyro.cli(
            Command,  # type: ignore[arg-type]
            prog="asimov",
            description="Train, judge and rehearse the walking of the Asimov 1 humanoid.",
            args=argv,
            config=(tyro.conf.OmitSubcommandPrefixes,),
        )
        return command.run()
    except KeyboardInterrupt:
        print("\ninterrupted", file=sys.stderr)
        return 130
