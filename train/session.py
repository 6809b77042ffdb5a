"""Starting, continuing and exporting runs."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import torch
from rich.console import Console
from rich.progress import Progress, TaskID

from asimov_gym.evaluation.report import evaluate
from asimov_gym.policy import load_policy
from asimov_gym.policy.contract import default_contract
from asimov_gym.robot.observation import observation_layout
from train.card import write_card
from train.config import PpoConfig
from train.export import export_onnx
from train.learner import load_actor
from train.ppo import Trainer
from train.run_folder import RunFolder

_console = Console(soft_wrap=True)


def start_run(config: PpoConfig, root: Path, preset: str, name: str, warm_start: Path | None = None) -> int:
    """Train in a new run folder, from the networks of another run if one is given; returns the exit code."""
    parent = None if warm_start is None else RunFolder.open(warm_start)
    folder = RunFolder.create(root, preset, config, name, parent)
    _console.print(f"run folder: {folder.path}")
    trainer = _trainer(folder)
    if parent is not None:
        trainer.warm_start(parent)
    _console.print(trainer.reward_table())
    return _finish(trainer, folder)


def resume_run(path: Path) -> int:
    """Continue a run; returns the exit code."""
    folder = RunFolder.open(path)
    trainer = _trainer(folder)
    trainer.resume()
    _console.print(f"continuing {folder.path} at {trainer.progress.samples / 1e6:.2f}M samples")
    return _finish(trainer, folder)


def _trainer(folder: RunFolder) -> Trainer:
    config = folder.config()
    torch.set_num_threads(config.threads or os.cpu_count() or 1)
    return Trainer(config, folder)


def _finish(trainer: Trainer, folder: RunFolder) -> int:
    if not trainer.run():
        _console.print(f"stopped; continue with:  python -m train resume {folder.path}")
        return 0
    return export_run(folder.path, None)


def export_run(path: Path, output: Path | None) -> int:
    """Export the newest checkpoint of a run as ONNX; returns the exit code."""
    folder = RunFolder.open(path)
    config, origin, state = folder.config(), folder.origin(), folder.load_checkpoint()
    walk, samples = config.walk, state["progress"]["samples"]
    contract = default_contract(
        layout=walk.layout,
        action_scale=walk.action_scale,
        action_clip=walk.action_clip,
        gait_frequency_hz=walk.gait_frequency_hz,
        standing_threshold=walk.standing_threshold,
        command_ranges=(walk.command.vx, walk.command.vy, walk.command.wz),
        model_sha256=origin["model_sha256"],
        trained_commit=origin["commit"],
        training={
            "preset": origin["preset"],
            "samples": samples,
            "seconds": round(state["progress"]["seconds"]),
            "after": origin["after"],
        },
    )
    actor = load_actor(config.learner, observation_layout(walk.layout), state["learner"]["actor_state_dict"])
    report = export_onnx(actor, contract, output or folder.path / "policy.onnx")
    _console.print(
        f"exported {report.path} after {samples / 1e6:.2f}M samples; largest difference from the trained network on "
        f"{report.samples} observations: {report.difference:.1e}"
    )
    return 0


def write_run_card(
    path: Path, policy_file: Path | None, notes: Path | None, seeds: int, earlier: Sequence[Path] = ()
) -> int:
    """Evaluate a run's exported policy and write its card beside the file; returns the exit code."""
    folder = RunFolder.open(path)
    policy_file = policy_file or folder.path / "policy.onnx"
    policy = load_policy(policy_file)
    text = notes.read_text(encoding="utf-8") if notes is not None else ""
    with Progress(console=_console, transient=True) as bar:
        tasks: dict[str, TaskID] = {}

        def show(stage: str, done: int, whole: int) -> None:
            if stage not in tasks:
                tasks[stage] = bar.add_task(stage, total=whole)
            bar.update(tasks[stage], completed=done)

        report = evaluate(policy, seeds=seeds, progress=show)
    card = policy_file.with_suffix(".md")
    write_card(folder, policy, report, card, text, [RunFolder.open(run) for run in earlier])
    _console.print(report.summary(), highlight=False)
    _console.print(f"card: {card}")
    return 0
