"""`python -m train ppo | recipe | ablation | resume | average | calibrate | export | card`: the MOVE/POLICY network."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from asimov_gym.physics.memory import is_out_of_memory

_EXTRAS = {
    "train": ("torch", "rsl_rl", "tensordict", "tensorboard", "onnx", "onnxscript"),
    "brax": ("brax", "flax", "optax", "jax"),
}
"""Packages that each extra brings."""
_MISSING = (
    "{what} needs the extra packages of `asimov-gym[{extra}]`, and {name!r} is not installed.\n"
    "Install them with:  pip install 'asimov-gym[{extra}]'   (in a checkout: pip install -e '.[{extra}]'{or_make})"
)


@dataclass(frozen=True)
class Resume:
    """Continue a run from its newest checkpoint."""

    run: tyro.conf.Positional[Path]
    """Folder of the run."""


@dataclass(frozen=True)
class Export:
    """Export a run's newest checkpoint as ONNX, checked against the network on a thousand observations."""

    run: tyro.conf.Positional[Path]
    """Folder of the run."""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """File to write; `policy.onnx` in the run's folder when omitted."""


@dataclass(frozen=True)
class Average:
    """Make a run of the mean of what successive runs export: it has forgotten less than each of them."""

    runs: tyro.conf.Positional[tuple[Path, ...]]
    """Folders of the runs, oldest first, each warm-started from the one before or from one in between."""
    name: str = "mean"
    """Name of the new run."""
    root: Annotated[Path, tyro.conf.arg(name="runs")] = Path("runs")
    """Folder that holds the runs."""


@dataclass(frozen=True)
class Calibrate:
    """Measure which velocities follow a run's commands, and put the correction into its policy file as a first layer.
    Training goes on without it: calibrate again afterwards."""

    run: tyro.conf.Positional[Path]
    """Folder of the run."""


@dataclass(frozen=True)
class Card:
    """Evaluate a run's exported policy and write its card beside it: figures, curves and how it was made."""

    run: tyro.conf.Positional[Path]
    """Folder of the run."""
    policy: Path | None = None
    """Exported network; `policy.onnx` in the run's folder when omitted."""
    notes: Path | None = None
    """Markdown to put on the card."""
    earlier: tuple[Path, ...] = ()
    """Runs of the stages before, oldest first; their curves go on the card too. A policy's `.curves.csv` stands for all
    runs that led to it."""
    suite: str = "standard"
    """Suite to judge it by: a name, or a YAML file."""


@dataclass(frozen=True)
class RecipeFlags:
    """Make a policy from nothing: train the stages of a recipe one after the other, export, write the card. The same
    command goes on where it stopped. Without a name the recipes are listed."""

    name: tyro.conf.Positional[str | None] = None
    """Recipe: a name, or a YAML file."""
    runs: Path = Path("runs")
    """Folder that holds the runs; those of the recipe are in one of its name."""
    scale: float = 1.0
    """Multiplies the samples of all stages."""
    suite: str = "quick"
    """Suite to judge the result by: a name, or a YAML file."""


@dataclass(frozen=True)
class AblationFlags:
    """Find out what each ingredient is worth: train with everything, and again without one thing at a time, and judge
    each by a suite. The same command goes on where it stopped. Without a name the studies are listed."""

    name: tyro.conf.Positional[str | None] = None
    """Study: a name, or a YAML file."""
    runs: Path = Path("runs")
    """Folder that holds the runs; those of the study, and its result, are in one of its name."""
    only: tuple[str, ...] = ()
    """Variants to train; all of them when omitted. `all` is the one with everything."""
    warm_start: Path | None = None
    """Run whose networks all trainings begin with, where the study asks for one."""
    scale: float = 1.0
    """Multiplies the samples of all trainings."""
    keep: Path | None = None
    """File that the result is written to as well, such as docs/ablations/NAME.json."""


def _ppo(arguments: list[str]) -> int:
    """Train a walking policy with PPO."""
    from train.config import PpoConfig, load_preset, preset_names
    from train.session import resume_run, start_run

    @dataclass(frozen=True)
    class Start:
        """Where to put the run and what to start from."""

        preset: str = "laptop"
        """Preset whose values are the defaults of all other flags."""
        warm_start: Path | None = None
        """Run whose networks this one starts with, or a policy file: its actor, and a critic that is learned anew."""
        resume: Path | None = None
        """Continue this run instead; other flags are ignored."""
        runs: Path = Path("runs")
        """Folder that holds the runs."""
        name: str | None = None
        """Name of the run; the preset's when omitted."""

    wants_help = bool({"-h", "--help"} & set(arguments))
    start, rest = tyro.cli(Start, args=[a for a in arguments if a not in ("-h", "--help")], return_unknown_args=True)
    if start.resume is not None:
        return resume_run(start.resume)
    preset = load_preset(start.preset)
    if wants_help:
        print(f"Presets: {', '.join(preset_names())} (--preset NAME).")
        print("Run: --name NAME, --runs DIR, --warm-start RUN|FILE, --resume RUN.\n")
    config = tyro.cli(
        PpoConfig, args=[*rest, *(["--help"] if wants_help else [])], default=preset, prog="python -m train ppo"
    )
    return start_run(config, start.runs, start.preset, start.name or start.preset, start.warm_start)


def _resume(arguments: list[str]) -> int:
    from train.session import resume_run

    return resume_run(tyro.cli(Resume, args=arguments, prog="python -m train resume").run)


def _export(arguments: list[str]) -> int:
    from train.session import export_run

    export = tyro.cli(Export, args=arguments, prog="python -m train export")
    return export_run(export.run, export.output)


def _average(arguments: list[str]) -> int:
    from train.mean_run import average_runs
    from train.session import export_run

    average = tyro.cli(Average, args=arguments, prog="python -m train average")
    folder = average_runs(average.runs, average.root, average.name)
    print(f"run folder: {folder.path}")
    return export_run(folder.path, None)


def _calibrate(arguments: list[str]) -> int:
    from train.session import calibrate_run

    return calibrate_run(tyro.cli(Calibrate, args=arguments, prog="python -m train calibrate").run)


def _card(arguments: list[str]) -> int:
    from train.session import write_run_card

    card = tyro.cli(Card, args=arguments, prog="python -m train card")
    return write_run_card(card.run, card.policy, card.notes, card.suite, card.earlier)


def _recipe(arguments: list[str]) -> int:
    from train.recipe import load_recipe, recipe_names

    flags = tyro.cli(RecipeFlags, args=arguments, prog="python -m train recipe")
    if flags.name is None:
        recipes = [load_recipe(name) for name in recipe_names()]
        for recipe in recipes:
            stages = f"{len(recipe.stages)} stages, {recipe.samples / 1e6:.2f}M samples"
            print(f"{recipe.name:{max(len(r.name) for r in recipes)}}  {stages:28}  {recipe.about}")
        return 0
    recipe = load_recipe(flags.name)
    from train.recipe_run import RecipeRun

    return RecipeRun(recipe, flags.runs, flags.scale, flags.suite, flags.name).execute()


def _ablation(arguments: list[str]) -> int:
    from train.ablation import load_study, study_names

    flags = tyro.cli(AblationFlags, args=arguments, prog="python -m train ablation")
    if flags.name is None:
        for study in map(load_study, study_names()):
            start = ", --warm-start RUN" if study.warm_start else ""
            print(f"{study.name}: {len(study.runs)} trainings of {study.samples / 1e6:.2f}M samples{start}")
            print(f"  {study.about}")
            for variant in study.all_variants:
                print(f"    {variant.name:{max(len(v.name) for v in study.all_variants)}}  {variant.about}")
        return 0
    study = load_study(flags.name)
    from train.ablation_run import AblationRun

    run = AblationRun(study, flags.runs, flags.only, flags.warm_start, flags.scale, flags.keep, flags.name)
    return run.execute()


_COMMANDS = {
    "ppo": _ppo,
    "recipe": _recipe,
    "ablation": _ablation,
    "resume": _resume,
    "average": _average,
    "calibrate": _calibrate,
    "export": _export,
    "card": _card,
}


def main(arguments: list[str] | None = None) -> int:
    """Run a command and return its exit code."""
    arguments = sys.argv[1:] if arguments is None else arguments
    if not arguments or arguments[0] in ("-h", "--help"):
        print("usage: python -m train {ppo,recipe,ablation,resume,average,calibrate,export,card} [flags]\n")
        print("  ppo       train a walking policy (see: python -m train ppo --help)")
        print("  recipe    make a policy from nothing, in several stages (alone: lists the recipes)")
        print("  ablation  find out what each ingredient is worth (alone: lists the studies)")
        print("  resume    continue a run from its newest checkpoint")
        print("  average   make a run of the mean of successive runs' networks")
        print("  calibrate let a run's policy do what commands ask, instead of a little less")
        print("  export    write a run's network as ONNX")
        print("  card      evaluate a run's network and write its card")
        return 0 if arguments else 2
    if arguments[0] not in _COMMANDS:
        print(f"unknown command {arguments[0]!r}; known commands: {', '.join(_COMMANDS)}", file=sys.stderr)
        return 2
    try:
        return _COMMANDS[arguments[0]](arguments[1:])
    except ModuleNotFoundError as error:
        name = (error.name or "").partition(".")[0]
        extra = next((extra for extra, packages in _EXTRAS.items() if name in packages), None)
        if extra is None and name:
            raise
        what, or_make = ("Training", ", or `make train`") if extra == "train" else ("The learner brax", "")
        words = _MISSING.format(what=what, extra=extra, name=name, or_make=or_make) if extra else str(error)
        print(words, file=sys.stderr)
        return 2
    except (ValueError, FileNotFoundError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except (MemoryError, RuntimeError) as error:
        if not is_out_of_memory(error):
            raise
        first = (str(error).splitlines() or [""])[0]
        print(f"error: the run does not fit into memory, use fewer --copies ({first})", file=sys.stderr)
        return 1
    except ConnectionError as error:  # `train.ranks.RankLost`, whose module brings torch
        print(f"error: {error}", file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main())
