"""What physics engines under JAX have in common: the state they carry, and what they do with it.

A state holds no more than what the next step needs: an engine rebuilds its working memory in every step. That keeps
loops over steps small, and a copy is restarted by exchanging a few rows.
"""

from __future__ import annotations

import abc
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jax import export

from asimov_gym.physics.c_physics import CPhysics
from asimov_gym.physics.parameters import BodyParameters, ModelFigures
from asimov_gym.physics.places import JointPlaces, SensorPlaces
from asimov_gym.physics.profile import ENGINES, PhysicsProfile, physics_profile
from asimov_gym.physics.quantities import JointTarget, PhysicsState, Reading
from asimov_gym.robot.joints import JOINT_NAMES
from asimov_gym.robot.model import robot_spec
from asimov_gym.robot.terrain import FLAT, Terrain, terrain_named


@dataclass(frozen=True)
class Simulation:
    """N robots between two steps; float32."""

    time: Any
    """s, (N,)."""
    qpos: Any
    """Generalised positions in the model's order, (N, nq)."""
    qvel: Any
    """(N, nv)."""
    warmstart: Any
    """Accelerations that the constraint solver starts from, (N, nv)."""
    joint_torque: Any
    """This and the following as in `Reading`, measured at the start of the last physics step; (N, 25)."""
    foot_position: Any
    """(N, 2, 3)."""
    foot_velocity: Any
    foot_up: Any
    foot_force: Any
    joint_trail: Any | None = None
    """Positions and velocities of the joints at the K physics steps before, the latest first, (N, K, 2, 25); None where
    the engine remembers none."""


def register(cls: type) -> None:
    """Let JAX look into a dataclass of arrays, and keep functions of it in files."""
    jax.tree_util.register_dataclass(cls, data_fields=[f.name for f in fields(cls)], meta_fields=[])
    export.register_pytree_node_serialization(
        cls,
        serialized_name=f"{cls.__module__}.{cls.__qualname__}",
        serialize_auxdata=lambda nothing: b"",
        deserialize_auxdata=lambda nothing: (),
    )


for _cls in (Simulation, Reading, BodyParameters, JointTarget, PhysicsState):
    register(_cls)


class Engine(abc.ABC):
    """A physics engine whose step is a pure function that JAX can compile. N is the first axis of every array.

    Args:
        profile: physics profile.
        spec: another robot than the shipped one, or other surroundings; terrain and profile are laid over it.
        terrain: the ground, or its name; flat when None.
        trail: how many earlier moments of the joints a simulation remembers, at most the substeps of a step.
    """

    name: str

    def __init__(
        self,
        profile: str | PhysicsProfile = "training",
        spec: Callable[[], mujoco.MjSpec] | None = None,
        terrain: Terrain | str | None = None,
        trail: int = 0,
    ) -> None:
        self.profile = physics_profile(profile)
        self.terrain = FLAT if terrain is None else terrain_named(terrain)
        self.trail = trail
        self._make_spec = spec or (lambda: robot_spec(visuals=False))
        self.model = self._spec().compile()
        """For C MuJoCo; an engine may simulate a variant of it."""
        self.timestep = float(self.model.opt.timestep)
        self.figures = ModelFigures(self.model)
        self.joints = JointPlaces(self.model)
        at_rest = CPhysics(1, self.profile, model=self.model)
        self._standing = at_rest.standing()
        reading = at_rest.read()
        at_rest.close()
        sensed = {name: getattr(reading, name) for name in ("joint_torque", *_FOOT_FIELDS)}
        self._at_rest = {name: np.asarray(value, dtype=np.float32) for name, value in sensed.items()}

    def _spec(self) -> mujoco.MjSpec:
        """A fresh specification of what is simulated."""
        spec = self._make_spec()
        self.terrain.lay(spec)
        self.profile.apply(spec)
        return spec

    # -- state ---------------------------------------------------------------------------------------------------------

    def standing(self) -> tuple[np.ndarray, np.ndarray]:
        """Keyframe `stand`: generalised positions (nq,) and velocities (nv,)."""
        return self._standing

    def configuration(self, joint_position: Any, base_position: Any, base_quat: Any) -> Any:
        """Generalised positions (N, nq) from joint order (N, 25), pelvis position (N, 3) and orientation (N, 4)."""
        qpos = jnp.tile(jnp.asarray(self._standing[0], dtype=jnp.float32), (joint_position.shape[0], 1))
        qpos = qpos.at[:, 0:3].set(base_position).at[:, 3:7].set(base_quat)
        return qpos.at[:, self.joints.position].set(joint_position)

    def start(self, qpos: Any, qvel: Any) -> Simulation:
        """Robots in a state (N, nq), (N, nv) at time 0, with sensors of a robot at rest in the standing pose."""
        n = qpos.shape[0]
        sensed = {name: jnp.tile(value, (n, *(1,) * (value.ndim - 1))) for name, value in self._at_rest.items()}
        qvel = jnp.asarray(qvel, dtype=jnp.float32)
        qpos, time = jnp.asarray(qpos, dtype=jnp.float32), jnp.zeros(n, dtype=jnp.float32)
        still = jnp.repeat(self.joint_state(qpos, qvel)[:, None], self.trail, axis=1) if self.trail else None
        return Simulation(time, qpos, qvel, jnp.zeros_like(qvel), **sensed, joint_trail=still)

    def joint_state(self, qpos: Any, qvel: Any) -> Any:
        """Positions and velocities of the joints, joint order, (..., 2, 25), of generalised ones."""
        return jnp.stack([qpos[..., self.joints.position], qvel[..., self.joints.velocity]], axis=-2)

    def stand(self, copies: int) -> Simulation:
        """N robots in keyframe `stand`."""
        qpos, qvel = (jnp.asarray(np.tile(part, (copies, 1)), dtype=jnp.float32) for part in self._standing)
        return self.start(qpos, qvel)

    def kick(self, simulation: Simulation, velocity: Any) -> Simulation:
        """Add to the pelvis velocity, (N, 6): linear in the world frame (m/s), angular in the body frame (rad/s)."""
        return replace(simulation, qvel=simulation.qvel.at[:, 0:6].add(velocity))

    def read(self, simulation: Simulation) -> Reading:
        """The reading of a state."""
        sensed = {name: getattr(simulation, name) for name in self._at_rest}
        return Reading.assemble(simulation.qpos, simulation.qvel, self.joints, **sensed)

    def physics_state(self, simulation: Simulation) -> PhysicsState:
        """The same state as C physics takes, NumPy, float64. Sensors that no reading needs are zero."""
        values = {name: value for name, value in vars(simulation).items() if name != "joint_trail"}
        arrays = {name: np.array(value, dtype=np.float64) for name, value in values.items()}
        n, places = len(arrays["time"]), SensorPlaces(self.model)
        sensors = np.zeros((n, self.model.nsensordata))
        sensors[:, places.torque] = arrays.pop("joint_torque")
        for name in _FOOT_FIELDS:
            sensors[:, getattr(places, name)] = arrays.pop(name).reshape(n, -1)
        return PhysicsState(**arrays, sensors=sensors)

    # -- stepping ------------------------------------------------------------------------------------------------------

    @abc.abstractmethod
    def step(
        self,
        simulation: Simulation,
        target: JointTarget,
        substeps: int,
        body: BodyParameters | None = None,
        wrench: Mapping[str, Any] | None = None,
    ) -> tuple[Simulation, Any]:
        """Advance by `substeps` physics steps.

        Args:
            simulation: the robots.
            target: joint command, finite; `position`, `velocity` and `load` are (N, 25) or (N, substeps, 25), gains
                (N, 25).
            substeps: physics steps, at least 1.
            body: figures of each copy; the model's own when None.
            wrench: force and torque on bodies at their centres of mass, world frame, (N, 6) by body name, held for the
                call.

        Returns:
            The robots, and which of them diverged, (N,) bool: those stand at the origin again, at time 0.
        """


_FOOT_FIELDS = ("foot_position", "foot_velocity", "foot_up", "foot_force")


def rows(value: Any, substeps: int) -> Any:
    """A target's array with an axis of substeps, (N, substeps, 25)."""
    if value.ndim == 2:
        return jnp.broadcast_to(value[:, None, :], (value.shape[0], substeps, len(JOINT_NAMES)))
    return value


def choose(which: Any, chosen: Any, others: Any) -> Any:
    """Rows of a tree of arrays from `chosen` where the mask (N,) says so, else from `others`."""

    def pick(a: Any, b: Any) -> Any:
        return jnp.where(which.reshape(-1, *(1,) * (b.ndim - 1)), a, b)

    return jax.tree.map(pick, chosen, others)


def make_engine(
    name: str,
    profile: str | PhysicsProfile = "training",
    threads: int | None = None,
    terrain: Terrain | str | None = None,
    trail: int = 0,
) -> Engine:
    """An engine by name.

    Args:
        name: one of `ENGINES`.
        profile: physics profile.
        threads: size of the thread pool of C physics; the machine's cores by default.
        terrain: the ground, or its name; flat when None.
        trail: how many earlier moments of the joints a simulation remembers.

    Raises:
        ValueError: the name is unknown, or the engine cannot run the profile or the terrain; says what can be done.
        ModuleNotFoundError: what the engine needs is not installed.
    """
    from asimov_gym.physics.functional.c_engine import CEngine
    from asimov_gym.physics.functional.mjx_engine import MjxEngine

    if name == "c":
        return CEngine(profile, threads, terrain=terrain, trail=trail)
    if name in ("mjx", "warp"):
        return MjxEngine(profile, "jax" if name == "mjx" else "warp", terrain=terrain, trail=trail)
    raise ValueError(f"physics must be one of {', '.join(ENGINES)}, got {name!r}")
