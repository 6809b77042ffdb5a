"""Going through a recipe, stage after stage; interrupted at any time and gone on with by the same command.

A stage is a run like any other, in `<runs>/<recipe>/<number>_<stage>`, started and continued as `python -m train ppo`
and `resume` do it; the mean of the last ones, where the recipe asks for it, is beside them. What is there decides what
is left: nothing else is remembered.
"""

from __future__ import annotations

import shlex
import shutil
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from asimov_gym.evaluation.suite import load_suite
from train.calibration import MustWalk
from train.hardware import why_no_gpu
from train.mean_run import average_runs
from train.planned_run import STOPPED, WAY_OUT, PlannedRun, processes
from train.recipe import Recipe, Stage
from train.run_folder import RunFolder
from train.session import calibrate_run, calibration_of, export_run, write_run_card

_console = Console(soft_wrap=True, highlight=False, force_jupyter=False)


@dataclass(frozen=True)
class StageRun(PlannedRun):
    """A stage and its run."""

    stage: Stage


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
            StageRun(stage.preset, config, RunFolder(self.path / f"{number:02d}_{stage.name}"), stage)
            for number, (stage, config) in enumerate(zip(recipe.stages, recipe.scaled(scale), strict=True), start=1)
        )
        if (count := processes()) > 1:
            raise ValueError(
                f"a recipe trains in one process, got {count}: start its stages one by one with torchrun, see "
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
            return STOPPED

    # -- training ------------------------------------------------------------------------------------------------------

    def _train(self) -> bool:
        """Train the stages that are left; False when it was interrupted."""
        _console.print(f"recipe {self.recipe.name}: {self.recipe.about}")
        previous: Path | None = None
        for run in self.stages:
            if not run.finished:
                _console.print(self._overview(running=run))
                if not run.train(previous, self.command):
                    return False
            previous = run.folder.path
        _console.print(self._overview())
        return True

    def _overview(self, running: StageRun | None = None) -> str:
        """A line for each stage."""
        names = max(len(run.stage.name) for run in self.stages)
        presets = max(len(run.stage.preset) for run in self.stages)
        return "\n".join(
            f"{number:3d}  {run.stage.name:{names}}  preset {run.stage.preset:{presets}}  "
            f"{run.config.samples / 1e6:7.2f}M samples  {run.state(run is running)}"
            for number, run in enumerate(self.stages, start=1)
        )

    # -- the result ----------------------------------------------------------------------------------------------------

    def _judge(self) -> int:
        """Export the result and write its card."""
        *earlier, last = (run.folder.path for run in self.stages)
        result = last
        if self.recipe.averaged_stages > 1:
            earlier, result = [*earlier, last], self._mean().path
        policy = result / "policy.onnx"
        if self.recipe.calibrated and calibration_of(RunFolder(result)) is None:
            try:
                calibrate_run(result)
            except MustWalk as error:  # a card that says how bad it is is worth more than none
                _console.print(f"not calibrated: {error}")
        if not policy.is_file():  # killed in between
            export_run(result, policy)
        code = write_run_card(result, policy, None, self._suite_name, earlier)
        _console.print(f"policy: {policy}")
        return code

    def _mean(self) -> RunFolder:
        """The mean of the last stages, as a run."""
        numbered = list(enumerate(self.stages, start=1))[-self.recipe.averaged_stages :]
        folder = RunFolder(self.path / f"mean_{numbered[0][0]:02d}_{numbered[-1][0]:02d}")
        if folder.checkpoints():
            return folder
        if folder.path.exists():  # killed in between
            shutil.rmtree(folder.path)
        return average_runs([run.folder.path for _, run in numbered], self.path, folder.path.name, self.command)

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
                    f"{WAY_OUT}"
                )
        before: StageRun | None = None
        for run in self.stages:
            run.check("the recipe", None if before is None else before.folder)
            before = run
