"""Actor and critic for Brax's learner: the same networks that rsl-rl has here, and as symmetric."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import asimov_gym.physics.functional  # noqa: F401  (first: it prepares JAX before anything starts it)

# isort: split
import jax
import jax.numpy as jnp
import numpy as np
from brax.training.acme.running_statistics import NestedMeanStd
from brax.training.agents.ppo.networks import PPONetworks
from brax.training.distribution import NormalDistribution
from brax.training.networks import MLP, FeedForwardNetwork
from flax import linen

from asimov_gym.robot.joints import POLICY_JOINT_NAMES
from asimov_gym.robot.mirror import Mirror, mirror_policy
from asimov_gym.robot.observation import ObservationLayout
from train.config import LearnerConfig
from train.handedness import hand, handed
from train.weights import NORMALISER_EPSILON, VIEWS

_UNIFORM = jax.nn.initializers.variance_scaling(1.0 / 3.0, "fan_in", "uniform")
"""Uniform within 1/√inputs, as torch fills its layers."""


class OwnNormal(NormalDistribution):
    """A Gaussian that draws each row from a key of that row's own, so that it does not matter how rows are divided
    among devices."""

    def sample_no_postprocessing(self, parameters: tuple[jax.Array, jax.Array], seed: jax.Array) -> jax.Array:
        """Actions (N, 23) from means and deviations (N, 23) each, and keys (N, 2)."""
        mean, std = parameters
        return mean + std * jax.vmap(lambda key: jax.random.normal(key, mean.shape[-1:]))(seed)


def make_networks(config: LearnerConfig, actor_view: Mirror, critic_view: Mirror) -> PPONetworks:
    """Actor and critic as Brax's losses take them.

    The actor's answer is a pair of means and deviations, (..., 23) each; the critic's is (...,). Their parameters are
    `layers` (of `brax.training.networks.MLP`) and, for the actor, `log_std` (23,).

    Args:
        config: settings.
        actor_view: mirror of the actor's observation, which also tells its width.
        critic_view: mirror of the critic's.
    """
    actions = len(POLICY_JOINT_NAMES)
    actor = _Trunk(config, "actor", actor_view, actions, mirror_policy)
    critic = _Trunk(config, "critic", critic_view, 1, None)

    def start_actor(key: jax.Array) -> dict[str, Any]:
        log_std = jnp.full(actions, jnp.log(config.initial_std), dtype=jnp.float32)
        return {"layers": actor.start(key), "log_std": log_std}

    def act(
        normaliser: NestedMeanStd, parameters: Mapping[str, Any], obs: Mapping[str, jax.Array]
    ) -> tuple[jax.Array, jax.Array]:
        mean = actor(normaliser, parameters["layers"], obs)
        return mean, jnp.broadcast_to(deviations(config, parameters["log_std"]), mean.shape)

    def value(normaliser: NestedMeanStd, parameters: Mapping[str, Any], obs: Mapping[str, jax.Array]) -> jax.Array:
        return critic(normaliser, parameters["layers"], obs)[..., 0]

    parts: dict[str, Any] = {
        "policy_network": FeedForwardNetwork(init=start_actor, apply=act),
        "value_network": FeedForwardNetwork(init=lambda key: {"layers": critic.start(key)}, apply=value),
        "parametric_action_distribution": OwnNormal(event_size=actions),
    }
    return PPONetworks(**parts)


def load_actor(
    config: LearnerConfig, layout: ObservationLayout, networks: Mapping[str, np.ndarray]
) -> Callable[[np.ndarray], np.ndarray]:
    """The actor of a checkpoint, from observations (n, width) to mean actions (n, 23).

    Args:
        config: settings of the run.
        layout: of the actor's observation.
        networks: the checkpoint's arrays by name; see `train.brax_ppo`.
    """
    layers: dict[str, dict[str, np.ndarray]] = {}
    for name, array in networks.items():
        kind, layer, *part = name.split(".")
        if kind == "actor" and part:
            layers.setdefault(layer, {})[part[0]] = array
    actor = _Trunk(config, "actor", layout.mirror, len(POLICY_JOINT_NAMES), mirror_policy)
    view = VIEWS["actor"]
    figures: dict[str, Any] = {f: {view: networks[f"normaliser.{f}.{view}"]} for f in ("mean", "std")}
    normaliser = NestedMeanStd(**figures)

    def answer(observations: np.ndarray) -> np.ndarray:
        with jax.default_matmul_precision("highest"):  # NVIDIA's TF32 would differ from the exported network
            return np.asarray(actor(normaliser, layers, {view: jnp.asarray(observations)}))

    return answer


def deviations(config: LearnerConfig, log_std: jax.Array) -> jax.Array:
    """Standard deviation of each action (23,); with symmetric networks a joint has that of its counterpart."""
    if config.symmetric:
        log_std = 0.5 * (log_std + log_std[mirror_policy.indices])
    return jnp.exp(log_std)


class _Trunk:
    """Normaliser and layers of a network, and its mean with its own reflection where it is to be symmetric.

    Args:
        config: settings.
        name: `actor` or `critic`.
        view: mirror of what it sees.
        outputs: how many values it answers.
        output: mirror of the answer; None where that stays as it is.
    """

    def __init__(self, config: LearnerConfig, name: str, view: Mirror, outputs: int, output: Mirror | None) -> None:
        self._layers = MLP((*config.hidden, outputs), activation=linen.elu, kernel_init=_UNIFORM)
        self._name, self._view, self._symmetric = VIEWS[name], view, config.symmetric
        self._hand = hand(view.size) if config.symmetry == "handed" else None
        self._output: Callable[[jax.Array], jax.Array] = output or (lambda answer: answer)

    def start(self, key: jax.Array) -> Any:
        """Fresh layers."""
        return self._layers.init(key, jnp.zeros((1, self._view.size)))["params"]

    def __call__(self, normaliser: NestedMeanStd, layers: Any, obs: Mapping[str, jax.Array]) -> jax.Array:
        figures: Any = normaliser
        mean, std = figures.mean[self._name], figures.std[self._name]

        def answer(rows: jax.Array) -> jax.Array:
            return self._layers.apply({"params": layers}, (rows - mean) / (std + NORMALISER_EPSILON))  # type: ignore[return-value]

        seen = obs[self._name]
        if not self._symmetric:
            return answer(seen)
        if self._hand is not None:
            seen = handed(seen, jnp.asarray(self._hand))
        straight, reflected = answer(jnp.stack([seen, self._view(seen)]))
        return 0.5 * (straight + self._output(reflected))
