"""A training run whose settings and place are known before it begins: a stage of a recipe, a variant of a study.

What is in its folder decides what is left to do: nothing else is remembered.
"""

from __future__ import annotations

import os
import shutil
from dataclasses import dataclass, replace
from pathlib import Path

from asimov_gym.presets import to_mapping
from train.config import PpoConfig
from train.overrides import differences
from train.run_folder import RunFolder
from train.session import resume_run, start_run

STOPPED = 130
"""Exit code after Ctrl-C outside the training, as shells have it."""
WAY_OUT = "undo the change, or train anew with another --runs"
_BEGUN = {"config.yaml", "origin.json", "curves", "diverged", "checkpoints"}
"""What a run holds before its first checkpoint, at most."""


@dataclass(frozen=True)
class PlannedRun:
    """A run, begun or not."""

    preset: str
    """That the settings come from."""
    config: PpoConfig
    folder: RunFolder

    @property
    def samples(self) -> int:
        """Trained so far."""
        return self.folder.samples()

    @property
    def finished(self) -> bool:
        """Whether all samples are trained."""
        return self.samples >= self.config.samples

    def seconds(self) -> float:
        """Trained so far."""
        return self.folder.load_checkpoint()["progress"]["seconds"] if self.samples else 0.0

    def state(self, running: bool) -> str:
        """How far it is, in words."""
        state = "done" if self.finished else "running" if running else "to come"
        if running and self.samples:
            state += f", {self.samples / 1e6:.2f}M so far"
        if self.samples:
            state += f", {self.seconds() / 60:.1f} min"
        return state

    def train(self, parent: Path | None, command: str) -> bool:
        """Train what is left; False when it was interrupted, which has said already how to continue.

        Args:
            parent: run whose networks it begins with.
            command: that goes on with the whole.

        Raises:
            ValueError: the folder holds something else than a run.
        """
        path = self.folder.path
        if self.samples:
            resume_run(path)
        else:
            self._discard()
            start_run(self.config, path.parent, self.preset, path.name, parent, command)
        return self.finished

    def check(self, now: str, parent: RunFolder | None) -> None:
        """Make sure that what was trained so far has these settings, and began with what `parent` holds.

        Args:
            now: what says the settings, such as `the recipe`.
            parent: run whose networks it began with.

        Raises:
            ValueError: it has not; names the first that differs.
        """
        if not self.samples:
            return
        path, trained = self.folder.path, RunFolder.open(self.folder.path).config()
        wanted = self.config  # what was left to the hardware was settled when the run began
        wanted = replace(wanted, library=wanted.library or trained.library, physics=wanted.physics or trained.physics)
        for where, here, there in differences(to_mapping(wanted), to_mapping(trained)):
            raise ValueError(f"{path} was trained with {where} = {there!r}, {now} now says {here!r}; {WAY_OUT}")
        origin = self.folder.origin()
        if (preset := origin["preset"]) != self.preset:
            raise ValueError(f"{path} was trained with preset = {preset!r}, {now} now says {self.preset!r}; {WAY_OUT}")
        if parent is not None and (not parent.samples() or origin["after"] != parent.history()):
            raise ValueError(
                f"{path} was not trained after what is in {parent.path} now: move it away to train it anew, or use "
                "another --runs"
            )

    def _discard(self) -> None:
        """Drop a run that was killed before its first checkpoint: there is nothing to continue.

        Raises:
            ValueError: the folder holds something else.
        """
        path = self.folder.path
        if not path.exists():
            return
        foreign = sorted({entry.name for entry in path.iterdir()} - _BEGUN) if path.is_dir() else [path.name]
        if foreign:
            raise ValueError(
                f"{path} has no checkpoint but holds {', '.join(foreign)}: move it away, or use another --runs"
            )
        shutil.rmtree(path)


def processes() -> int:
    """How many train together, as torchrun says."""
    return int(os.environ.get("WORLD_SIZE", "1"))
