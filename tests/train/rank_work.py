"""What each of two processes does for `test_ranks`: train together, stop, lose one."""

from __future__ import annotations

import os
import signal
import sys
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import torch

from train.__main__ import main
from train.config import LearnerConfig, PpoConfig
from train.ppo import Trainer
from train.ranks import Ranks
from train.run_folder import RunFolder

COPIES = 12
CONFIG = PpoConfig(copies=COPIES, samples=10_000, threads=1, learner=LearnerConfig(steps=8, hidden=(32, 16)))
ONE_STEP = replace(CONFIG, learner=replace(CONFIG.learner, epochs=1, minibatches=1))
"""One gradient step per update, so that it can be compared."""
FLAGS = ["ppo", "--preset", "smoke", "--copies", "16", "--threads", "1", "--learner.steps", "8"]
DIED = 9
"""Exit code of the process that is lost."""


def learn_once(folder: RunFolder, ranks: Ranks) -> dict[str, Any]:
    """An update, and everything that went into it."""
    trainer = Trainer(ONE_STEP, folder, ranks)
    for _ in range(2):
        trainer.iterate()
    ppo, seen = trainer.ppo, {}
    seen["before"] = {name: clone(state) for name, state in ppo.save().items() if name != "optimizer_state_dict"}
    update = ppo.update

    def spy() -> dict[str, float]:
        st = ppo.storage
        names = ("actions", "rewards", "dones", "values", "actions_log_prob", "advantages")
        seen["storage"] = {name: getattr(st, name).clone() for name in names}
        seen["storage"] |= {"observations": st.observations.clone(), "distribution_params": st.distribution_params}
        seen["last"], seen["entropy"] = trainer.observations.clone(), ppo.entropy_coef
        return update()

    ppo.update = spy  # type: ignore[method-assign]
    seen["figures"] = trainer.iterate()
    seen["after"] = {name: clone(state) for name, state in ppo.save().items() if name != "optimizer_state_dict"}
    seen["gradients"] = [p.grad for model in (ppo.actor, ppo.critic) for p in model.parameters()]
    seen["rate"], seen["samples"] = ppo.learning_rate, trainer.progress.samples
    seen["curriculum"] = asdict(trainer.batch.curriculum)
    trainer.batch.close()
    return seen


def clone(state: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """A copy that learning does not change."""
    return {name: value.clone() for name, value in state.items()}


def interrupted_and_whole(root: Path, ranks: Ranks) -> dict[str, Any]:
    """Weights and observations after four updates, in one go and with a stop in between."""
    whole = Trainer(CONFIG, RunFolder(root / "whole"), ranks)
    for _ in range(4):
        whole.iterate()
    folder = RunFolder(ranks.from_first(lambda: RunFolder.create(root, "parts", CONFIG).path))
    first = Trainer(CONFIG, folder, ranks)
    for _ in range(2):
        first.iterate()
    first.save()
    second = Trainer(CONFIG, folder, ranks)
    second.resume()
    for _ in range(2):
        second.iterate()
    result = {}
    for name, trainer in (("whole", whole), ("parts", second)):
        result[name] = (clone(trainer.ppo.get_policy().state_dict()), trainer.observations["actor"])
        trainer.batch.close()
    return result


def at_second_iteration(act: Any) -> None:
    """Let something happen in the middle of the runs that follow."""
    iterate = Trainer.iterate

    def spy(self: Trainer) -> dict[str, float]:
        if self.progress.iteration == 1:
            act()
        return iterate(self)

    Trainer.iterate = spy  # type: ignore[method-assign]


def work(root: Path) -> int:
    """All of it; the exit code is that of the run that loses a process."""
    with Ranks.joined() as ranks:
        torch.set_num_threads(1)
        seen = {"once": learn_once(RunFolder(root / "once"), ranks)}
        seen["resume"] = interrupted_and_whole(root, ranks)
        torch.save(seen, root / f"seen_{ranks.rank}.pt")
    flags = [*FLAGS, "--runs", str(root)]
    if ranks.rank == 1:
        at_second_iteration(lambda: os.kill(os.getpid(), signal.SIGINT))
    os.environ["MASTER_PORT"] = os.environ["SECOND_PORT"]
    assert main([*flags, "--name", "stopped"]) == 0
    if ranks.rank == 1:
        at_second_iteration(lambda: os._exit(DIED))
    os.environ["MASTER_PORT"] = os.environ["THIRD_PORT"]
    return main([*flags, "--name", "lost"])


if __name__ == "__main__":
    sys.exit(work(Path(sys.argv[1])))
