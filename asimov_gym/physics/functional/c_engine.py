"""C MuJoCo under JAX: one call back to the thread pool for the whole batch."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from asimov_gym.physics.c_physics import CPhysics
from asimov_gym.physics.functional.engine import Engine, Simulation
from asimov_gym.physics.parameters import BodyParameters
from asimov_gym.physics.profile import PhysicsProfile
from asimov_gym.physics.quantities import JointTarget, PhysicsState
from asimov_gym.robot.terrain import Terrain


class CEngine(Engine):
    """The C engine as a function of its state; the engine's own memory only saves work.

    The state passes through float32 between two calls. Under `jax.vmap` the batch grows by the mapped axis and is still
    stepped in one call.

    Args:
        profile: physics profile.
        threads: size of the thread pool; the machine's cores by default.
        spec: another robot than the shipped one, or other surroundings.
        terrain: the ground, or its name; flat when None.
        trail: how many earlier moments of the joints a simulation remembers.
    """

    name = "c"

    def __init__(
        self,
        profile: str | PhysicsProfile = "training",
        threads: int | None = None,
        spec: Callable[[], mujoco.MjSpec] | None = None,
        terrain: Terrain | str | None = None,
        trail: int = 0,
    ) -> None:
        super().__init__(profile, spec, terrain, trail)
        self._threads = threads
        self._pools: dict[int, _Pool] = {}
        self._lock = threading.Lock()

    def step(
        self,
        simulation: Simulation,
        target: JointTarget,
        substeps: int,
        body: BodyParameters | None = None,
        wrench: Mapping[str, Any] | None = None,
    ) -> tuple[Simulation, Any]:
        shapes = jax.tree.map(lambda a: jax.ShapeDtypeStruct(a.shape, jnp.float32), simulation)
        diverged = jax.ShapeDtypeStruct(simulation.time.shape, jnp.bool_)
        arguments = (simulation, target, BodyParameters() if body is None else body, dict(wrench or {}))
        call = partial(self._call, substeps)
        return jax.pure_callback(call, (shapes, diverged), *arguments, vmap_method="broadcast_all")

    def _call(
        self,
        substeps: int,
        simulation: Simulation,
        target: JointTarget,
        body: BodyParameters,
        wrench: Mapping[str, Any],
    ) -> tuple[Simulation, np.ndarray]:
        """What JAX calls back. Its arrays have the batch's axis first, and before it those of `jax.vmap`."""
        mapped = np.shape(simulation.qpos)[:-2]
        flat = partial(_flatten, len(mapped))
        # One call at a time: several devices of one process share the pools.
        with self._lock:
            simulation, target, body, wrench = (jax.tree.map(flat, part) for part in (simulation, target, body, wrench))
            after, diverged = self._pool(len(simulation.qpos)).step(substeps, simulation, target, body, wrench)
        unflat = partial(_unflatten, mapped)
        return jax.tree.map(unflat, after), unflat(diverged)

    def _pool(self, copies: int) -> _Pool:
        if copies not in self._pools:
            physics = CPhysics(copies, self.profile, self._threads, model=self.model, trail=self.trail)
            self._pools[copies] = _Pool(physics)
        return self._pools[copies]


class _Pool:
    """A batch of C simulations, and the body figures that are written in its models."""

    def __init__(self, physics: CPhysics) -> None:
        self._physics = physics
        self._body: BodyParameters | None = None

    def step(
        self,
        substeps: int,
        simulation: Simulation,
        target: JointTarget,
        body: BodyParameters,
        wrench: Mapping[str, np.ndarray],
    ) -> tuple[Simulation, np.ndarray]:
        physics = self._physics
        self._write(body)
        s = simulation
        sensors = np.zeros((physics.copies, physics.model.nsensordata))  # they have no influence on a step
        physics.set_state(PhysicsState(s.time, s.qpos, s.qvel, s.warmstart, sensors))
        acting = any(force.any() for force in wrench.values())
        reading = physics.step(target, substeps, wrench if acting else None)
        state = physics.state()
        after = Simulation(
            time=state.time,
            qpos=state.qpos,
            qvel=state.qvel,
            warmstart=state.warmstart,
            joint_torque=reading.joint_torque,
            foot_position=reading.foot_position,
            foot_velocity=reading.foot_velocity,
            foot_up=reading.foot_up,
            foot_force=reading.foot_force,
            joint_trail=physics.joint_trail() if physics.trail else None,
        )
        return jax.tree.map(lambda a: np.asarray(a, dtype=np.float32), after), physics.diverged

    def _write(self, body: BodyParameters) -> None:
        """Write the figures of copies that changed."""
        values = {name: value for name, value in vars(body).items() if value is not None}
        if not values:
            return
        changed = np.ones(self._physics.copies, dtype=bool)
        if self._body is not None:
            before = vars(self._body)
            others = {name: before[name] for name, value in values.items() if not np.array_equal(value, before[name])}
            if not others:
                return
            differ = [(values[name] != other).reshape(len(changed), -1).any(axis=1) for name, other in others.items()]
            changed = np.logical_or.reduce(differ)
        self._physics.set_parameters(body, copies=changed)
        self._body = body


def _flatten(mapped: int, array: Any) -> np.ndarray:
    array = np.asarray(array)
    return array.reshape(-1, *array.shape[mapped + 1 :])


def _unflatten(mapped: tuple[int, ...], array: np.ndarray) -> np.ndarray:
    return array.reshape(*mapped, -1, *array.shape[1:]) if mapped else array
