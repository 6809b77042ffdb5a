"""For whoever runs Brax's own training loops on these environments: what they call and newer JAX no longer has.

Brax 0.14.2 spreads its training state over the devices with `jax.device_put_replicated`, which JAX 0.10 has removed
(google/brax#671). The learner here does not need it; `brax.training.agents.ppo.train.train` does.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax.sharding import Mesh, NamedSharding, PartitionSpec


def restore_device_put_replicated() -> None:
    """Give JAX its `device_put_replicated` back, where it is missing. Where it is there nothing happens."""
    if not hasattr(jax, "device_put_replicated"):
        jax.device_put_replicated = device_put_replicated  # type: ignore[attr-defined]


def device_put_replicated(tree: Any, devices: Sequence[Any]) -> Any:
    """A tree of arrays with a new first axis along the devices, one copy of each array on each device."""
    mesh = Mesh(list(devices), ("devices",))

    def stacked(leaf: Any) -> jax.Array:
        array = jnp.asarray(leaf)
        rows = jnp.broadcast_to(array[None], (len(devices), *array.shape))
        return jax.device_put(rows, NamedSharding(mesh, PartitionSpec("devices")))

    return jax.tree.map(stacked, tree)
