"""A run's folder: resolved configuration, checkpoints, curves and, at the end, the exported policy."""

from __future__ import annotations

import json
import os
import re
import subprocess
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch

from asimov_gym import presets
from asimov_gym.robot.model import model_sha256
from train.config import PpoConfig
from train.hardware import machine

if TYPE_CHECKING:
    from train.policy_file import PolicyFile

_CHECKPOINT = re.compile(r"checkpoint_(\d+)\.pt")


def present_commit() -> str | None:
    """Commit of the source checkout, with `+` when files differ from it; None outside a checkout."""
    root = Path(__file__).resolve().parent.parent
    try:
        commit = subprocess.run(
            ["git", "rev-parse", "HEAD"], cwd=root, capture_output=True, text=True, check=True
        ).stdout
        changed = subprocess.run(
            ["git", "status", "--porcelain", "-uno"], cwd=root, capture_output=True, text=True, check=True
        )
    except (OSError, subprocess.CalledProcessError):
        return None
    return commit.strip() + ("+" if changed.stdout.strip() else "")


def _dated(path: Path) -> Path:
    """The path with the date before its name, and a number behind it where that is taken."""
    stem = f"{time.strftime('%Y-%m-%d_%H-%M-%S')}_{path.name}"
    dated, count = path.with_name(stem), 1
    while dated.exists():
        count += 1
        dated = path.with_name(f"{stem}_{count}")
    return dated


class RunFolder:
    """Files of one training run: `config.yaml`, `checkpoints/`, `curves/`, `policy.onnx`."""

    def __init__(self, path: Path) -> None:
        self.path = path

    @classmethod
    def create(
        cls,
        root: Path,
        preset: str,
        config: PpoConfig,
        name: str | None = None,
        parent: RunFolder | PolicyFile | None = None,
        recipe: str | None = None,
        mean_of: Sequence[int] | None = None,
    ) -> RunFolder:
        """Make a new folder `root/<date>_<name>` with the resolved configuration and the run's origin in it.

        Args:
            root: folder of runs.
            preset: that the settings come from.
            config: settings.
            name: of the run; the preset's when None.
            parent: run or policy file whose networks this one starts with.
            recipe: command of the recipe or study that this run is a part of; the folder is then `root/<name>`.
            mean_of: where the run is a mean (see `train.mean_run`) of the parent and stages before it: their places in
                the history, from 1 on.

        Raises:
            FileExistsError: that folder is there.
        """
        path = root / (name or preset)
        if recipe is None:
            path = _dated(path)
        path.mkdir(parents=True)
        presets.save(config, path / "config.yaml")
        origin: dict[str, Any] = {"preset": preset, "commit": present_commit(), "model_sha256": model_sha256()}
        origin["machine"] = machine()
        origin["recipe"] = recipe
        origin["after"] = None if parent is None else parent.history()
        if mean_of is not None:
            origin["mean_of"] = list(mean_of)
        (path / "origin.json").write_text(json.dumps(origin, indent=2) + "\n", encoding="utf-8")
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

    def history(self) -> list[dict[str, Any]]:
        """Presets, commits and progress that led to this run's newest checkpoint, oldest first."""
        origin, progress = self.origin(), self.load_checkpoint()["progress"]
        stage = {"preset": origin["preset"], "commit": origin["commit"]}
        stage |= {"samples": progress["samples"], "seconds": round(progress["seconds"])}
        if "mean_of" in origin:
            stage["mean_of"] = origin["mean_of"]
        return [*(origin["after"] or []), stage]

    def origin(self) -> dict[str, Any]:
        """What the run was started from: `preset`, `commit`, `model_sha256`, `machine`, the command of the
        `recipe` or study that it is a part of, the stages `after` which it came, and which of them it is the `mean_of`,
        where it is one."""
        return json.loads((self.path / "origin.json").read_text(encoding="utf-8"))

    def samples(self) -> int:
        """Samples at the newest checkpoint; 0 where there is none."""
        found = self.checkpoints()
        return int(found[-1].stem.removeprefix("checkpoint_")) if found else 0

    def checkpoints(self) -> list[Path]:
        """Checkpoints, oldest first."""
        found = [
            (int(m[1]), p) for p in (self.path / "checkpoints").glob("*.pt") if (m := _CHECKPOINT.fullmatch(p.name))
        ]
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
        return torch.load(found[-1], map_location="cpu", weights_only=False)
