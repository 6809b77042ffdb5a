"""Going through a study, training after training; interrupted at any time and gone on with by the same command.

A training is a run like any other, in `<runs>/<study>/<variant>_seed<seed>`, started, continued, exported and judged as
`python -m train ppo`, `resume`, `export` and `card` do it. What is there, and what the file to keep the result in has
from before, decides what is left: nothing else is remembered. After each one `ablation.json` says what is known so far.
"""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from asimov_gym.evaluation.results import RESULT_FILE as SUITE_RESULT
from asimov_gym.evaluation.results import SuiteResult, plain
from asimov_gym.evaluation.suite import load_suite
from asimov_gym.physics.memory import is_out_of_memory
from asimov_gym.policy import load_policy
from asimov_gym.presets import check_range, from_mapping, to_mapping
from asimov_gym.versions import installed_versions
from train.ablation import Study, Variant, changes, check_networks
from train.ablation_figures import CURVES, FIGURES, figures, kept_curves
from train.ablation_result import RESULT_FILE, AblationResult, TrainingResult, VariantResult
from train.card import read_curves
from train.config import PpoConfig
from train.hardware import check, machine
from train.planned_run import STOPPED, PlannedRun, processes
from train.run_folder import RunFolder, present_commit
from train.session import evaluate_run, evaluation_place, export_run

_LEARNERS = ("torch", "rsl-rl-lib", "jax", "brax")
_console = Console(soft_wrap=True, highlight=False, force_jupyter=False)


@dataclass(frozen=True)
class Training(PlannedRun):
    """One training of a variant."""

    variant: Variant
    seed: int


class AblationRun:
    """A study and its trainings.

    Args:
        study: what is compared.
        root: folder of runs; these are in one called after the study.
        only: names of the variants to train; all of them when empty.
        warm_start: run whose networks all begin with.
        scale: the samples of all trainings are multiplied by this.
        keep: file that the result is written to as well. Trainings that are in it already are not done again, and stay.
        source: how the study was asked for, a name or a file; its name when None.

    Raises:
        ValueError: a variant or the suite is unknown, the scale is out of range, a run to begin with is missing or
            does not fit, or what is in the folder, or in the file, is not of this study.
        FileNotFoundError: the run to begin with is not there.
    """

    def __init__(
        self,
        study: Study,
        root: Path,
        only: Sequence[str] = (),
        warm_start: Path | None = None,
        scale: float = 1.0,
        keep: Path | None = None,
        source: str | None = None,
    ) -> None:
        self.study, self.suite, self.path, self.keep = study, load_suite(study.suite), root / study.name, keep
        check_range("scale", scale, 1e-6, 1e3)
        names = [variant.name for variant in study.all_variants]
        if unknown := [name for name in only if name not in names]:
            raise ValueError(f"--only must name variants of {study.name}: {', '.join(names)}, got {unknown[0]!r}")
        if (count := processes()) > 1:
            raise ValueError(f"a study trains in one process, got {count}: start it without torchrun")
        flags = [] if root == Path("runs") else ["--runs", str(root)]
        flags += ["--only", *only] if only else []
        flags += [] if warm_start is None else ["--warm-start", str(warm_start)]
        flags += [] if scale == 1.0 else ["--scale", f"{scale:g}"]
        flags += [] if keep is None else ["--keep", str(keep)]
        self.command = shlex.join(["python", "-m", "train", "ablation", source or study.name, *flags])
        self._scale, self._parent = scale, self._checked_parent(warm_start)
        self.trainings = tuple(
            Training(
                study.preset,
                study.config(variant, seed).scaled(scale),
                RunFolder(self.path / f"{variant.name}_seed{seed}"),
                variant,
                seed,
            )
            for variant, seed in study.runs
        )
        for training in self.trainings:
            training.check("the study", self._parent)
        self.wanted = [one for one in self.trainings if not only or one.variant.name in only]
        self._kept = self._kept_trainings()
        self._judged: dict[str, tuple[TrainingResult, SuiteResult]] = {}
        self._broken: dict[str, str] = {}

    def _checked_parent(self, warm_start: Path | None) -> RunFolder | None:
        study = self.study
        if warm_start is None:
            if study.warm_start:
                raise ValueError(f"study {study.name} begins with the networks of a run: name it with --warm-start RUN")
            return None
        if not study.warm_start:
            raise ValueError(f"study {study.name} begins with new networks: --warm-start is not for it")
        parent = RunFolder.open(warm_start)
        if not parent.samples():
            raise ValueError(f"--warm-start {warm_start} has no checkpoint")
        check_networks(f"study {study.name}", study.config(study.base), parent.config(), str(warm_start))
        return parent

    def _kept_trainings(self) -> dict[str, TrainingResult]:
        """Trainings in the file that the result is kept in, by the names of their folders.

        Raises:
            ValueError: they are of another study; says what differs.
        """
        if self.keep is None or not self.keep.is_file():
            return {}
        kept, study = AblationResult.load(self.keep), self.study
        planned = {training.folder.path.name for training in self.trainings}
        found = {f"{one.name}_seed{run.seed}": run for one in kept.variants for run in one.trainings}
        asked = {variant.name: plain(self._changes(variant)) for variant in study.all_variants}
        settings = from_mapping(PpoConfig, dict(kept.settings), "settings")
        differs = [
            *(["the base's settings"] if settings != study.config(study.base).scaled(self._scale) else []),
            *(["scale"] if kept.scale != self._scale else []),
            *([f"suite {kept.suite}"] if kept.suite_hash != self.suite.hash else []),
            *(["the run to begin with"] if plain(kept.after) != plain(self._history()) else []),
            *(f"variant {one.name}" for one in kept.variants if plain(one.changes) != asked.get(one.name)),
            *sorted(set(found) - planned),
        ]
        if differs:
            raise ValueError(
                f"--keep {self.keep} has trainings of another study, it differs in {', '.join(differs)}: name another "
                "file, or move it away"
            )
        return found

    def _changes(self, variant: Variant) -> dict[str, Any]:
        """What a variant changes of the base, at this scale."""
        study = self.study
        if variant.name == study.base.name:
            return {}
        return changes(study.config(variant).scaled(self._scale), study.config(study.base).scaled(self._scale))

    def _history(self) -> tuple[Mapping[str, Any], ...]:
        """Stages of the run that all begin with."""
        return () if self._parent is None else tuple(self._parent.history())

    def execute(self) -> int:
        """Do what is left: train, export, judge, write the result. Returns the exit code."""
        _console.print(f"study {self.study.name}: {self.study.about}")
        try:
            for training in self.wanted:
                if not self._is_kept(training) and not self._do(training):
                    return 0  # said already how to continue
        except KeyboardInterrupt:
            _console.print(f"\nstopped; continue with:  {self.command}")
            return STOPPED
        _console.print(self._overview())
        written = self.path / RESULT_FILE
        _console.print(f"result: {written if written.is_file() else self.keep}")
        for name, reason in self._broken.items():
            _console.print(f"{name} broke: {reason}")
        return 1 if self._broken else 0

    # -- a training ----------------------------------------------------------------------------------------------------

    def _is_kept(self, training: Training) -> bool:
        """Whether the file has a training whose run is gone."""
        return training.folder.path.name in self._kept and not training.folder.path.exists()

    def _do(self, training: Training) -> bool:
        """Train, export and judge, as far as that is left; False when it was interrupted."""
        path = training.folder.path
        try:
            if not self._train(training):
                return False
        except (ValueError, RuntimeError) as error:  # as of a variant that learns infinite weights
            if is_out_of_memory(error) or not (path / "curves").exists():
                raise
            self._broken[path.name] = " ".join(str(error).split())[:300]
            _console.print(f"{path.name} broke, going on with the next: {self._broken[path.name]}")
        else:
            if self._known(training) is None:
                _console.print(f"judging {path.name} by the suite {self.suite.name}")
                result, place = evaluate_run(training.folder, load_policy(path / "policy.onnx"), self.suite)
                result.save(place)
        self._write()
        return True

    def _train(self, training: Training) -> bool:
        """Train and export, as far as that is left; False when it was interrupted."""
        path = training.folder.path
        if not training.finished:
            _console.print(self._overview(running=training))
            check(training.config)
            if not training.train(None if self._parent is None else self._parent.path, self.command):
                return False
        if not (path / "policy.onnx").is_file():  # killed in between
            export_run(path, None)
        return True

    def _known(self, training: Training) -> tuple[TrainingResult, SuiteResult] | None:
        """What is known of a training; None before it is judged."""
        folder, name = training.folder, training.folder.path.name
        policy = folder.path / "policy.onnx"
        if name not in self._judged and training.finished and policy.is_file():
            place = evaluation_place(folder, load_policy(policy), self.suite)
            if (place / SUITE_RESULT).is_file() and (result := SuiteResult.load(place)).complete:
                self._judged[name] = self._training_result(training, result), result
        return self._judged.get(name)

    @staticmethod
    def _training_result(training: Training, result: SuiteResult) -> TrainingResult:
        curves, origin = read_curves(training.folder, tuple(CURVES.values())), training.folder.origin()
        return TrainingResult(
            seed=training.seed,
            samples=training.samples,
            seconds=round(training.seconds(), 1),
            commit=origin["commit"],
            machine=origin["machine"],
            policy_hash=result.policy_hash,
            figures=figures(result, curves),
            curve=kept_curves(curves),
        )

    # -- the result ----------------------------------------------------------------------------------------------------

    def _write(self) -> None:
        """What is known so far, of all variants: those that were not asked for today too."""
        judged = {one.folder.path.name: found for one in self.trainings if (found := self._known(one)) is not None}
        if not judged:
            return
        study, base = self.study, self.study.config(self.study.base).scaled(self._scale)
        known = self._kept | {name: result for name, (result, _) in judged.items()}
        variants = []
        for variant in study.all_variants:
            names = [one.folder.path.name for one in self.trainings if one.variant.name == variant.name]
            if mine := [known[name] for name in names if name in known]:
                variants.append(VariantResult.of(variant.name, variant.about, self._changes(variant), mine))
        suite = list(judged.values())[-1][1]
        result = AblationResult(
            study=to_mapping(study),
            settings=to_mapping(base),
            scale=self._scale,
            suite=self.suite.name,
            suite_hash=self.suite.hash,
            machine=machine(),
            versions={**suite.versions, **installed_versions(_LEARNERS)},
            commit=present_commit(),
            planned=len(self.trainings),
            variants=tuple(variants),
            after=self._history(),
            failures=self._broken,
        )
        for path in (self.path / RESULT_FILE, self.keep):
            if path is not None:
                result.save(path)

    def _overview(self, running: Training | None = None) -> str:
        """A line for each training."""
        names = max(len(one.variant.name) for one in self.wanted)
        return "\n".join(
            f"{one.variant.name:{names}}  seed {one.seed}  {one.config.samples / 1e6:6.2f}M samples  "
            f"{self._state(one, running)}"
            for one in self.wanted
        )

    def _state(self, training: Training, running: Training | None) -> str:
        if training.folder.path.name in self._broken:
            return "broke"
        if self._is_kept(training):
            return f"in {self.keep}"
        state = training.state(training is running)
        known = self._known(training)
        if known is None:
            return state
        shown = [name for name in ("survival_grid", "velocity_error") if name in known[0].figures]
        values = {FIGURES[name].title: known[0].figures[name].value for name in shown}
        return ", ".join([state, *(f"{title} {value:.3g}" for title, value in values.items() if value is not None)])
