"""Starting, continuing and exporting runs."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from rich.console import Console
from rich.progress import Progress, TaskID

from asimov_gym.evaluation.journal import HEADER_FILE
from asimov_gym.evaluation.report import summary, write_report
from asimov_gym.evaluation.results import SuiteResult
from asimov_gym.evaluation.runner import SuiteRun
from asimov_gym.evaluation.suite import Suite, load_suite
from asimov_gym.policy import PolicyRunner, load_policy
from asimov_gym.policy.contract import default_contract
from asimov_gym.robot.observation import observation_layout
from train.averaging import averaged
from train.calibration import Calibration, fit, measure
from train.card import write_card
from train.config import NEW_CRITIC_ROUNDS, PpoConfig
from train.export import export_onnx
from train.hardware import check, settled
from train.learner import load_actor
from train.loop import TrainingLoop
from train.policy_file import PolicyFile
from train.ranks import Ranks
from train.run_folder import RunFolder
from train.weights import NetworkWeights

CALIBRATION_FILE = "calibration.json"
"""In the folder of a run that was calibrated."""
_console = Console(soft_wrap=True, highlight=False, force_jupyter=False)


def start_run(
    config: PpoConfig,
    root: Path,
    preset: str,
    name: str,
    warm_start: Path | None = None,
    recipe: str | None = None,
) -> int:
    """Train in a new run folder, from the networks of another run if one is given; returns the exit code.

    `warm_start` is that run's folder, or a policy file: see `train.policy_file`. `recipe` is the command of the recipe
    or study that this is a part of: see `RunFolder.create`.
    """
    file = PolicyFile(warm_start) if warm_start is not None and warm_start.is_file() else None
    parent = None if warm_start is None or file is not None else RunFolder(warm_start)
    if file is not None and config.learner.critic_rounds is None:
        config = replace(config, learner=replace(config.learner, critic_rounds=NEW_CRITIC_ROUNDS))
    actor = None if file is None else file.actor(config)
    with Ranks.joined() as ranks:
        chosen, reason = ranks.from_first(lambda: settled(config))
        ranks = ranks.on(chosen.device)
        if ranks.first:
            _console.print(f"learner {chosen.library} on physics {chosen.physics}: {reason}", highlight=False)

        def create() -> Path:
            before = file if parent is None else RunFolder.open(parent.path)
            return RunFolder.create(root, preset, chosen, name, before, recipe).path

        folder = RunFolder(ranks.from_first(create))
        trainer = _trainer(chosen, folder, ranks)
        trainer.console.print(f"run folder: {folder.path}")
        if ranks.count > 1:
            trainer.console.print(f"{ranks.count} processes of {chosen.copies} copies each")
        if parent is not None:
            trainer.warm_start(parent)
        if actor is not None:
            trainer.begin_with(actor)
            rounds = chosen.learner.critic_rounds
            trainer.console.print(f"begins with the actor of {warm_start}; for {rounds} rounds only the critic learns")
        trainer.console.print(trainer.reward_table())
        complete = trainer.run()
    return _finish(folder, complete, ranks)


def resume_run(path: Path) -> int:
    """Continue a run with as many processes as started it; returns the exit code."""
    with Ranks.joined() as ranks:
        folder = RunFolder(path)

        def settings() -> PpoConfig:
            config = RunFolder.open(path).config()
            if "mean_of" in folder.origin():
                raise ValueError(f"{path} is a mean of runs: begin a new run with --warm-start {path}")
            check(config)
            return config

        config = ranks.from_first(settings)
        ranks = ranks.on(config.device)
        trainer = _trainer(config, folder, ranks)
        trainer.resume()
        trainer.console.print(f"continuing {folder.path} at {trainer.progress.samples / 1e6:.2f}M samples")
        complete = trainer.run()
    return _finish(folder, complete, ranks)


def _trainer(config: PpoConfig, folder: RunFolder, ranks: Ranks) -> TrainingLoop:
    """The trainer of the learner that the settings name; runs older than the choice are rsl-rl's on C physics."""
    torch.set_num_threads(ranks.threads(config.threads))
    if config.library != "brax":
        from train.ppo import Trainer

        if config.physics in ("mjx", "warp"):
            from train.devices import prepare_beside_torch

            prepare_beside_torch(ranks)
        return Trainer(config, folder, ranks)
    from train.devices import join

    join(ranks)
    from train.brax_ppo import BraxTrainer

    return BraxTrainer(config, folder, ranks)


def _finish(folder: RunFolder, complete: bool, ranks: Ranks) -> int:
    if not ranks.first:
        return 0
    if not complete:
        recipe = folder.origin().get("recipe")  # runs older than recipes do not have it
        _console.print(f"stopped; continue with:  {recipe or f'{ranks.command} resume {folder.path}'}")
        return 0
    return export_run(folder.path, None)


def calibration_of(folder: RunFolder) -> Calibration | None:
    """The command calibration of a run's newest checkpoint; None where there is none, or only one of an older one."""
    path = folder.path / CALIBRATION_FILE
    if not path.is_file():
        return None
    calibration = Calibration.load(path)
    return calibration if calibration.samples == folder.load_checkpoint()["progress"]["samples"] else None


def calibrate_run(path: Path) -> int:
    """Measure what a run's policy makes of commands, correct them in it, and export it; returns the exit code."""
    folder = RunFolder.open(path)
    samples = folder.load_checkpoint()["progress"]["samples"]
    with tempfile.TemporaryDirectory() as place:
        bare = Path(place) / "policy.onnx"
        export_run(path, bare, calibrated=False)
        policy = load_policy(bare)
        with Progress(console=_console, transient=True) as bar:
            task = bar.add_task("walking with constant commands", total=1.0)
            measured = measure(policy.infer, policy.contract, progress=lambda share: bar.update(task, completed=share))
    calibration = fit(measured, policy.contract, samples)
    calibration.save(folder.path / CALIBRATION_FILE)
    for what, unit, before, after in zip(
        ("velocity", "yaw rate"), ("m/s", "rad/s"), calibration.before, calibration.after, strict=True
    ):
        _console.print(f"{what} off by {before:.3f} {unit}, with the calibration {after:.3f} (commands held back)")
    return export_run(path, None)


def _after(first: torch.nn.Module, trained: Callable[[np.ndarray], np.ndarray]) -> Callable[[np.ndarray], np.ndarray]:
    def run(observations: np.ndarray) -> np.ndarray:
        with torch.inference_mode():
            return trained(first(torch.from_numpy(observations)).numpy())

    return run


def export_run(path: Path, output: Path | None, calibrated: bool = True) -> int:
    """Export the newest checkpoint of a run as ONNX, with its command calibration where it has one and `calibrated`;
    returns the exit code."""
    folder = RunFolder.open(path)
    config, origin, state = folder.config(), folder.origin(), folder.load_checkpoint()
    walk, samples = config.walk, state["progress"]["samples"]
    calibration = calibration_of(folder) if calibrated else None
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
            **({"mean_of": origin["mean_of"]} if "mean_of" in origin else {}),
            **({} if calibration is None else {"calibration": calibration.note()}),
        },
    )
    layout, learned, trained = observation_layout(walk.layout), state["learner"], None
    mean = averaged(state.get("average"))
    if config.library == "brax":
        from train import brax_networks

        networks = learned["networks"] if mean is None else mean.to_brax("actor")
        trained = brax_networks.load_actor(config.learner, layout, networks)
        weights = (mean or NetworkWeights.from_brax(learned, "actor")).to_torch()
    else:
        weights = learned["actor_state_dict"] if mean is None else mean.to_torch()
    actor = load_actor(config.learner, layout, weights)
    first = None
    if calibration is not None:
        first = calibration.module(walk.layout, walk.standing_threshold)
        trained = None if trained is None else _after(first, trained)
    report = export_onnx(actor, contract, output or folder.path / "policy.onnx", normaliser=first, trained=trained)
    made = f"a mean of {len(origin['mean_of'])} runs" if "mean_of" in origin else f"after {samples / 1e6:.2f}M samples"
    made += "" if calibration is None else ", commands calibrated"
    _console.print(
        f"exported {report.path}, {made}; largest difference from the trained network on "
        f"{report.samples} observations: {report.difference:.1e}"
    )
    return 0


def evaluation_place(folder: RunFolder, policy: PolicyRunner, suite: Suite) -> Path:
    """Where the evaluation of a run's policy by a suite is."""
    return folder.path / "evaluation" / f"{suite.name}_{suite.hash[:8]}_{policy.sha256[:8]}"


def evaluate_run(folder: RunFolder, policy: PolicyRunner, suite: Suite) -> tuple[SuiteResult, Path]:
    """Judge a run's exported policy by a suite, in the run's folder; returns the result and its folder.

    When it is stopped, the same call continues it; when it is finished, it says at once what came of it.
    """
    place = evaluation_place(folder, policy, suite)
    run = SuiteRun(policy, suite, place, resume=(place / HEADER_FILE).is_file())
    with Progress(console=_console, transient=True) as bar:
        tasks: dict[str, TaskID] = {}

        def show(stage: str, done: float, whole: float) -> None:
            if stage not in tasks:
                tasks[stage] = bar.add_task(stage, total=whole)
            bar.update(tasks[stage], completed=done)

        return run.execute(show), place


def write_run_card(
    path: Path, policy_file: Path | None, notes: Path | None, suite_name: str, earlier: Sequence[Path] = ()
) -> int:
    """Judge a run's exported policy by a suite and write its card beside the file; returns the exit code.

    When it is stopped, the same call continues it.
    """
    folder = RunFolder.open(path)
    policy_file = policy_file or folder.path / "policy.onnx"
    policy = load_policy(policy_file)
    text = notes.read_text(encoding="utf-8") if notes is not None else ""
    before = [run if run.suffix == ".csv" else RunFolder.open(run) for run in earlier]
    result, place = evaluate_run(folder, policy, load_suite(suite_name))
    page = write_report(result, place)
    card = policy_file.with_suffix(".md")
    write_card(folder, policy, result, card, text, before, place)
    _console.print(summary(result), highlight=False, markup=False)
    _console.print(f"report: {page}\ncard: {card}", highlight=False, markup=False)
    return 0
