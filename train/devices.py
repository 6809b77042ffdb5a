"""The devices that JAX learns on: the copies are divided among them, the networks are the same on all.

Without more ado these are all GPUs (or the one CPU) of this process. Where `torchrun` has started several processes
they are joined here, and the devices of all of them work as one.
"""

from __future__ import annotations

import os
import socket
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from asimov_gym.physics.functional.runtime import keep_what_is_compiled  # first: its package prepares JAX

# isort: split
import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding
from jax.sharding import PartitionSpec as Spec

from train.ranks import Ranks

AXIS = "copies"
"""Name of the axis along which robots are divided."""
DIVIDED, SAME = Spec(AXIS), Spec()
"""How an array lies on the devices: rows divided among them, or all of it on each."""


def join(ranks: Ranks) -> None:
    """Connect the JAX of all ranks, and keep what is compiled for the next start; to be called before JAX is used.

    Rank 0 listens on a free port of the address that `torchrun` has told everyone; JAX_COORDINATOR_ADDRESS overrules.
    """
    keep_what_is_compiled()
    if ranks.count == 1:
        return
    jax.config.update("jax_cpu_collectives_implementation", "gloo")
    address = ranks.from_first(_coordinator)
    devices = None if ranks.local_count == 1 else [ranks.local_rank]
    jax.distributed.initialize(address, ranks.count, ranks.rank, local_device_ids=devices)


def prepare_beside_torch(ranks: Ranks) -> None:
    """Set JAX up to share a machine with torch's networks; to be called before JAX is used.

    JAX takes the memory of a GPU as it needs it instead of most of it at once, each process of a machine uses the GPU
    of its own, and what is compiled is kept for the next start.
    """
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")
    if ranks.local_count > 1:
        jax.config.update("jax_cuda_visible_devices", str(ranks.local_rank))
    keep_what_is_compiled()


def _coordinator() -> str:
    if "JAX_COORDINATOR_ADDRESS" in os.environ:
        return os.environ["JAX_COORDINATOR_ADDRESS"]
    with socket.create_server(("", 0)) as listener:
        port = listener.getsockname()[1]
    return f"{os.environ.get('MASTER_ADDR', '127.0.0.1')}:{port}"


@dataclass(frozen=True)
class Devices:
    """All devices of all processes in one row, those of a process beside each other."""

    mesh: Mesh

    @classmethod
    def all(cls) -> Devices:
        """Every device that JAX sees."""
        row = sorted(jax.devices(), key=lambda device: (device.process_index, device.id))
        return cls(Mesh(np.array(row), (AXIS,)))

    @property
    def count(self) -> int:
        """Of all processes together."""
        return self.mesh.size

    @property
    def here(self) -> int:
        """Of this process."""
        return len(self.mesh.local_devices)

    @property
    def kind(self) -> str:
        """What they are, in words."""
        return f"{self.count} × {self.mesh.devices.flat[0].device_kind}"

    def divided(self, rows: np.ndarray) -> jax.Array:
        """An array of all copies from the rows of this process's copies."""
        return jax.make_array_from_process_local_data(NamedSharding(self.mesh, DIVIDED), rows)

    def same(self, value: Any) -> jax.Array:
        """An array that lies on each device as a whole; every process must hand in the same."""
        value = np.asarray(value)
        return jax.make_array_from_process_local_data(NamedSharding(self.mesh, SAME), value, value.shape)

    @property
    def everywhere(self) -> NamedSharding:
        """That an output is the same on all devices."""
        return NamedSharding(self.mesh, SAME)

    def on_each(self, function: Callable[..., Any], inputs: Any, outputs: Any) -> Callable[..., Any]:
        """The function as each device computes it on its own rows.

        Args:
            function: of arrays; may use `jax.lax.pmean` and the like over `AXIS`.
            inputs: how each argument lies on the devices, a tuple of `DIVIDED` and `SAME`.
            outputs: the same for the result, a tree that begins like it.
        """
        return jax.shard_map(function, mesh=self.mesh, in_specs=inputs, out_specs=outputs, check_vma=False)


def rows_here(array: jax.Array) -> np.ndarray:
    """The rows of this process of a divided array."""
    if not array.size:  # JAX does not divide what is empty
        share = array.shape[0] * jax.local_device_count() // jax.device_count()
        return np.zeros((share, *array.shape[1:]), array.dtype)
    parts = sorted(array.addressable_shards, key=lambda shard: shard.index[0].start or 0)
    return np.concatenate([np.asarray(part.data) for part in parts])


def value_here(array: jax.Array) -> np.ndarray:
    """An array that is the same on all devices."""
    return np.array(array.addressable_data(0))
