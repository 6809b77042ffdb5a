"""The mean of the networks that successive runs ended with, as a run of its own.

Runs that went on from each other with other settings have forgotten different things, and their mean makes fewer errors
than each of them (Wortsman et al. 2022, "Model soups", ICML). `train.averaging` does the same within a run.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from train.averaging import averaged, mean_of
from train.run_folder import RunFolder
from train.weights import NetworkWeights


def average_runs(paths: Sequence[Path], root: Path, name: str, recipe: str | None = None) -> RunFolder:
    """Make a run whose actor is the mean of what successive runs export; everything else is the last one's.

    It can be exported, judged, seen and warm-started from like any other, but not resumed.

    Args:
        paths: of two runs or more, oldest first, each warm-started from the one before, or from one in between.
        root: folder of runs.
        name: of the new one.
        recipe: see `RunFolder.create`.

    Raises:
        ValueError: there are fewer than two, or one does not come from the networks of the one before.
        FileNotFoundError: one is not a run, or has no checkpoint.
    """
    runs = [RunFolder.open(path) for path in paths]
    if len(runs) < 2:
        raise ValueError(f"runs must be two or more to have a mean, got {len(runs)}")
    histories = [run.history() for run in runs]
    for run, before, known in zip(runs[1:], runs, histories, strict=False):
        if (run.origin()["after"] or [])[: len(known)] != known:
            raise ValueError(
                f"{run.path} does not come from the networks that {before.path} ends with: the runs must be "
                "successive, oldest first"
            )
    last, state = runs[-1], runs[-1].load_checkpoint()
    mean = mean_of([exported_actor(run) for run in runs])
    learned = dict(state["learner"])
    if last.config().library == "brax":
        learned["networks"] = {**learned["networks"], **mean.to_brax("actor")}
    else:
        learned["actor_state_dict"] = {**learned["actor_state_dict"], **mean.to_torch()}
    origin = last.origin()
    folder = RunFolder.create(
        root, origin["preset"], last.config(), name, last, recipe, mean_of=[len(history) for history in histories]
    )
    progress = {**state["progress"], "samples": 0, "seconds": 0.0}
    folder.save_checkpoint(0, {"learner": learned, "progress": progress}, keep=1)
    return folder


def exported_actor(folder: RunFolder) -> NetworkWeights:
    """The actor that a run's export writes: that of its newest checkpoint, or the mean over its last rounds."""
    state: dict[str, Any] = folder.load_checkpoint()
    mean = averaged(state.get("average"))
    if mean is not None:
        return mean
    if folder.config().library == "brax":
        return NetworkWeights.from_brax(state["learner"], "actor")
    return NetworkWeights.from_torch(state["learner"]["actor_state_dict"])
