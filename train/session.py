"""Starting, continuing and exporting runs."""

from __future__ import annotations

import os
from pathlib import Path

import torch
from rich.console import Console

from train.config import PpoConfig
from train.ppo import Trainer
from train.run_folder import RunFolder

_console = Console()


def start_run(config: PpoConfig, root: Path, name: str) -> int:
    """Train in a new run folder; returns the exit code."""
    folder = RunFolder.create(root, name, config)
    _console.print(f"run folder: {folder.path}")
    trainer = _trainer(folder)
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
    """Export the newest checkpoint of a run; returns the exit code."""
    raise NotImplementedError
