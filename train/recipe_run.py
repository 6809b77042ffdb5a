"""Going through a recipe, stage after stage; interrupted at any time and gone on with by the same command.

A stage is a run like any other, in `<runs>/<recipe>/<number>_<stage>`, started and continued as `python -m train ppo`
and `resume` do it. What is there decides what is left: nothing else is remembered.
"""

from __future__ import annotations

import os
import shlex
import shutil
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from rich.console import Console

from asimov_gym.evaluation.suite import load_suite
from asimov_gym.presets import to_mapping
from train.config import PpoConfig
from train.hardware import why_no_gpu
from train.recipe import Recipe, Stage
from train.run_folder import RunFolder
from train.session import export_run, resume_run, start_run, write_run_card

_BEGUN = {"config.yaml", "origin.json", "curves", "diverged", "checkpoints"}
"""What a run holds before its first checkpoint, at most."""
_STOPPED = 130
"""Exit code after Ctrl-C outside the training, as shells have it."""
_console = Console(soft_wrap=True, highlight=False, force_jupyter=False)


@dataclass(frozen=True)
class StageRun:
    """A stage and its run."""

    stage: Stage
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


class RecipeRun:
    """A recipe and the runs of its stages.

    Args:
        recipe: what is trained.
        root: folder of runs; these are in one called after the recipe.
        scale: the samples of all stages are multiplied by this.
        suite: that the result is judged by: a name, or a YAML file.
        source: how the recipe was asked for, a name or a file; its name when None.

    Raises:
        ValueError: the scale is out of range, the suite is unknown, the machine has not what the recipe needs, or what
            is in the folder is not of this recipe.
    """

    def __init__(
        self, recipe: Recipe, root: Path, scale: float = 1.0, suite: str = "quick", source: str | None = None
    ) -> None:
        self.recipe, self.suite, self.path = recipe, load_suite(suite), root / recipe.name
        flags = [] if root == Path("runs") else ["--runs", str(root)]
        flags += [] if scale == 1.0 else ["--scale", f"{scale:g}"]
        flags += [] if suite == "quick" else ["--suite", suite]
        self.command = shlex.join(["python", "-m", "train", "recipe", source or recipe.name, *flags])
        self._suite_name = suite
        self.stages = tuple(
            StageRun(stage, config, RunFolder(self.path / f"{number:02d}_{stage.name}"))
            for number, (stage, config) in enumerate(zip(recipe.stages, recipe.scaled(scale), strict=True), start=1)
        )
        if (processes := int(os.environ.get("WORLD_SIZE", "1"))) > 1:
            raise ValueError(
                f"a recipe trains in one process, got {processes}: start its stages one by one with torchrun, see "
                "docs/multi_device.md"
            )
        if recipe.gpu and (reason := why_no_gpu()) is not None:
            raise ValueError(f"recipe {recipe.name} is for a GPU, and {reason}")
        self._check_folder()

    def execute(self) -> int:
        """Do what is left: train, export, write the card. Returns the exit code."""
        try:
            return self._judge() if self._train() else 0
        except KeyboardInterrupt:
            _console.print(f"\nstopped; continue with:  {self.command}")
            return _STOPPED

    # -- training ------------------------------------------------------------------------------------------------------

    def _train(self) -> bool:
        """Train the stages that are left; False when it was interrupted."""
        _console.print(f"recipe {self.recipe.name}: {self.recipe.about}")
        previous: Path | None = None
        for run in self.stages:
            path = run.folder.path
            if not run.finished:
                _console.print(self._overview(running=run))
                if run.samples:
                    resume_run(path)
                else:
                    self._discard(path)
                    start_run(run.config, self.path, run.stage.preset, path.name, previous, self.command)
                if not run.finished:  # interrupted; said already how to continue
                    return False
            previous = path
        _console.print(self._overview())
        return True

    def _overview(self, running: StageRun | None = None) -> str:
        """A line for each stage."""
        names = max(len(run.stage.name) for run in self.stages)
        presets = max(len(run.stage.preset) for run in self.stages)
        lines = []
        for number, run in enumerate(self.stages, start=1):
            state = "done" if run.finished else "running" if run is running else "to come"
            if run is running and run.samples:
                state += f", {run.samples / 1e6:.2f}M so far"
            if run.samples:
                state += f", {run.seconds() / 60:.1f} min"
            lines.append(
                f"{number:3d}  {run.stage.name:{names}}  preset {run.stage.preset:{presets}}  "
                f"{run.config.samples / 1e6:7.2f}M samples  {state}"
            )
        return "\n".join(lines)

    def _discard(self, path: Path) -> None:
        """Drop a run that was killed before its first checkpoint: there is nothing to continue.

        Raises:
            ValueError: the folder holds something else.
        """
        if not path.exists():
            return
        foreign = sorted({entry.name for entry in path.iterdir()} - _BEGUN) if path.is_dir() else [path.name]
        if foreign:
            raise ValueError(
                f"{path} has no checkpoint but holds {', '.join(foreign)}: move it away, or use another --runs"
            )
        shutil.rmtree(path)

    # -- the result ----------------------------------------------------------------------------------------------------

    def _judge(self) -> int:
        """Export the last stage's network and write its card."""
        *earlier, last = (run.folder.path for run in self.stages)
        policy = last / "policy.onnx"
        if not policy.is_file():  # killed in between
            export_run(last, policy)
        code = write_run_card(last, policy, None, self._suite_name, earlier)
        _console.print(f"policy: {policy}")
        return code

    # -- the folder ----------------------------------------------------------------------------------------------------

    def _check_folder(self) -> None:
        """Make sure that the runs there are of the recipe as it is now.

        Raises:
            ValueError: they are not; names the first that differs.
        """
        known = {run.folder.path.name for run in self.stages}
        for path in sorted(self.path.glob("[0-9][0-9]_*")):
            if path.name not in known:
                raise ValueError(
                    f"{path} is no stage of recipe {self.recipe.name}, whose stages are {', '.join(sorted(known))}; "
                    f"{_WAY_OUT}"
                )
        before: StageRun | None = None
        for run in self.stages:
            if run.samples:
                self._check_stage(run, before)
            before = run

    def _check_stage(self, run: StageRun, before: StageRun | None) -> None:
        path, trained = run.folder.path, RunFolder.open(run.folder.path).config()
        wanted = run.config  # what was left to the hardware was settled when the run began
        wanted = replace(wanted, library=wanted.library or trained.library, physics=wanted.physics or trained.physics)
        for where, here, there in differences(to_mapping(wanted), to_mapping(trained)):
            raise ValueError(f"{path} was trained with {where} = {there!r}, the recipe now says {here!r}; {_WAY_OUT}")
        origin = run.folder.origin()
        if origin["preset"] != run.stage.preset:
            raise ValueError(
                f"{path} was trained with preset = {origin['preset']!r}, the recipe now says {run.stage.preset!r}; "
                f"{_WAY_OUT}"
            )
        if before is None:
            return
        if not before.finished or origin["after"] != before.folder.history():
            raise ValueError(
                f"{path} was not trained after what is in {before.folder.path} now: move it away to train it anew, or "
                "use another --runs"
            )


_WAY_OUT = "undo the change, or train anew with another --runs"


def differences(ours: Any, theirs: Any, where: str = "") -> Iterator[tuple[str, Any, Any]]:
    """Where two configurations as plain data differ: place, our value, their value."""
    if isinstance(ours, dict) and isinstance(theirs, dict):
        for key in [*ours, *(key for key in theirs if key not in ours)]:
            yield from differences(ours.get(key), theirs.get(key), f"{where}.{key}" if where else key)
    elif ours != theirs:
        yield where, ours, theirs
