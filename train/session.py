"""Starting, continuing and exporting runs."""

from __future__ import annotations

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
from train.ranks import Ranks
from train.run_folder import RunFolder

_console = Console(soft_wrap=True)


def start_run(config: PpoConfig, root: Path, preset: str, name: str, warm_start: Path | None = None) -> int:
    """Train in a new run folder, from the networks of another run if one is given; returns the exit code."""
    parent = None if warm_start is None else RunFolder(warm_start)

    def create() -> Path:
        before = None if warm_start is None else RunFolder.open(warm_start)
        return RunFolder.create(root, preset, config, name, before).path

    with Ranks.joined() as ranks:
        ranks = ranks.on(config.device)
        folder = RunFolder(ranks.from_first(create))
        trainer = _trainer(config, folder, ranks)
        trainer.console.print(f"run folder: {folder.path}")
        if ranks.count > 1:
            trainer.console.print(f"{ranks.count} processes of {config.copies} copies each")
        if parent is not None:
            trainer.warm_start(parent)
        trainer.console.print(trainer.reward_table())
        complete = trainer.run()
    return _finish(folder, complete, ranks)


def resume_run(path: Path) -> int:
    """Continue a run with as many processes as started it; returns the exit code."""
    with Ranks.joined() as ranks:
        folder = RunFolder(path)
        config = ranks.from_first(lambda: RunFolder.open(path).config())
        ranks = ranks.on(config.device)
        trainer = _trainer(config, folder, ranks)
        trainer.resume()
        trainer.console.print(f"continuing {folder.path} at {trainer.progress.samples / 1e6:.2f}M samples")
        complete = trainer.run()
    return _finish(folder, complete, ranks)


def _trainer(config: PpoConfig, folder: RunFolder, ranks: Ranks) -> Trainer:
    torch.set_num_threads(ranks.threads(config.threads))
    return Trainer(config, folder, ranks)


def _finish(folder: RunFolder, complete: bool, ranks: Ranks) -> int:
    if not ranks.first:
        return 0
    if not complete:
        _console.print(f"stopped; continue with:  {ranks.command} resume {folder.path}")
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
