"""A policy's card: how it was trained, how long, its learning curves and its evaluation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from asimov_gym.evaluation.card import CardFigures
from asimov_gym.evaluation.report import markdown, summary
from asimov_gym.evaluation.results import SuiteResult
from asimov_gym.policy import PolicyRunner
from asimov_gym.policy.contract import PolicyContract
from train.hardware import machine
from train.run_folder import RunFolder

CURVES = (
    ("episode/length_s", "episode length, s"),
    ("episode/reward", "reward per second"),
    ("error/velocity", "velocity error, m/s"),
    ("error/yaw_rate", "turning error, rad/s"),
    ("policy/std", "exploration"),
    ("curriculum/kick", "kick level"),
)
"""Curves on the card: name in the run's curves, title."""
_LEARNERS = {None: "rsl-rl", "rsl_rl": "rsl-rl", "brax": "Brax"}
_ENGINES = {None: "C physics", "c": "C physics", "mjx": "MJX (jax)", "warp": "MJX (warp)"}


def read_curves(folder: RunFolder, names: Sequence[str] = tuple(name for name, _ in CURVES)) -> dict[str, np.ndarray]:
    """Samples and value of each round, (n, 2), of those of these curves that there are; by default those on the card.

    Raises:
        FileNotFoundError: the run has no curves.
    """
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    if not list((folder.path / "curves").glob("events.*")):
        raise FileNotFoundError(f"{folder.path} has no curves")
    events = EventAccumulator(str(folder.path / "curves"), size_guidance={"scalars": 0})
    events.Reload()
    known = set(events.Tags()["scalars"])
    return {
        name: np.array([(e.step, e.value) for e in events.Scalars(name)], dtype=float)
        for name in names
        if name in known
    }


def saved_curves(path: Path) -> dict[str, np.ndarray]:
    """Curves that `save_curves` wrote, as `read_curves` gives them.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: it holds no curves.
    """
    with path.open(encoding="utf-8") as lines:
        names = next(lines, "").strip().split(",")
    if names[0] != "samples" or len(names) < 2:
        raise ValueError(f"{path} holds no curves: its first line must be samples,NAME,..., got {','.join(names)!r}")
    rows = np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2)
    return {name: rows[:, [0, place]] for place, name in enumerate(names) if place > 0}


def joined_curves(folders: Sequence[RunFolder | Path]) -> dict[str, np.ndarray]:
    """Curves of runs that followed each other, on one axis of samples; a mean of runs has none. A path is that of a
    file with the curves of all runs so far."""
    parts: dict[str, list[np.ndarray]] = {name: [] for name, _ in CURVES}
    offset = 0.0
    for folder in folders:
        if isinstance(folder, RunFolder) and "mean_of" in folder.origin():
            continue
        curves = saved_curves(folder) if isinstance(folder, Path) else read_curves(folder)
        for name, rows in curves.items():
            parts[name].append(rows + np.array([offset, 0.0]))
        offset += max((float(rows[-1, 0]) for rows in curves.values()), default=0.0)
    return {name: np.concatenate(rows) for name, rows in parts.items() if rows}


def averaged_curves(curves: dict[str, np.ndarray], points: int = 200) -> dict[str, np.ndarray]:
    """The same curves, all with so many rows that are evenly apart; each value is the mean of the rounds around it."""
    ends = [(rows[0, 0], rows[-1, 0]) for rows in curves.values()]
    edges = np.linspace(min(first for first, _ in ends), max(last for _, last in ends), points + 1)
    middle = 0.5 * (edges[1:] + edges[:-1])
    result = {}
    for name, rows in curves.items():
        samples, values = rows.T
        counts, _ = np.histogram(samples, edges)
        sums, _ = np.histogram(samples, edges, weights=values)
        between = np.interp(middle, samples, values)  # where no round is
        result[name] = np.stack([middle, np.where(counts > 0, sums / np.maximum(counts, 1), between)], axis=1)
    return result


def plot_curves(curves: dict[str, np.ndarray], path: Path) -> None:
    """Draw the curves over samples, one small plot each."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(2, 3, figsize=(12, 6), constrained_layout=True)
    for axis, (name, title) in zip(axes.flat, CURVES, strict=True):
        if name in curves:
            samples, values = curves[name].T
            axis.plot(samples / 1e6, values, linewidth=1.0)
        axis.set_title(title, fontsize=10)
        axis.set_xlabel("million samples", fontsize=8)
        axis.grid(alpha=0.3)
    figure.savefig(path, dpi=90)
    pyplot.close(figure)


def save_curves(curves: dict[str, np.ndarray], path: Path) -> None:
    """Write curves whose rows are at the same samples as CSV."""
    names = [name for name, _ in CURVES if name in curves]
    columns = [curves[names[0]][:, 0], *(curves[name][:, 1] for name in names)]
    np.savetxt(
        path, np.stack(columns, axis=1), delimiter=",", header="samples," + ",".join(names), comments="", fmt="%.6g"
    )


def write_card(
    folder: RunFolder,
    policy: PolicyRunner,
    result: SuiteResult,
    path: Path,
    notes: str = "",
    earlier: Sequence[RunFolder | Path] = (),
    evaluation: Path | None = None,
) -> None:
    """Write `path` (Markdown), and beside it the curves (PNG and CSV) and the figures (JSON).

    Args:
        folder: the run.
        policy: its exported network.
        result: what a suite measured of it.
        path: the card.
        notes: what a reader should also know.
        earlier: the runs of the stages before, oldest first, for their curves; see `joined_curves`.
        evaluation: the result's run folder, for samples of the gait.
    """
    contract, config = policy.contract, folder.config()
    curves = averaged_curves(joined_curves([*earlier, folder]))
    plot_curves(curves, path.with_suffix(".curves.png"))
    save_curves(curves, path.with_suffix(".curves.csv"))
    CardFigures.of(result, evaluation).save(path.with_suffix(".json"))
    stages = "\n".join(_stage(number, stage) for number, stage in enumerate(folder.history(), start=1))
    ranges = ", ".join(
        f"{axis} {low:g} to {high:g}"
        for axis, (low, high) in zip(("vx", "vy", "wz"), contract.command_ranges, strict=True)
    )
    card = f"""# {path.stem}

| | |
|---|---|
| task | `Asimov-Walk-v0`, layout `{contract.observation.layout}` |
| learner | {_LEARNERS[config.library]} PPO on {_ENGINES[config.physics]}, {config.copies} copies |
| machine | {folder.origin().get("machine") or machine()} |
| network | {" × ".join(map(str, config.learner.hidden))} ELU, normaliser inside |
| gait clock | {contract.gait_frequency_hz} Hz |
| trained commands | {ranges} |
{_calibration(contract)}| robot | {contract.robot_revision}, model `{(contract.model_sha256 or "")[:12]}` |

## Training

{_how_it_was_made(folder)}

| stage | preset | samples | minutes | commit |
|---|---|---|---|---|
{stages}

![curves]({path.with_suffix(".curves.png").name})

## Evaluation

`asimov eval {result.policy_name} --suite {result.suite}` (hash `{result.suite_hash}`): evaluation physics with full
collisions, elliptic friction cone and dry joint friction, no rope; every scenario's own conditions are in the suite.

```
{summary(result)}
```

{markdown(result)}

{notes}"""
    path.write_text(card, encoding="utf-8")


def _stage(number: int, stage: Mapping[str, Any]) -> str:
    """A row of the table of stages."""
    if "mean_of" in stage:
        what, samples, minutes = f"the mean of stages {', '.join(map(str, stage['mean_of']))}", "–", "–"
    else:
        what, samples, minutes = f"`{stage['preset']}`", f"{stage['samples']:,}", f"{stage['seconds'] / 60:.0f}"
    return f"| {number} | {what} | {samples} | {minutes} | `{stage['commit']}` |"


def _calibration(contract: PolicyContract) -> str:
    """A row on the calibration of the commands, where there is one: see `train.calibration`."""
    known = (contract.training or {}).get("calibration")
    if known is None:
        return ""
    (planar, turning), (planar_after, turning_after) = known["before"], known["after"]
    return (
        f"| commands | calibrated with {known['commands']} walks: off by {planar:.3f} m/s and {turning:.3f} rad/s "
        f"before, {planar_after:.3f} and {turning_after:.3f} after, on walks that were held back |\n"
    )


def _how_it_was_made(folder: RunFolder) -> str:
    recipe = folder.origin().get("recipe")
    if recipe is not None:
        return f"Made by `{recipe}`, stage after stage."
    return "Each stage is `python -m train ppo --preset PRESET`, a later one with `--warm-start` and the run before it."
