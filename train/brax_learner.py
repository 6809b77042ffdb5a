"""Proximal policy optimisation of the walking policy with Brax's building blocks, on any engine.

Brax's own `ppo.train` is one function from first sample to last. It keeps the optimiser, the random keys and the robots
to itself, so a run cannot be continued exactly (google/brax#655); it runs to the next evaluation without a chance to
stop, to average the curriculum or to let the entropy bonus fall; and its minibatches and random numbers depend on how
many devices there are. So the loop here is our own, and made of Brax's parts: `acting.actor_step`, `compute_ppo_loss`
with its advantages, the running statistics of the normaliser and the learning rate that follows the KL divergence.
Nothing of it needs `jax.device_put_replicated`, which newer JAX no longer has and Brax's loop calls; whoever runs that
loop on these environments finds the way out in `train.replication`.

Everything random of a copy follows from the seed, the round and the copy's number among those of all devices, and
minibatches are drawn within small groups of copies. So an update of one device and one of several, each with its share
of the copies, differ by the rounding of sums only.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any

import asimov_gym.physics.functional  # noqa: F401  (first: it prepares JAX before anything starts it)

# isort: split
import jax
import jax.numpy as jnp
import numpy as np
import optax
from brax.training import acting, gradients, types
from brax.training.acme import running_statistics, specs
from brax.training.agents.ppo import losses, networks, optimizer

from asimov_gym.envs.functional import EnvState, FunctionalWalk
from asimov_gym.robot.mirror import mirror_policy
from train.brax_networks import deviations, make_networks
from train.config import LearnerConfig
from train.devices import AXIS, DIVIDED, SAME, Devices
from train.figures import step_figures

MAX_GRADIENT = 1.0
"""Norm to which the gradients of actor and critic are clipped, each by itself, as rsl-rl does it."""
_VALUE_WEIGHT = 2.0
"""Brax halves the squared error of the value; rsl-rl does not."""


@dataclass(frozen=True)
class Learned:
    """What learning changes; the same on all devices."""

    networks: losses.PPONetworkParams
    normaliser: running_statistics.RunningStatisticsState
    optimiser: Any
    """Of optax; the learning rate is in it."""


jax.tree_util.register_dataclass(Learned, data_fields=[f.name for f in fields(Learned)], meta_fields=[])


class BraxPpo:
    """The learner as pure functions, compiled.

    Args:
        env: a walking environment that restarts by itself and has a curriculum.
        config: settings.
        devices: that the copies are divided among.
        copies: robots of all processes together.
        seed: of everything random.

    Raises:
        ValueError: the copies cannot be divided evenly.
    """

    def __init__(self, env: FunctionalWalk, config: LearnerConfig, devices: Devices, copies: int, seed: int) -> None:
        if copies % (devices.count * config.minibatches):
            raise ValueError(
                f"copies must be a multiple of learner.minibatches × devices = {config.minibatches} × {devices.count} "
                f"for learner brax, got {copies} in all processes together"
            )
        self.env, self.config, self.devices, self.copies = env, config, devices, copies
        self._seed = jax.random.PRNGKey(seed)
        self._actor_view, self._critic_view = env.task.layout.mirror, env.task.privileged_mirror
        self.networks = make_networks(config, self._actor_view, self._critic_view)
        self._policy = networks.make_inference_fn(self.networks, compute_value=True)
        adam = optax.inject_hyperparams(optax.adam)(learning_rate=config.learning_rate)
        clip: Any = lambda gradient, _: _clipped(gradient)  # noqa: E731
        self._optimiser = optax.chain(optax.stateless(clip), adam)
        self._gradient = self._gradient_of_loss(config.clip if config.critic_rate is None else None)
        # Unclipped: a critic that knows nothing yet would come nearer by `clip` a round.
        self._critic_gradient = self._gradient_of_loss(None)
        each = devices.on_each
        self._shuffle = each(self._shuffled, (DIVIDED, SAME), jax.sharding.PartitionSpec(None, AXIS))
        self._reset = jax.jit(each(self._first_states, (SAME,), DIVIDED))
        self._collect = jax.jit(each(self._collected, (SAME, DIVIDED, SAME), (DIVIDED, DIVIDED, SAME)))
        same = devices.everywhere
        self._learn = jax.jit(self._improved, static_argnums=4, donate_argnums=0, out_shardings=(same, same))
        self._start = jax.jit(self._fresh, out_shardings=same)

    def _gradient_of_loss(self, value_clip: float | None) -> Any:
        loss: Any = partial(
            losses.compute_ppo_loss,
            ppo_network=self.networks,
            discounting=self.config.gamma,
            gae_lambda=self.config.lam,
            clipping_epsilon=self.config.clip,
            clipping_epsilon_value=value_clip,
            vf_coefficient=_VALUE_WEIGHT,
        )
        # No axis of devices: their data are one array here, and every mean goes over all of it.
        return gradients.loss_and_pgrad(loss, pmap_axis_name=None, has_aux=True)

    # -- what a run does -----------------------------------------------------------------------------------------------

    def start(self) -> tuple[Learned, EnvState]:
        """Fresh networks, and the robots at the start."""
        for_networks, for_robots = np.asarray(jax.random.split(self._seed))
        return self._start(for_networks), self._reset(for_robots)

    def shapes(self) -> Learned:
        """What is learned with the shape of each array instead of the array."""
        return jax.eval_shape(self._fresh, self._seed)

    def collect(self, learned: Learned, state: EnvState, number: int) -> tuple[EnvState, types.Transition, Any]:
        """A round of steps of every copy.

        Args:
            learned: networks that act.
            state: of the robots.
            number: of the round, from -1 on; the random numbers follow from it.

        Returns:
            The robots, what they did (arrays (N, steps, ...)), and figures of the round by name.
        """
        with jax.default_matmul_precision("highest"):  # TF32 of NVIDIA's tensor cores spoils likelihoods
            return self._collect(learned, state, self._key(number, 0))

    def learn(
        self, learned: Learned, data: types.Transition, number: int, entropy: float, actor: bool = True
    ) -> tuple[Learned, dict[str, Any]]:
        """Learn from a round; what is handed in is used up.

        Args:
            learned: before.
            data: what `collect` returned.
            number: of the round.
            entropy: weight of the entropy bonus.
            actor: whether the actor learns too; otherwise the critic alone, and the learning rate stays.

        Returns:
            What is learned now, and means over the minibatches: `value`, `surrogate`, `entropy`, `learning_rate`, and
            the exploration's `std`.
        """
        with jax.default_matmul_precision("highest"):
            return self._learn(learned, data, self._key(number, 1), np.float32(entropy), actor)

    def at_rate(self, learned: Learned, rate: float) -> Learned:
        """The same, with another learning rate to adapt from."""
        *before, adam = learned.optimiser
        adapting = {**adam.hyperparams, "learning_rate": self.devices.same(np.float32(rate))}
        return replace(learned, optimiser=(*before, adam._replace(hyperparams=adapting)))

    def _key(self, number: int, purpose: int) -> np.ndarray:
        """Of a round, from -1 on."""
        return np.asarray(jax.random.fold_in(jax.random.fold_in(self._seed, number + 1), purpose))

    # -- pure functions ------------------------------------------------------------------------------------------------

    def _fresh(self, key: jax.Array) -> Learned:
        for_actor, for_critic = jax.random.split(key)
        params: Any = losses.PPONetworkParams(
            policy=self.networks.policy_network.init(for_actor),  # type: ignore[call-arg]
            value=self.networks.value_network.init(for_critic),  # type: ignore[call-arg]
        )
        widths = {"state": self._actor_view.size, "privileged_state": self._critic_view.size}
        views = {name: specs.Array((width,), jnp.dtype("float32")) for name, width in widths.items()}
        normaliser: Any = running_statistics.init_state(views, mode="ema")  # type: ignore[arg-type]
        zero = jnp.uint32(0)
        normaliser = normaliser.replace(count=types.UInt64(hi=zero, lo=zero))  # type: ignore[call-arg]
        # Strong types from the start, else everything is compiled a second time.
        learned = Learned(params, normaliser, self._optimiser.init(params))
        return jax.tree.map(lambda a: jnp.asarray(a, dtype=jnp.asarray(a).dtype), learned)

    def _numbers(self, here: int) -> jax.Array:
        """Numbers of this device's rows among those of all devices, where each has so many."""
        return jax.lax.axis_index(AXIS) * here + jnp.arange(here)

    def _first_states(self, key: jax.Array) -> EnvState:
        return self.env.reset(_keys(key, self._numbers(self.copies // self.devices.count)))

    def _collected(self, learned: Learned, state: EnvState, key: jax.Array) -> tuple[EnvState, types.Transition, Any]:
        policy = self._policy((learned.normaliser, learned.networks.policy, learned.networks.value))
        numbers = self._numbers(len(state.reward))

        def step(state: Any, time: jax.Array) -> tuple[Any, Any]:
            keys = _keys(jax.random.fold_in(key, time), numbers)
            after, transition = acting.actor_step(self.env, state, policy, keys, ("truncation",))  # type: ignore[arg-type]
            return after, (transition._replace(next_observation=()), self._figures(after))  # type: ignore[arg-type]

        state, (data, figures) = jax.lax.scan(step, state, jnp.arange(self.config.steps))
        data = jax.tree.map(lambda a: jnp.swapaxes(a, 0, 1), data)
        # The loss looks at the last one only.
        data = data._replace(next_observation=jax.tree.map(lambda a: a[:, None], state.obs))
        world = state.pipeline_state
        levels = jax.tree.map(lambda a: jnp.broadcast_to(jax.lax.pmean(jnp.mean(a), AXIS), a.shape), world.levels)
        figures = jax.tree.map(lambda a: jax.lax.pmean(jnp.mean(a), AXIS), figures)
        figures["physics/diverged"] *= self.devices.count  # a number of copies
        figures["levels"] = {name: value[0] for name, value in vars(levels).items()}
        return state.replace(pipeline_state=replace(world, levels=levels)), data, figures

    def _figures(self, state: EnvState) -> dict[str, Any]:
        task, info = state.pipeline_state.task, state.info
        error, shares = task.mean_velocity - task.command, info["report"]["reward_terms"]
        return step_figures(state.reward, info["terminated"], info["diverged"], error, shares)

    def _improved(
        self, learned: Learned, data: types.Transition, key: jax.Array, entropy: jax.Array, actor: bool
    ) -> tuple[Learned, dict[str, Any]]:
        for_mirror, for_epochs = jax.random.split(key)
        normaliser = learned.normaliser
        # After the minibatches, so that the KL divergence is not that between two normalisers.
        later = running_statistics.update(normaliser, data.observation)
        if self.config.symmetry == "samples":
            data = self._mirrored(learned, data, for_mirror)

        def minibatch(carry: Any, part: types.Transition) -> tuple[Any, Any]:
            params, state = carry
            of_loss = self._gradient if actor else self._critic_gradient
            (_, metrics), gradient = of_loss(params, normaliser, part, key, entropy_cost=entropy)
            if actor:
                state, rate = optimizer.adaptive_kl_learning_rate(state, metrics["kl_mean"], self.config.desired_kl)
            else:
                gradient = gradient.replace(policy=jax.tree.map(jnp.zeros_like, gradient.policy))
                rate = state[-1].hyperparams["learning_rate"]
            change: Any
            change, state = self._optimiser.update(gradient, state)
            if self.config.critic_rate is not None:  # Adam's steps are proportional to the rate
                share = self.config.critic_rate / rate
                change = change.replace(value=jax.tree.map(lambda a: share * a, change.value))
            figures = {"value": metrics["v_loss"], "surrogate": metrics["policy_loss"], "learning_rate": rate}
            return (optax.apply_updates(params, change), state), figures

        def epoch(carry: Any, key: jax.Array) -> tuple[Any, Any]:
            return jax.lax.scan(minibatch, carry, self._shuffle(data, key))

        keys = jax.random.split(for_epochs, self.config.epochs)
        (params, state), figures = jax.lax.scan(epoch, (learned.networks, learned.optimiser), keys)
        rate = figures.pop("learning_rate")[-1, -1]
        std = deviations(self.config, params.policy["log_std"])
        report = jax.tree.map(jnp.mean, figures) | {"learning_rate": rate, "std": jnp.mean(std)}
        report["entropy"] = jnp.sum(jnp.log(std) + 0.5 * np.log(2.0 * np.pi * np.e))
        return Learned(params, later, state), report

    def _shuffled(self, data: types.Transition, key: jax.Array) -> types.Transition:
        """One epoch's minibatches (minibatches, N / minibatches, ...) of this device: each gets one copy of every group
        of as many neighbours."""
        size = self.config.minibatches
        groups = len(data.reward) // size
        draw = jax.vmap(partial(jax.random.permutation, x=size))
        order = draw(_keys(key, self._numbers(groups)))

        def dealt(rows: jax.Array) -> jax.Array:
            rows = rows.reshape(groups, size, *rows.shape[1:])
            places = order.reshape(groups, size, *(1,) * (rows.ndim - 2))
            return jnp.swapaxes(jnp.take_along_axis(rows, places, axis=1), 0, 1)

        return jax.tree.map(dealt, data)

    def _mirrored(self, learned: Learned, data: types.Transition, key: jax.Array) -> types.Transition:
        """The round with about half of the copies replaced by their mirror images.

        As in `train.symmetry.MirrorSamples`, an action keeps its likelihood, and the distribution to compare with and
        the value are computed anew. Here whole copies are mirrored, because advantages run along their steps.
        """
        flip = jax.vmap(jax.random.bernoulli)(_keys(key, jnp.arange(self.copies)))

        def choose(mirrored: Any, straight: Any) -> Any:
            return jax.tree.map(
                lambda a, b: jnp.where(flip.reshape(-1, *(1,) * (b.ndim - 1)), a, b), mirrored, straight
            )

        def views(obs: Any) -> Any:
            mirrored = {"state": self._actor_view(obs["state"])}
            mirrored["privileged_state"] = self._critic_view(obs["privileged_state"])
            return choose(mirrored, obs)

        seen, extras = views(data.observation), dict(data.extras["policy_extras"])  # type: ignore[call-overload]
        extras["raw_action"] = choose(mirror_policy(extras["raw_action"]), extras["raw_action"])
        network, value = self.networks.policy_network, self.networks.value_network
        extras["distribution_params"] = network.apply(learned.normaliser, learned.networks.policy, seen)
        extras["value"] = value.apply(learned.normaliser, learned.networks.value, seen)
        return data._replace(
            observation=seen,
            next_observation=views(data.next_observation),
            extras={**data.extras, "policy_extras": extras},  # type: ignore[dict-item]
        )


def _keys(key: jax.Array, numbers: jax.Array) -> jax.Array:
    """A key for each number, (n, 2)."""
    return jax.vmap(jax.random.fold_in, in_axes=(None, 0))(key, numbers)


def _clipped(gradient: Any) -> Any:
    """Gradients of actor and critic, each no longer than `MAX_GRADIENT`."""

    def clip(tree: Any) -> Any:
        factor = jnp.minimum(1.0, MAX_GRADIENT / (optax.global_norm(tree) + 1e-6))
        return jax.tree.map(lambda a: factor * a, tree)

    return gradient.replace(policy=clip(gradient.policy), value=clip(gradient.value))
