"""Rounds of Brax's proximal policy optimisation on any engine.

With several ranks, or several devices of one, each device collects from robots of its own; see `train.devices`.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

from asimov_gym.envs.functional import FunctionalWalk

# isort: split
import jax
import numpy as np

from train.brax_learner import BraxPpo, Learned
from train.config import PpoConfig
from train.devices import Devices, rows_here, value_here
from train.figures import round_figures
from train.loop import CAUTIOUS_RATE, TrainingLoop, checkpoint_of
from train.ranks import Ranks
from train.run_folder import RunFolder
from train.trees import filled, named
from train.weights import VIEWS, NetworkWeights

_KNOWN_SAMPLES = 1_000_000
"""How many observations the normaliser counts as seen at most, where the actor is that of a policy file."""


class BraxTrainer(TrainingLoop):
    """One training run with Brax.

    Args:
        config: settings; the same on all ranks.
        folder: of the run. Only rank 0 reads and writes it, but for the states of diverged copies.
        ranks: the processes that train together; `train.devices.join` must have connected their JAX.

    Raises:
        ValueError: the copies cannot be divided among the devices.
    """

    def __init__(self, config: PpoConfig, folder: RunFolder, ranks: Ranks | None = None) -> None:
        super().__init__(config, folder, ranks)
        self.env = FunctionalWalk(
            config.walk,
            config.physics or "c",
            config.profile,
            self.ranks.threads(config.threads),
            curriculum=True,
            stagger=True,
            dump_dir=self.dump_folder(),
        )
        self.devices = Devices.all()
        copies = self.ranks.count * config.copies
        self.ppo = BraxPpo(self.env, config.learner, self.devices, copies, config.seed)
        self.learned_now, self.state = self.ppo.start()

    def close(self) -> None:
        """Nothing to stop: the physics threads end with the process."""

    # -- checkpoints ---------------------------------------------------------------------------------------------------

    def warm_start(self, other: RunFolder) -> None:
        """Begin with the networks of another run; of the same learner with its optimiser too."""
        library, learned = checkpoint_of(other, self.ranks, self.config.learner.warm_std)
        if library == "brax":
            self.learned_now = self._learned(learned)
            return
        networks: dict[str, np.ndarray] = {}
        for name in VIEWS:
            networks |= NetworkWeights.from_torch(learned[f"{name}_state_dict"]).to_brax(name)
        self.learned_now = self._learned(self.learned() | {"networks": networks})

    def begin_with(self, actor: NetworkWeights) -> None:
        now = self.learned()
        # One count serves both normalisers. With the actor's own, the critic's, which is new, would never get anywhere.
        known = replace(actor, samples=min(actor.samples, _KNOWN_SAMPLES))
        self.learned_now = self._learned(now | {"networks": now["networks"] | known.to_brax("actor")})

    def learned(self) -> dict[str, Any]:
        now = self.learned_now
        return {"networks": named(_tree(now), value_here), "optimiser": named(now.optimiser, value_here)}

    def actor_weights(self) -> NetworkWeights:
        return NetworkWeights.from_brax(self.learned(), "actor")

    def own(self) -> dict[str, Any]:
        return {"state": named(self.state, rows_here)}

    def restore(self, learned: dict[str, Any], own: dict[str, Any]) -> None:
        self.learned_now = self._learned(learned)
        here = jax.tree.map(lambda a: jax.ShapeDtypeStruct((self.config.copies, *a.shape[1:]), a.dtype), self.state)
        self.state = filled(here, own["state"], self.devices.divided)

    def _learned(self, learned: dict[str, Any]) -> Learned:
        """What `learned` took apart, on the devices."""
        shapes: Any = self.ppo.shapes()
        put = self.devices.same
        tree = filled(_tree(shapes), learned["networks"], put)
        actor, normaliser = dict(tree["actor"]), tree["normaliser"]
        policy = {"log_std": actor.pop("log_std"), "layers": actor}
        return Learned(
            networks=shapes.networks.replace(policy=policy, value={"layers": tree["critic"]}),
            normaliser=shapes.normaliser.replace(
                mean=normaliser["mean"],
                summed_variance=normaliser["variance"],
                std=normaliser["std"],
                count=normaliser["samples"],
                std_eps=put(np.float32(0.0)),
            ),
            optimiser=filled(shapes.optimiser, learned["optimiser"], put),
        )

    # -- a round -------------------------------------------------------------------------------------------------------

    def iterate(self) -> dict[str, float]:
        number, began = self.progress.iteration, time.monotonic()
        state, data, figures = self.ppo.collect(self.learned_now, self.state, number)
        jax.block_until_ready(state)
        collected = time.monotonic()
        learner = self.config.learner
        if learner.begins_actor(number):
            self.learned_now = self.ppo.at_rate(self.learned_now, CAUTIOUS_RATE)
        entropy, teaches = learner.entropy_at(self.progress.samples), learner.teaches_actor(number)
        self.learned_now, report = self.ppo.learn(self.learned_now, data, number, entropy, teaches)
        self.state = jax.block_until_ready(state)
        figures, report = jax.tree.map(lambda a: float(value_here(a)), (figures, report))
        learned = time.monotonic()
        self.count_round()
        losses = {name: report[name] for name in ("value", "surrogate", "entropy")}
        levels = figures.pop("levels")
        result = figures | round_figures(losses, report["std"], report["learning_rate"], levels)
        return result | {"speed/collect_s": collected - began, "speed/learn_s": learned - collected}

    def untaught_shares(self) -> dict[str, float]:
        began = time.monotonic()
        _, _, figures = self.ppo.collect(self.learned_now, self.state, -1)
        self.console.print(f"compiled for {self.devices.kind} in {time.monotonic() - began:.0f} s", highlight=False)
        figures = {name: value for name, value in figures.items() if name.startswith("reward/")}
        return {name.removeprefix("reward/"): float(value_here(value)) for name, value in figures.items()}


def _tree(learned: Learned) -> dict[str, Any]:
    """Networks and normaliser under the names that checkpoints have; see `train.weights`."""
    params: Any = learned.networks
    normaliser: Any = learned.normaliser
    figures = {"mean": normaliser.mean, "variance": normaliser.summed_variance, "std": normaliser.std}
    return {
        "actor": {**params.policy["layers"], "log_std": params.policy["log_std"]},
        "critic": params.value["layers"],
        "normaliser": figures | {"samples": normaliser.count},
    }
