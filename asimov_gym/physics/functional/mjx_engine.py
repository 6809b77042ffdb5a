"""MuJoCo's own JAX port, MJX: its jax backend runs anywhere, its warp backend is for NVIDIA (elsewhere for tests)."""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Literal

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from asimov_gym.physics.functional.engine import Engine, Simulation, choose, rows
from asimov_gym.physics.functional.ground_contact import foot_signs, ground_force, possible_contacts
from asimov_gym.physics.functional.quiet_mjx import mjx
from asimov_gym.physics.parameters import BodyParameters
from asimov_gym.physics.profile import PhysicsProfile
from asimov_gym.physics.quantities import JointTarget, is_sound
from asimov_gym.robot.joints import JOINT_NAMES
from asimov_gym.robot.terrain import Terrain

Backend = Literal["jax", "warp"]


class MjxEngine(Engine):
    """MJX as a function of its state.

    The arrays for contacts and constraints are as large as this robot can ever need on its terrain, so they cannot
    overflow.

    Args:
        profile: physics profile; one in which only the feet touch the ground, and without noslip iterations.
        backend: `jax` or `warp`.
        spec: another robot than the shipped one, or other surroundings.
        terrain: the ground, or its name; flat when None.
        trail: how many earlier moments of the joints a simulation remembers.

    Raises:
        ValueError: MJX cannot run the profile or the terrain.
        ModuleNotFoundError: the warp backend is wanted and not installed.
    """

    def __init__(
        self,
        profile: str | PhysicsProfile = "training",
        backend: Backend = "jax",
        spec: Callable[[], mujoco.MjSpec] | None = None,
        terrain: Terrain | str | None = None,
        trail: int = 0,
    ) -> None:
        super().__init__(profile, spec, terrain, trail)
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
        self.contacts = possible_contacts(variant, self.terrain.name)
        """Most contacts that one robot can have at a time."""
        self._sensors = _Sensors(variant)
        self._foot_signs = foot_signs(variant)
        self._variant_model = variant
        self._mjx_model = mjx.put_model(variant, impl=backend)
        if backend == "warp":
            self._mjx_model = _without_warnings(self._mjx_model)
        self._loads = np.array([variant.actuator(n.removesuffix("_joint") + "_load").id for n in JOINT_NAMES])
        self._servos = np.array([variant.actuator(n.removesuffix("_joint")).id for n in JOINT_NAMES])
        limits = variant.jnt_actfrcrange[[variant.joint(n).id for n in JOINT_NAMES]].astype(np.float32)
        self._limits = limits[:, 0], limits[:, 1]
        self._data: dict[int, mjx.Data] = {}

    def _variant(self) -> mujoco.MjModel:
        """The model with the sensors that the backend has, and that a reading needs."""
        spec = self._spec()
        for sensor in list(spec.sensors):
            # The jax backend has no sensors of the force between two bodies.
            if sensor.name.startswith("imu_") or (self._backend == "jax" and sensor.name in _FOOT_FORCES):
                spec.delete(sensor)
        return spec.compile()

    def step(
        self,
        simulation: Simulation,
        target: JointTarget,
        substeps: int,
        body: BodyParameters | None = None,
        wrench: Mapping[str, Any] | None = None,
    ) -> tuple[Simulation, Any]:
        n = simulation.qpos.shape[0]
        body = BodyParameters() if body is None else body
        kp, kd = self._gains(target, body, n)
        load = jnp.zeros((n, substeps, len(JOINT_NAMES))) if target.load is None else rows(target.load, substeps)
        if target.velocity is not None:
            load = load + kd[:, None, :] * rows(target.velocity, substeps)
        one = partial(self._step_one, self._template(n))
        with jax.default_matmul_precision("highest"):  # the tensor cores' rounding would spoil the dynamics
            after = jax.vmap(one)(simulation, rows(target.position, substeps), load, kp, kd, body, dict(wrench or {}))
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
        wrench: Mapping[str, jax.Array],
    ) -> Simulation:
        """One robot through all substeps; targets and loads are (S, 25), gains (25,), wrenches (6,) by body name."""
        model = self._laden(body)
        data = data.replace(
            time=simulation.time, qpos=simulation.qpos, qvel=simulation.qvel, qacc_warmstart=simulation.warmstart
        )
        if wrench:
            pushed = np.array([self._variant_model.body(name).id for name in wrench])
            forces = jnp.stack([jnp.asarray(value, jnp.float32) for value in wrench.values()])
            data = data.replace(xfrc_applied=data.xfrc_applied.at[pushed].set(forces))

        def substep(data: mjx.Data, row: tuple[jax.Array, jax.Array]) -> tuple[mjx.Data, Any]:
            driven, control = self._driven(model, data, *row, kp, kd)
            start = self.joint_state(data.qpos, data.qvel) if self.trail else None
            return mjx.step(driven, data.replace(ctrl=control)), start

        data, starts = jax.lax.scan(substep, data, (position, load))
        sensed, places, feet = data.sensordata, self._sensors, (2, 3)
        if self._backend == "jax":
            elliptic = self._variant_model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
            foot_force = ground_force(data, elliptic, self._foot_signs)
        else:
            foot_force = sensed[places.foot_force].reshape(feet)
        return Simulation(
            time=data.time,
            qpos=data.qpos,
            qvel=data.qvel,
            warmstart=data.qacc_warmstart,
            joint_torque=sensed[places.torque],
            foot_position=sensed[places.foot_position].reshape(feet),
            foot_velocity=sensed[places.foot_velocity].reshape(feet),
            foot_up=sensed[places.foot_up].reshape(feet),
            foot_force=foot_force,
            joint_trail=starts[::-1][: self.trail] if self.trail else None,
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
                sizes = {"naconmax": copies * self.contacts, "njmax": limits + rows_each * self.contacts}
            with jax.ensure_compile_time_eval():
                self._data[key] = mjx.make_data(self._variant_model, impl=self._backend, **sizes)
        return self._data[key]


_FOOT_FORCES = ("left_foot_force", "right_foot_force")


class _Sensors:
    """Places of a reading's quantities among the variant's sensors."""

    def __init__(self, model: mujoco.MjModel) -> None:
        def places(*names: str) -> np.ndarray:
            sensors = [model.sensor(name) for name in names]
            return np.concatenate([np.arange(s.adr[0], s.adr[0] + s.dim[0]) for s in sensors])

        def feet(quantity: str) -> np.ndarray:
            return places(f"left_foot_{quantity}", f"right_foot_{quantity}")

        self.torque = places(*(name.removesuffix("_joint") + "_torque" for name in JOINT_NAMES))
        self.foot_position, self.foot_velocity, self.foot_up = feet("position"), feet("velocity"), feet("up")
        names = {model.sensor(i).name for i in range(model.nsensor)}
        self.foot_force = feet("force") if names.issuperset(_FOOT_FORCES) else None


def _without_warnings(model: mjx.Model) -> mjx.Model:
    """A model for warp that does not print a line for each solver that used up its iterations."""
    overflow: Any = importlib.import_module("mujoco.mjx.third_party.mujoco_warp").OverflowType

    kept = model.opt._impl.warn_overflow & ~(overflow.ITERATIONS | overflow.LS_ITERATIONS)
    return model.tree_replace({"opt._impl.warn_overflow": int(kept)})
