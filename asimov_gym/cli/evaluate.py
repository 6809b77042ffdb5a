"""`asimov eval`: how good a policy is, under the evaluation conditions."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path

import tyro


@dataclass(frozen=True)
class Evaluate:
    """Walk a grid of commands, stand and be pushed, with many seeds and action delays of 0 to 25 ms."""

    policy: tyro.conf.Positional[Path | None] = None
    """ONNX file; the shipped policy when omitted."""
    seeds: int = 20
    """Robots per command."""
    seconds: float = 20.0
    """Length of each walk."""
    pushes: bool = True
    """Also try the must-pass pushes of the robot maker's benchmark."""
    json: Path | None = None
    """Write every figure to this file."""

    def run(self) -> int:
        from rich.console import Console
        from rich.markdown import Markdown
        from rich.progress import Progress, TaskID

        from asimov_gym.assets import asset_path
        from asimov_gym.evaluation.report import evaluate
        from asimov_gym.policy import load_policy

        console = Console()
        try:
            policy = load_policy(self.policy or asset_path("policies", "asimov_walk.onnx"))
            with Progress(console=console, transient=True) as bar:
                tasks: dict[str, TaskID] = {}

                def show(stage: str, done: int, whole: int) -> None:
                    if stage not in tasks:
                        tasks[stage] = bar.add_task(stage, total=whole)
                    bar.update(tasks[stage], completed=done)

                report = evaluate(policy, self.seeds, self.seconds, self.pushes, show)
        except (FileNotFoundError, ValueError) as error:
            print(f"asimov eval: {error}", file=sys.stderr)
            return 2
        console.print(Markdown(report.markdown()))
        console.print()
        console.print(report.summary(), highlight=False)
        if self.json is not None:
            self.json.write_text(_dump(report.to_json()), encoding="utf-8")
        return 0


def _dump(data: object) -> str:
    return json.dumps(data, indent=1) + "\n"
