"""Makes the tables of `ablation.md` from the studies and their results; the words around them are written by hand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ablation_pictures import FOLDER
from markers import Table, filled, prose
from recipe_page import millions, time_on_two_cores

from asimov_gym.evaluation.suite import load_suite
from asimov_gym.evaluation.table import MISSING, counted, figure, number
from asimov_gym.presets import from_mapping, to_mapping
from train.ablation import Study, load_study, study_names
from train.ablation_figures import FEWEST, FIGURES
from train.ablation_result import AblationResult, Spread, VariantResult
from train.config import PpoConfig

PAGE = Path(__file__).resolve().parent / "ablation.md"
HIDDEN = ("smoke",)
"""Shipped studies that are not on the page."""
GROUPS: Mapping[str, tuple[str, ...]] = {
    "Following commands, and standing": (
        "survival_grid",
        "velocity_error",
        "yaw_rate_error",
        "velocity_rmse",
        "yaw_rate_rmse",
        "standing_drift",
    ),
    "What disturbs it": (
        "must_pass_pushes",
        "stretch_pushes",
        "largest_push",
        "survival_friction",
        "survival_ground",
        "survival_delay",
        "survival_noise",
    ),
    "How it walks, and how fast that was learned": (
        "cost_of_transport",
        "rated_torque",
        "action_jerk",
        "foot_clearance",
        "samples_to_stay_up",
        "samples_to_follow",
    ),
}
"""Tables of figures by title."""
NAMED = 6
"""Figures that a row of the first table names."""
Results = Mapping[str, AblationResult]
"""Those that are kept, by the name of the study."""


def load_results(folder: Path) -> dict[str, AblationResult]:
    """The results that are kept in a folder, by the name of the study.

    Raises:
        ValueError: one cannot be read, or is of no study on the page; names the file.
    """
    results = {path.stem: AblationResult.load(path) for path in sorted(folder.glob("*.json"))}
    for name, result in results.items():
        if name not in shown() or result.study.get("name") != name:
            raise ValueError(
                f"{folder / name}.json is a result of the study {result.study.get('name')!r}: the file must be named "
                f"after it, one of {', '.join(shown())}"
            )
    return results


def shown() -> list[str]:
    """Names of the studies on the page."""
    return [name for name in study_names() if name not in HIDDEN]


def page(results: Results, table: Table) -> str:
    """The page with its tables as they are now.

    Raises:
        ValueError: a study has no marker on the page, or a marker no study.
    """
    studies = {name: load_study(name) for name in shown()}
    made = {name: _section(study, results.get(name), table) for name, study in studies.items()}
    return filled(PAGE, {"studies": _studies(studies, results, table), "bounds": _bounds(table), **made})


def _studies(studies: Mapping[str, Study], results: Results, table: Table) -> str:
    rows = []
    for name, study in studies.items():
        runs, config, result = len(study.runs), study.config(study.base), results.get(name)
        known = "not measured yet" if result is None else f"{result.finished} of {result.planned} trainings"
        time = time_on_two_cores(*[config] * runs)
        samples = f"{runs} × {millions(study.samples)}"
        rows.append([f"`{name}`", study.about.rstrip("."), f"`{study.preset}`", samples, time, known])
    return table(["study", "asks", "preset", "samples", "two cores", "measured"], rows)


def _bounds(table: Table) -> str:
    rows = []
    for one in FIGURES.values():
        bounds = [f"{_amount(one.bound, one.unit)} {one.unit}".strip()] if one.bound else []
        bounds += [f"{100.0 * one.relative:.0f} % of the base's"] if one.relative else []
        bounds += [counted(FEWEST, "trial")] if one.is_share else []
        rows.append([one.title, " and ".join(bounds), f"{one.better} is better"])
    return table(["figure", "counts as different beyond", ""], rows)


# -- a study -----------------------------------------------------------------------------------------------------------


def _section(study: Study, result: AblationResult | None, table: Table) -> str:
    if result is None:
        start = " --warm-start RUN" if study.warm_start else ""
        rows = [[f"`{one.name}`", one.about] for one in study.all_variants]
        return (
            f"**Not measured yet.** This measures it, and keeps the result for this page:\n\n```sh\n"
            f"python -m train ablation {study.name}{start} --keep docs/{FOLDER}/{study.name}.json\n"
            f"python docs/generate.py\n```\n\n{table(['variant', 'what is taken away'], rows)}"
        )
    parts = [*(f"**{warning}**\n" for warning in _warnings(study, result)), _how(study, result), _worth(result, table)]
    for title, names in GROUPS.items():
        parts.append(f"{title}:\n\n{_figures(result, names, table)}")
    if any(one.trainings for one in result.variants):
        parts.append(f"![Learning curves of the study {study.name}]({FOLDER}/{study.name}.png)\n\n{_CAPTION}\n")
    return "\n".join(parts)


_CAPTION = prose(
    """While it trains: error of the mean velocity, and falls per minute. Grey: with everything. The robots explore
    here, and each variant has its own disturbances: one without kicks falls less because nothing kicks it. What the
    networks can do is in the tables."""
)


def _measured_with(base: PpoConfig, result: AblationResult) -> bool:
    """Whether these are the settings of the result, in which settings that did not exist yet have their default."""
    try:
        return from_mapping(PpoConfig, result.settings) == base
    except ValueError:  # it has settings that do not exist any more
        return False


def _warnings(study: Study, result: AblationResult) -> list[str]:
    """What a reader of the figures must know first."""
    found = []
    if result.finished < result.planned:
        found.append(f"Not complete: {result.finished} of {result.planned} trainings.")
    found += [f"The training `{name}` broke: {reason}" for name, reason in result.failures.items()]
    if result.study != to_mapping(study) or not _measured_with(study.config(study.base).scaled(result.scale), result):
        found.append("Measured with other settings than those of the study that is here now.")
    if result.scale != 1.0:
        found.append(f"Trained with {result.scale:g} times the study's samples.")
    if result.suite_hash != load_suite(study.suite).hash:
        found.append(f"Measured by another form of the suite `{result.suite}` than the one that is here now.")
    return found


def _how(study: Study, result: AblationResult) -> str:
    trainings = [one for variant in result.variants for one in variant.trainings]
    hours = sum(one.seconds for one in trainings) / 3600.0
    seeds = len({one.seed for variant in result.variants if variant is not result.base for one in variant.trainings})
    after = "".join(
        f" They begin with the networks of a run of {' and then '.join(stages)}."
        for stages in [[f"`{one['preset']}` ({millions(one['samples'])} samples)" for one in result.after]]
        if stages
    )
    spread = (
        f"The base was trained {result.repeats} times, so that what differs by chance is known."
        if result.repeats > 1
        else "There is one training of the base: nothing says what another would differ by."
    )
    commits = ", ".join(sorted({f"`{(one.commit or 'unknown')[:12]}`" for one in trainings}))
    versions = ", ".join(f"{name} {version}" for name, version in result.versions.items())
    return (
        prose(
            f"""The base, `all`, is the preset `{study.preset}` with {millions(result.settings["samples"])}
            samples.{after} Each variant was trained with {counted(seeds, "seed")}. {spread} All were judged by the
            suite `{result.suite}`. {counted(len(trainings), "training")}, {hours:.1f} hours of training on
            {result.machine}, at commit {commits}, with {versions}."""
        )
        + "\n"
    )


def _worth(result: AblationResult, table: Table) -> str:
    """What is worse and what is better without each ingredient, in words."""
    rows = []
    for variant in result.variants:
        if variant is result.base:
            continue
        verdicts = {name: result.judge(variant, name) for name in FIGURES}
        cells = [
            _listed([FIGURES[name].title for name, verdict in verdicts.items() if verdict == asked])
            for asked in ("worse", "better")
        ]
        rows.append([f"`{variant.name}`", variant.about, *cells])
    return table(["variant", "what is taken away", "worse without it", "better without it"], rows)


def _listed(titles: Sequence[str]) -> str:
    """The first ones, which the page has first, and how many more there are."""
    more = len(titles) - NAMED
    named = titles if more < 2 else [*titles[:NAMED], f"{more} more"]
    return ", ".join(named) or MISSING


def _figures(result: AblationResult, names: tuple[str, ...], table: Table) -> str:
    """A row for each variant, with the difference from the base; bold where it counts."""
    asked = [name for name in names if any(name in variant.figures for variant in result.variants)]
    header = ["variant", *(f"{FIGURES[name].title}{_in_units(name)}" for name in asked)]
    rows = [[f"`{one.name}`", *(_cell(result, one, name) for name in asked)] for one in result.variants]
    bounds = [result.tolerance(name) for name in asked]
    rows.append(
        ["counts beyond", *(_amount(bound, FIGURES[name].unit) for name, bound in zip(asked, bounds, strict=True))]
    )
    text = table(header, rows)
    if any("*" in cell.replace("**", "") for row in rows for cell in row):
        words = (
            "\\* Mean of the robots that have the figure: not of those that fell or, where it needs steps, made none."
        )
        text += f"\n{prose(words)}\n"
    return text


def _cell(result: AblationResult, variant: VariantResult, name: str) -> str:
    spread = variant.figures.get(name)
    if spread is None:
        return MISSING
    if spread.mean is None:
        words = "never" if FIGURES[name].unit == "M" else "none"
        return f"**{words}** worse" if result.judge(variant, name) == "worse" else words
    shown = _shown(spread, name)
    base = None if result.base is None else result.base.figures.get(name)
    if variant is not result.base and base is not None and base.mean is not None:
        shown += f" ({_amount(spread.mean - base.mean, FIGURES[name].unit, signed=True)})"
    verdict = result.judge(variant, name)
    return f"**{shown}** {verdict}" if verdict in ("better", "worse") else shown


def _shown(spread: Spread, name: str) -> str:
    """A mean, its range where there are several seeds, and a star where some robots do not have it."""
    unit = FIGURES[name].unit
    text = _amount(spread.mean, unit)
    if spread.seeds > 1:
        text += f" [{_amount(spread.low, unit)} to {_amount(spread.high, unit)}]"
    partly = not FIGURES[name].is_share and unit != "M" and spread.count < spread.whole
    return text + ("\\*" if partly else "")


def _in_units(name: str) -> str:
    unit = FIGURES[name].unit
    return f", {_UNITS.get(unit, unit)}" if unit else ""


_UNITS = {"M": "million"}


def _amount(value: Any, unit: str, signed: bool = False) -> str:
    """A figure, or the difference of two, without its unit."""
    if value is None:
        return MISSING
    sign = ("+" if value >= 0.0 else "−") if signed else ""
    size = abs(value) if signed else value
    if unit == "%":
        return f"{sign}{number(100.0 * size, 1)}"
    if unit == "M":
        return f"{sign}{number(size / 1e6, 2)}"
    if unit == "N":
        return f"{sign}{number(size, 0)}"
    return f"{sign}{number(size, 3)}" if unit in ("m/s", "rad/s", "m") else f"{sign}{figure(size, 2 if signed else 3)}"
