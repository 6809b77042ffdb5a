"""Settings of a training run; presets are YAML files of this shape in `configs/train`."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Annotated

import tyro

from asimov_gym.assets import config_path
from asimov_gym.physics import PROFILES
from asimov_gym.physics.profile import ENGINES
from asimov_gym.presets import check_interval, check_range, load, shipped_names
from asimov_gym.robot.observation import observation_layout
from asimov_gym.tasks.walk import WalkConfig

LIBRARIES = ("brax", "rsl_rl")
"""Learners by the library that they are made of."""


NEW_CRITIC_ROUNDS = 80
"""`critic_rounds` of a run that begins with a policy file: two minutes on two cores."""


@dataclass(frozen=True)
class LearnerConfig:
    """Proximal policy optimisation."""

    hidden: tuple[int, ...] = (256, 128, 128)
    """Widths of the hidden layers of actor and critic."""
    initial_std: float = 1.0
    """Standard deviation of exploration at the start, in action units. Half of it learns to stand and never to step."""
    warm_std: tuple[float, float] | None = None
    """Least and largest standard deviation of exploration after a warm start; what the other run ended with when
    omitted. A policy that has settled tries too little to find an answer to something new, as a harder push; one that
    explores widely does not learn to be exact."""
    steps: int = 24
    """Policy steps of each copy per update."""
    epochs: int = 4
    minibatches: int = 4
    gamma: float = 0.985
    lam: float = 0.95
    learning_rate: float = 1e-3
    """First learning rate; it adapts to `desired_kl`."""
    critic_rate: float | None = None
    """Learning rate of the critic, whose loss is then not clipped; when omitted that of the actor, and the loss is
    clipped by `clip`. Where the actor explores little its rate falls to 1e-5, which is slow for a critic whose rewards
    have just changed."""
    desired_kl: float = 0.012
    clip: float = 0.2
    entropy_samples: tuple[float, ...] = (6.0e6, 8.0e6)
    """Samples between which the entropy bonus falls."""
    entropy: tuple[float, float] = (0.006, 0.001)
    """Entropy bonus before and after."""
    critic_rounds: int | None = None
    """First rounds, in which the critic learns and the actor stays as it is. When omitted: `NEW_CRITIC_ROUNDS` after a
    warm start from a policy file, which holds no critic, and otherwise none."""
    averaged_rounds: int = 1
    """The exported policy has the mean of the actor's weights over about so many last rounds: see `train.averaging`."""
    symmetry: str = "network"
    """How left and right are taught alike: `network` (symmetric by construction), `handed` (the same, but one side is
    the stronger while it stands, see `train.handedness`), `samples` (mirrored ones), `none`."""

    def __post_init__(self) -> None:
        for name in ("steps", "epochs", "minibatches", "averaged_rounds"):
            if getattr(self, name) < 1:
                raise ValueError(f"learner.{name} must be at least 1, got {getattr(self, name)}")
        for name in ("gamma", "lam"):
            if not 0.0 < getattr(self, name) <= 1.0:
                raise ValueError(f"learner.{name} must lie in (0, 1], got {getattr(self, name)}")
        for name in ("initial_std", "learning_rate", "desired_kl", "clip"):
            if not 0.0 < getattr(self, name) < 100.0:
                raise ValueError(f"learner.{name} must lie in (0, 100), got {getattr(self, name)}")
        if self.critic_rate is not None:
            check_range("learner.critic_rate", self.critic_rate, 1e-6, 1.0)
        if self.warm_std is not None:
            check_interval("learner.warm_std", self.warm_std, 1e-3, 100.0)
        if self.critic_rounds is not None and self.critic_rounds < 0:
            raise ValueError(f"learner.critic_rounds must be at least 0, got {self.critic_rounds}")
        if self.symmetry not in ("network", "handed", "samples", "none"):
            raise ValueError(f"learner.symmetry must be network, handed, samples or none, got {self.symmetry!r}")
        if not self.hidden or min(self.hidden) < 1:
            raise ValueError(f"learner.hidden must hold positive widths, got {self.hidden}")
        if len(self.entropy_samples) != 2 or not 0 <= self.entropy_samples[0] < self.entropy_samples[1]:
            raise ValueError(f"learner.entropy_samples must be two ascending numbers, got {self.entropy_samples}")

    @property
    def symmetric(self) -> bool:
        """Whether the networks are symmetric by construction, at least while walking."""
        return self.symmetry in ("network", "handed")

    def teaches_actor(self, iteration: int) -> bool:
        """Whether the actor learns in this round of a run, counted from 0."""
        return iteration >= (self.critic_rounds or 0)

    def begins_actor(self, iteration: int) -> bool:
        """Whether this is the first round in which it does, after some in which it did not."""
        return iteration == self.critic_rounds != 0

    def entropy_at(self, samples: int) -> float:
        """Entropy bonus after so many samples."""
        first, last = self.entropy_samples
        share = min(1.0, max(0.0, (samples - first) / (last - first)))
        return self.entropy[0] + share * (self.entropy[1] - self.entropy[0])


@dataclass(frozen=True)
class PpoConfig:
    """A training run of the walking policy."""

    library: Annotated[str | None, tyro.conf.arg(name="learner")] = None
    """Learner: `brax` or `rsl_rl`; by the hardware when omitted."""
    physics: str | None = None
    """Engine: `c`, `mjx` or `warp`; by the hardware when omitted."""
    samples: int = 25_000_000
    """Environment steps of all processes together."""
    copies: int = 768
    """Robots simulated together, in each process."""
    profile: str = "training"
    """Physics profile."""
    threads: int | None = None
    """Threads of a process; the machine's cores, divided among its processes, when omitted."""
    device: str = "cpu"
    """Where rsl-rl's networks live: `cpu`, or `cuda` (each process takes a GPU of its own). C physics stays on the CPU,
    and Brax and MJX are where JAX is."""
    seed: int = 1
    checkpoint_s: float = 120.0
    """Seconds between checkpoints."""
    keep_checkpoints: int = 3
    """Checkpoints to keep; the newest and, always, the last."""
    walk: WalkConfig = field(default_factory=WalkConfig)
    learner: LearnerConfig = field(default_factory=LearnerConfig)

    def __post_init__(self) -> None:
        if self.library not in (None, *LIBRARIES):
            raise ValueError(f"learner must be one of {', '.join(LIBRARIES)}, got {self.library!r}")
        if self.physics not in (None, *ENGINES):
            raise ValueError(f"physics must be one of {', '.join(ENGINES)}, got {self.physics!r}")
        if self.samples < 1:
            raise ValueError(f"samples must be at least 1, got {self.samples}")
        if self.copies < self.learner.minibatches:
            raise ValueError(
                f"copies must be at least learner.minibatches = {self.learner.minibatches}, got {self.copies}"
            )
        if self.learner.symmetry == "handed" and not observation_layout(self.walk.layout).has_clock:
            raise ValueError(
                f"learner.symmetry handed needs a layout with a clock, got walk.layout {self.walk.layout!r}"
            )
        if self.profile not in PROFILES:
            raise ValueError(f"profile must be one of {', '.join(PROFILES)}, got {self.profile!r}")
        if self.device not in ("cpu", "cuda"):
            raise ValueError(f"device must be cpu or cuda, got {self.device!r}")
        if self.checkpoint_s <= 0.0:
            raise ValueError(f"checkpoint_s must be positive, got {self.checkpoint_s}")
        if self.keep_checkpoints < 1:
            raise ValueError(f"keep_checkpoints must be at least 1, got {self.keep_checkpoints}")

    def scaled(self, factor: float) -> PpoConfig:
        """The same with so many times the samples; the entropy bonus falls that much later.

        Raises:
            ValueError: the factor is out of range.
        """
        check_range("scale", factor, 1e-6, 1e3)
        if factor == 1.0:
            return self
        learner = replace(self.learner, entropy_samples=tuple(n * factor for n in self.learner.entropy_samples))
        return replace(self, samples=max(1, round(self.samples * factor)), learner=learner)


def preset_names() -> list[str]:
    """Names of the shipped presets."""
    return list(shipped_names("train"))


def load_preset(name: str) -> PpoConfig:
    """A shipped preset by name.

    Raises:
        ValueError: no such preset; the message lists the known ones.
    """
    if name not in preset_names():
        raise ValueError(f"preset {name!r} is unknown; known presets: {', '.join(preset_names())}")
    return load(PpoConfig, config_path("train", f"{name}.yaml"))
