"""A run's folder: resolved configuration, checkpoints, curves and, at the end, the exported policy."""

from __future__ import annotations

import os
import re
import time
from pathlib import Path
from typing import Any

import torch

from asimov_gym import presets
from train.config import PpoConfig

_CHECKPOINT = re.compile(r"checkpoint_(\d+)\.pt")


class RunFolder:
    """Files of one training run: `config.yaml`, `checkpoints/`, `curves/`, `policy.onnx`."""

    def __init__(self, path: Path) -> None:
        self.path = path

    @classmethod
    def create(cls, root: Path, name: str, config: PpoConfig) -> RunFolder:
        """Make a new folder `root/<date>_<name>` with the resolved configuration in it."""
        stem = f"{time.strftime('%Y-%m-%d_%H-%M-%S')}_{name}"
        path, count = root / stem, 1
        while path.exists():
            count += 1
            path = root / f"{stem}_{count}"
        path.mkdir(parents=True)
        presets.save(config, path / "config.yaml")
        return cls(path)

    @classmethod
    def open(cls, path: Path) -> RunFolder:
        """An existing run.

        Raises:
            FileNotFoundError: the folder or its `config.yaml` is missing.
        """
        if not (path / "config.yaml").is_file():
            raise FileNotFoundError(f"{path} is not a training run: it holds no config.yaml")
        return cls(path)

    def config(self) -> PpoConfig:
        """The configuration that the run was started with."""
        return presets.load(PpoConfig, self.path / "config.yaml")

    def checkpoints(self) -> list[Path]:
        """Checkpoints, oldest first."""
        found = [(int(m[1]), p) for p in (self.path / "checkpoints").glob("*.pt") if (m := _CHECKPOINT.fullmatch(p.name))]
        return [path for _, path in sorted(found)]

    def save_checkpoint(self, samples: int, state: dict[str, Any], keep: int) -> Path:
        """Write a checkpoint completely or not at all, and drop all but the newest `keep`."""
        folder = self.path / "checkpoints"
        folder.mkdir(exist_ok=True)
        path = folder / f"checkpoint_{samples:012d}.pt"
        partial = path.with_suffix(".partial")
        torch.save(state, partial)
        os.replace(partial, path)
        for old in self.checkpoints()[:-keep]:
            old.unlink()
        return path

    def load_checkpoint(self) -> dict[str, Any]:
        """The newest checkpoint.

        Raises:
            FileNotFoundError: there is none yet.
        """
        found = self.checkpoints()
        if not found:
            raise FileNotFoundError(f"{self.path} has no checkpoint to continue from")
        return torch.load(found[-1], weights_only=False)
