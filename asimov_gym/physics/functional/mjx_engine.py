"""MuJoCo's own JAX port, MJX: its jax backend runs anywhere, its warp backend is for NVIDIA (elsewhere for tests)."""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Callable
from functools import partial
from typing import Any, Literal

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from mujoco import mjx

from asimov_gym.physics.functional.engine import Engine, Simulation, choose, rows
from asimov_gym.physics.parameters import BodyParameters
from asimov_gym.physics.profile import PhysicsProfile
from asimov_gym.physics.quantities import JointTarget, is_sound
from asimov_gym.robot.joints import JOINT_NAMES

Backend = Literal["jax", "warp"]
_FORCE, _NORMAL, _TANGENT = 1 << 1, 1 << 5, 1 << 6  # bits of mjtConDataField
_NEAREST = 1  # contact sensors report the deepest contacts first
_CONTACTS = {mujoco.mjtGeom.mjGEOM_SPHERE: 1, mujoco.mjtGeom.mjGEOM_CAPSULE: 2, mujoco.mjtGeom.mjGEOM_BOX: 4}
"""Most contacts of a foot's shape with the ground."""


class MjxEngine(Engine):
    """MJX as a function of its state.

    The arrays for contacts and constraints are as large as this robot can ever need, so they cannot overflow.

    Args:
        profile: physics profile; one in which only the feet touch the ground, and without noslip iterations.
        backend: `jax` or `warp`.
        spec: another robot than the shipped one, or other surroundings.

    Raises:
        ValueError: MJX cannot run the profile.
        ModuleNotFoundError: the warp backend is wanted and not installed.
    """

    def __init__(
        self,
        profile: str | PhysicsProfile = "training",
        backend: Backend = "jax",
        spec: Callable[[], mujoco.MjSpec] | None = None,
    ) -> None:
        super().__init__(profile, spec)
        if self.profile.bodies_collide or self.profile.noslip_iterations:
            raise ValueError(
                f"physics profile {self.profile.name!r} cannot run on MJX, which has no noslip iterations and would "
                "test every pair of bodies for contact: use 'training', or physics='c'"
            )
        if backend == "warp" and importlib.util.find_spec("warp") is None:
            raise ModuleNotFoundError(
                "warp-lang is not installed, which physics='warp' needs: pip install 'mujoco-mjx[warp]', or use "
                "physics='mjx'"
            )
        self.name = "mjx" if backend == "jax" else "warp"
        self._backend = backend
        variant = self._variant()
        self._sensors = _Sensors(variant, summed=backend == "jax")
        self._variant_model = variant
        self._mjx_model = mjx.put_model(variant, impl=backend)
        if backend == "warp":
            self._mjx_model = _without_warnings(self._mjx_model)
        self._loads = np.array([variant.actuator(n.removesuffix("_joint") + "_load").id for n in JOINT_NAMES])
        self._servos = np.array([variant.actuator(n.removesuffix("_joint")).id for n in JOINT_NAMES])
        limits = variant.jnt_actfrcrange[[variant.joint(n).id for n in JOINT_NAMES]].astype(np.float32)
        self._limits = limits[:, 0], limits[:, 1]
        feet = {variant.geom(int(i)).name: variant.geom_type[i] for i in self.figures.feet}
        self._contacts = sum(_CONTACTS[mujoco.mjtGeom(kind)] for kind in feet.values())
        self._data: dict[int, mjx.Data] = {}

    def _variant(self) -> mujoco.MjModel:
        """The model with the sensors that the backend has, and that a reading needs."""
        spec = self._spec()
        for sensor in list(spec.sensors):
            if sensor.name.startswith("imu_") or (self._backend == "jax" and sensor.name in _FOOT_FORCES):
                spec.delete(sensor)
        if self._backend == "jax":  # it has contact sensors between two shapes only
            for geom in spec.geoms:
                if _is_sole(geom.name):
                    _add_force_sensor(spec, geom)
        return spec.compile()

    def step(
        self, simulation: Simulation, target: JointTarget, substeps: int, body: BodyParameters | None = None
    ) -> tuple[Simulation, Any]:
        n = simulation.qpos.shape[0]
        body = BodyParameters() if body is None else body
        kp, kd = self._gains(target, body, n)
        load = jnp.zeros((n, substeps, len(JOINT_NAMES))) if target.load is None else rows(target.load, substeps)
        if target.velocity is not None:
            load = load + kd[:, None, :] * rows(target.velocity, substeps)
        one = partial(self._step_one, self._template(n))
        with jax.default_matmul_precision("highest"):  # the tensor cores' rounding would spoil the dynamics
            after = jax.vmap(one)(simulation, rows(target.position, substeps), load, kp, kd, body)
        diverged = ~is_sound(after.qpos, after.qvel)
        return choose(diverged, self.stand(n), after), diverged

    def _step_one(
        self,
        data: mjx.Data,
        simulation: Simulation,
        position: jax.Array,
        load: jax.Array,
        kp: jax.Array,
        kd: jax.Array,
        body: BodyParameters,
    ) -> Simulation:
        """One robot through all substeps; targets and loads are (S, 25), gains (25,)."""
        model = self._laden(body)
        data = data.replace(
            time=simulation.time, qpos=simulation.qpos, qvel=simulation.qvel, qacc_warmstart=simulation.warmstart
        )

        def substep(data: mjx.Data, row: tuple[jax.Array, jax.Array]) -> tuple[mjx.Data, None]:
            driven, control = self._driven(model, data, *row, kp, kd)
            return mjx.step(driven, data.replace(ctrl=control)), None

        data, _ = jax.lax.scan(substep, data, (position, load))
        sensed, places, feet = data.sensordata, self._sensors, (2, 3)
        return Simulation(
            time=data.time,
            qpos=data.qpos,
            qvel=data.qvel,
            warmstart=data.qacc_warmstart,
            joint_torque=sensed[places.torque],
            foot_position=sensed[places.foot_position].reshape(feet),
            foot_velocity=sensed[places.foot_velocity].reshape(feet),
            foot_up=sensed[places.foot_up].reshape(feet),
            foot_force=places.force(sensed),
        )

    def _driven(
        self, model: mjx.Model, data: mjx.Data, position: jax.Array, load: jax.Array, kp: jax.Array, kd: jax.Array
    ) -> tuple[mjx.Model, jax.Array]:
        """The model with the gains of a physics step, and its control, (nu,).

        A drive at its limit gives that torque and no more, whatever the speed. C MuJoCo leaves its damping out of the
        implicit integration then; MJX does not, which makes such a joint up to a quarter slower in a step. So here a
        drive at its limit has no gains, and its torque as the load.
        """
        asked = kp * (position - data.qpos[self.joints.position]) - kd * data.qvel[self.joints.velocity] + load
        torque = jnp.clip(asked, *self._limits)
        free = torque == asked
        stiffness, damping = jnp.where(free, kp, 0.0), jnp.where(free, kd, 0.0)
        gain = model.actuator_gainprm.at[self._servos, 0].set(stiffness)
        bias = model.actuator_biasprm.at[self._servos, 1].set(-stiffness).at[self._servos, 2].set(-damping)
        control = jnp.zeros(self._variant_model.nu, dtype=jnp.float32).at[self._servos].set(position)
        control = control.at[self._loads].set(jnp.where(free, load, torque))
        return model.tree_replace({"actuator_gainprm": gain, "actuator_biasprm": bias}), control

    def _laden(self, body: BodyParameters) -> mjx.Model:
        """The model with one robot's friction and masses."""
        f, model, values = self.figures, self._mjx_model, {}
        if body.foot_friction is not None:
            values["geom_friction"] = model.geom_friction.at[f.feet, 0].set(body.foot_friction)
        if body.torso_mass is not None:
            mass, inertia = f.laden_torso(body.torso_mass)
            values["body_mass"] = model.body_mass.at[f.torso].set(mass)
            values["body_inertia"] = model.body_inertia.at[f.torso].set(inertia)
        if body.torso_com is not None:
            values["body_ipos"] = model.body_ipos.at[f.torso].set(f.torso_com + body.torso_com)
        return model.tree_replace(values) if values else model

    def _gains(self, target: JointTarget, body: BodyParameters, copies: int) -> tuple[jax.Array, jax.Array]:
        """Position and damping gains in force, (N, 25) each."""
        own_kp, own_kd = self.figures.scaled_gains(body.kp_scale, body.kd_scale)
        kp, kd = own_kp if target.kp is None else target.kp, own_kd if target.kd is None else target.kd
        shape = (copies, len(JOINT_NAMES))
        return jnp.broadcast_to(jnp.asarray(kp, jnp.float32), shape), jnp.broadcast_to(
            jnp.asarray(kd, jnp.float32), shape
        )

    def _template(self, copies: int) -> mjx.Data:
        """Working memory for a batch; the warp backend keeps the contacts of all copies in one array."""
        key = 0 if self._backend == "jax" else copies
        if key not in self._data:
            sizes = {}
            if self._backend == "warp":
                model = self._variant_model
                rows_each = 4 if model.opt.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL else 3
                limits = int(model.jnt_limited.sum() + (model.dof_frictionloss > 0).sum())
                sizes = {"naconmax": copies * self._contacts, "njmax": limits + rows_each * self._contacts}
            with jax.ensure_compile_time_eval():
                self._data[key] = mjx.make_data(self._variant_model, impl=self._backend, **sizes)
        return self._data[key]


_FOOT_FORCES = ("left_foot_force", "right_foot_force")


def _is_sole(geom: str) -> bool:
    """Whether a shape is one that a foot touches the ground with."""
    return "_foot" in geom or "_toe" in geom


def _force_sensor(geom: str) -> str:
    return f"{geom}_force"


def _add_force_sensor(spec: mujoco.MjSpec, geom: mujoco.MjsGeom) -> None:
    sensor = spec.add_sensor(
        name=_force_sensor(geom.name),
        type=mujoco.mjtSensor.mjSENS_CONTACT,
        objtype=mujoco.mjtObj.mjOBJ_GEOM,
        objname="floor",
        reftype=mujoco.mjtObj.mjOBJ_GEOM,
        refname=geom.name,
    )
    sensor.intprm[0:3] = (_FORCE | _NORMAL | _TANGENT, _NEAREST, _CONTACTS[geom.type])


class _Sensors:
    """Places of a reading's quantities among the variant's sensors.

    Args:
        model: the variant.
        summed: whether the force on a foot is the sum over contact sensors of its shapes.
    """

    def __init__(self, model: mujoco.MjModel, summed: bool) -> None:
        def places(*names: str) -> np.ndarray:
            sensors = [model.sensor(name) for name in names]
            return np.concatenate([np.arange(s.adr[0], s.adr[0] + s.dim[0]) for s in sensors])

        def feet(quantity: str) -> np.ndarray:
            return places(f"left_foot_{quantity}", f"right_foot_{quantity}")

        self.torque = places(*(name.removesuffix("_joint") + "_torque" for name in JOINT_NAMES))
        self.foot_position, self.foot_velocity, self.foot_up = feet("position"), feet("velocity"), feet("up")
        self._contacts = None
        if not summed:
            self._force = feet("force")
            return
        soles = [model.geom(i).name for i in range(model.ngeom) if _is_sole(model.geom(i).name)]
        self._contacts = [
            places(*(_force_sensor(name) for name in soles if name.startswith(side))) for side in ("left", "right")
        ]

    def force(self, sensed: jax.Array) -> jax.Array:
        """Net force of the ground on each foot, world frame, (2, 3)."""
        if self._contacts is None:
            return sensed[self._force].reshape(2, 3)
        return jnp.stack([_world_force(sensed[places].reshape(-1, 9)) for places in self._contacts])


def _world_force(contacts: jax.Array) -> jax.Array:
    """Sum of contact forces, (3,), from rows of force in the contact's frame, its normal and its first tangent."""
    force, normal, tangent = contacts[:, 0:3], contacts[:, 3:6], contacts[:, 6:9]
    other = jnp.cross(normal, tangent)
    return jnp.sum(force[:, 0:1] * normal + force[:, 1:2] * tangent + force[:, 2:3] * other, axis=0)


def _without_warnings(model: mjx.Model) -> mjx.Model:
    """A model for warp that does not print a line for each solver that used up its iterations."""
    overflow: Any = importlib.import_module("mujoco.mjx.third_party.mujoco_warp").OverflowType

    kept = model.opt._impl.warn_overflow & ~(overflow.ITERATIONS | overflow.LS_ITERATIONS)
    return model.tree_replace({"opt._impl.warn_overflow": int(kept)})
