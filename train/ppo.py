"""Rounds of rsl-rl's proximal policy optimisation, on C physics or on a JAX engine.

With several ranks each collects from its own robots; see `train.ranks`.
"""

from __future__ import annotations

import time
from collections import defaultdict
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from asimov_gym.envs.walk_batch import Curriculum, WalkBatch, WalkStep
from train.config import PpoConfig
from train.figures import round_figures, step_figures
from train.learner import build_ppo, set_learning_rate, tensor, views
from train.loop import CAUTIOUS_RATE, TrainingLoop, checkpoint_of
from train.ranks import Ranks
from train.run_folder import RunFolder
from train.symmetry import MirrorSamples
from train.weights import NetworkWeights

if TYPE_CHECKING:
    from train.functional_batch import FunctionalBatch, FunctionalStep


class Trainer(TrainingLoop):
    """One training run with rsl-rl.

    Args:
        config: settings; the same on all ranks.
        folder: of the run. Only rank 0 reads and writes it, but for the states of diverged copies.
        ranks: the processes that train together; a single one by default.
    """

    def __init__(self, config: PpoConfig, folder: RunFolder, ranks: Ranks | None = None) -> None:
        super().__init__(config, folder, ranks)
        torch.manual_seed(config.seed)
        self.batch = self._batch()
        self.observations = views(*self.batch.reset(), self.ranks.device)
        self.ppo = build_ppo(self.batch, config.learner, self.observations, self.ranks)
        if not self.ranks.first:
            torch.manual_seed(self.ranks.seed(config.seed))  # the networks are equal, the exploration is not
        task = self.batch.task
        mirror = MirrorSamples(task.layout.mirror, task.privileged_mirror)
        self.mirror = mirror if config.learner.symmetry == "samples" else None

    def _batch(self) -> WalkBatch | FunctionalBatch:
        """This rank's robots."""
        config, threads = self.config, self.ranks.threads(self.config.threads)
        if config.physics in (None, "c"):
            return WalkBatch(
                config.walk,
                config.copies,
                config.profile,
                threads,
                self.ranks.seed(config.seed),
                curriculum=True,
                stagger=True,
                dump_dir=self.dump_folder(),
            )
        from train.functional_batch import FunctionalBatch

        return FunctionalBatch(config, self.ranks.rank * config.copies, self.dump_folder())

    def close(self) -> None:
        self.batch.close()

    # -- checkpoints ---------------------------------------------------------------------------------------------------

    def warm_start(self, other: RunFolder) -> None:
        """Begin with the networks of another run; of the same learner with its optimiser too."""
        library, learned = checkpoint_of(other, self.ranks, self.config.learner.warm_std)
        if library == "rsl_rl":
            alike = len(learned["optimizer_state_dict"]["param_groups"]) == len(self.ppo.optimizer.param_groups)
            wanted = {"actor": True, "critic": True, "optimizer": alike, "iteration": False, "rnd": False}
            self.ppo.load(learned, wanted, True)
            return
        for model, name in ((self.ppo.actor, "actor"), (self.ppo.critic, "critic")):
            model.load_state_dict(NetworkWeights.from_brax(learned, name).to_torch())

    def begin_with(self, actor: NetworkWeights) -> None:
        self.ppo.actor.load_state_dict(actor.to_torch())

    def learned(self) -> dict[str, Any]:
        return self.ppo.save()

    def actor_weights(self) -> NetworkWeights:
        return NetworkWeights.from_torch(self.ppo.actor.state_dict())

    def own(self) -> dict[str, Any]:
        device = self.ranks.device
        return {
            "batch": self.batch.snapshot(),
            "observations": self.observations.cpu(),
            "torch_rng": torch.get_rng_state(),
            "device_rng": None if device == "cpu" else torch.cuda.get_rng_state(device),
        }

    def restore(self, learned: dict[str, Any], own: dict[str, Any]) -> None:
        self.ppo.load(learned, None, True)
        self.batch.restore(own["batch"])
        self.observations = own["observations"].to(self.ranks.device)
        torch.set_rng_state(own["torch_rng"])
        if own["device_rng"] is not None:
            torch.cuda.set_rng_state(own["device_rng"], self.ranks.device)

    # -- a round -------------------------------------------------------------------------------------------------------

    def iterate(self) -> dict[str, float]:
        figures: dict[str, list[Any]] = defaultdict(list)
        calm: list[torch.Tensor] = []
        device, began = self.ranks.device, time.monotonic()
        with torch.inference_mode():
            for _ in range(self.config.learner.steps):
                if self.config.walk.calm_share > 0.0:
                    calm.append(tensor(self.batch.calm, device))
                step = self._step(self.ppo.act(self.observations))
                self.batch.advance_curriculum()
                self.observations = views(step.observation, step.privileged, device)
                done = tensor(step.terminated | step.truncated, device)
                time_outs = {"time_outs": tensor(step.truncated, device)}
                self.ppo.process_env_step(self.observations, tensor(step.reward, device), done, time_outs)
                for name, value in self._figures(step).items():
                    figures[name].append(value)
            collected = time.monotonic()
            self.ppo.calm = torch.stack(calm) if calm else None
            self.ppo.compute_returns(self.observations)
        self.batch.curriculum = Curriculum(**self.ranks.mean(vars(self.batch.curriculum)))
        if self.mirror is not None:
            self.mirror(self.ppo)
        self.ppo.entropy_coef = self.config.learner.entropy_at(self.progress.samples)
        self._hold_actor()
        losses = self.ppo.update()
        self.count_round()
        result = {name: float(np.mean(values)) for name, values in figures.items()}
        std = float(self.ppo.get_policy().output_std.detach().mean())
        result |= round_figures(losses, std, self.ppo.learning_rate, vars(self.batch.curriculum))
        result |= {"speed/collect_s": collected - began, "speed/learn_s": time.monotonic() - collected}
        result = self.ranks.mean(result)
        result["physics/diverged"] *= self.ranks.count  # a number of copies
        return result

    def _hold_actor(self) -> None:
        """Let the actor learn in this round, or not: see `LearnerConfig.critic_rounds`."""
        learner, round_number = self.config.learner, self.progress.iteration
        teaches = learner.teaches_actor(round_number)
        self.ppo.actor.requires_grad_(teaches)
        self.ppo.schedule = "adaptive" if teaches else "fixed"
        # Clipped, a critic that knows nothing yet would come nearer by 0.2 a round.
        self.ppo.use_clipped_value_loss = teaches and learner.critic_rate is None
        if learner.begins_actor(round_number):
            set_learning_rate(self.ppo, CAUTIOUS_RATE)

    def step_untaught(self) -> WalkStep | FunctionalStep:
        """A step of the robots from which nothing is learned."""
        with torch.inference_mode():
            step = self._step(self.ppo.get_policy()(self.observations, stochastic_output=True))
            self.observations = views(step.observation, step.privileged, self.ranks.device)
        return step

    def untaught_shares(self, steps: int = 8) -> dict[str, float]:
        sums: dict[str, float] = defaultdict(float)
        for _ in range(steps):
            for name, share in self.step_untaught().shares.items():
                sums[name] += float(share.mean()) / steps
        return dict(sums)

    def _step(self, action: torch.Tensor) -> WalkStep | FunctionalStep:
        if isinstance(self.batch, WalkBatch):
            return self.batch.step(action.cpu().numpy())
        return self.batch.step(action)

    def _figures(self, step: WalkStep | FunctionalStep) -> dict[str, Any]:
        """Figures of a step; those of a JAX engine stay on its device until the round is over."""
        batch = self.batch
        if not isinstance(step, WalkStep) or not isinstance(batch, WalkBatch):
            return step.figures  # type: ignore[union-attr]
        error = batch.state.mean_velocity - batch.state.command
        return step_figures(step.reward, step.terminated, batch.physics.diverged, error, step.shares)
