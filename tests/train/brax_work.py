"""What each of two processes does for `test_brax_ranks`: train together, and stop in between."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from train.config import LearnerConfig, PpoConfig
from train.devices import join
from train.ranks import Ranks
from train.run_folder import RunFolder

# isort: split
import numpy as np
import torch

COPIES = 16
"""Of all processes together."""
LEARNER = LearnerConfig(steps=8, hidden=(32, 16))


def settings(processes: int) -> PpoConfig:
    """Of a tiny run whose copies are divided among so many processes."""
    return PpoConfig(
        library="brax", physics="c", copies=COPIES // processes, samples=10_000, threads=1, learner=LEARNER
    )


def work(root: Path) -> None:
    """Two rounds with a checkpoint in between, and the second one again from the checkpoint."""
    from train.brax_ppo import BraxTrainer

    torch.set_num_threads(1)
    with Ranks.joined() as ranks:
        join(ranks)
        config = settings(ranks.count)
        folder = RunFolder(ranks.from_first(lambda: RunFolder.create(root, "pair", config).path))
        whole = BraxTrainer(config, folder, ranks)
        figures = [whole.iterate()]
        whole.save()
        figures.append(whole.iterate())
        again = BraxTrainer(config, folder, ranks)
        again.resume()
        again.iterate()
        seen: dict[str, Any] = {"figures": figures}
        for name, trainer in (("whole", whole), ("again", again)):
            seen[name] = {"learned": trainer.learned(), "own": trainer.own()}
        torch.save(seen, root / f"seen_{ranks.rank}.pt")


def compare(ours: dict[str, np.ndarray], theirs: dict[str, np.ndarray]) -> float:
    """Largest difference of two dictionaries of arrays."""
    assert list(ours) == list(theirs)
    return max(float(np.abs(np.float64(ours[name]) - theirs[name]).max(initial=0.0)) for name in ours)


if __name__ == "__main__":
    work(Path(sys.argv[1]))
