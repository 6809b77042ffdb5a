"""Batches of robots as a rollout drives them, the same on the C engine and on MJX."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any, Protocol

import mujoco
import numpy as np

from asimov_gym.evaluation.scenario import Conditions
from asimov_gym.evaluation.variants import build_model, variant_named
from asimov_gym.physics import BodyParameters, CPhysics, JointTarget, Reading
from asimov_gym.physics.parameters import ModelFigures
from asimov_gym.policy import PolicyContract, joint_gains
from asimov_gym.robot.joints import RANGE, STAND_POSITION
from asimov_gym.robot.observation import POLICY_RATE_HZ


class Robots(Protocol):
    """N robots that are stepped together."""

    @property
    def diverged(self) -> np.ndarray:
        """Robots whose simulation blew up in the last step, (N,) bool; they stand at the start again."""
        ...

    def read(self) -> Reading:
        """The present reading."""
        ...

    def step(self, position: np.ndarray, wrench: Mapping[str, np.ndarray] | None) -> Reading:
        """Advance by one policy step.

        Args:
            position: joint targets for each physics step, rad, (N, S, 25).
            wrench: forces and torques on bodies, world frame, (N, 6) by name.
        """
        ...

    def use_robot_gains(self, which: np.ndarray) -> None:
        """From the next step on, give robots the robot's own gains instead of the policy's.

        Args:
            which: (N,) bool.
        """
        ...

    def take(self, kept: np.ndarray) -> Robots | None:
        """The robots at some indices, going on as if nothing had happened; None where the engine cannot."""
        ...

    def close(self) -> None:
        """Free what the engine holds."""
        ...


def start_robots(
    contract: PolicyContract, conditions: list[Conditions], joint_errors: np.ndarray, threads: int | None
) -> Robots:
    """Robots in the standing pose at the origin of their ground, with the gains of a policy.

    Args:
        contract: the policy's.
        conditions: of each robot; physics, terrain and motor strength must be the same for all.
        joint_errors: added to the standing pose, rad, (N, 25); the result is kept within the joints' ranges.
        threads: of the C engine; the machine's cores when None.

    Raises:
        ValueError: a condition would have no effect on the model.
        ModuleNotFoundError: the engine is not installed.
    """
    first = conditions[0]
    variant = variant_named(first.physics)
    model = build_model(variant, first.terrain, first.motor_strength, first.weak_joints)
    body = body_parameters(contract, conditions, model)
    joints = np.clip(STAND_POSITION + joint_errors, RANGE[:, 0], RANGE[:, 1])
    if variant.engine == "mjx":
        return MjxRobots(conditions, body, joints)
    physics = CPhysics(len(conditions), variant.profile, threads, body, model)
    qpos, qvel = physics.standing()
    n = len(conditions)
    physics.reset(physics.configuration(joints, np.tile(qpos[:3], (n, 1)), np.tile(qpos[3:7], (n, 1))), qvel)
    return CRobots(physics, body, threads)


def body_parameters(
    contract: PolicyContract, conditions: list[Conditions], model: mujoco.MjModel
) -> BodyParameters | None:
    """What differs from the model as it is: the policy's gains, friction and payload; None where nothing does.

    Raises:
        ValueError: the friction of the soles is not the one that counts against this ground, so that a change of it
            would change nothing.
    """
    n = len(conditions)
    gains = BodyParameters.with_gains(*joint_gains(contract), n)
    feet = ModelFigures(model).feet
    friction = np.array([c.foot_friction for c in conditions])
    payload = np.array([c.payload_kg for c in conditions])
    grounds = [i for i in range(model.ngeom) if model.geom_bodyid[i] == 0 and model.geom_contype[i] != 0]
    if len(feet) == 0 or model.geom_priority[feet].min() <= model.geom_priority[grounds].max():
        raise ValueError("conditions.foot_friction would do nothing: the ground's contact figures outrank the soles'")
    same_friction = bool((friction == model.geom_friction[feet, 0].min()).all()) and bool(
        (model.geom_friction[feet, 0] == model.geom_friction[feet[0], 0]).all()
    )
    values: dict[str, Any] = {} if gains is None else {"kp_scale": gains.kp_scale, "kd_scale": gains.kd_scale}
    if not same_friction:
        values["foot_friction"] = friction
    if payload.any():
        values["torso_mass"] = payload
    return BodyParameters(**values) if values else None


def _reset_gains(body: BodyParameters, which: np.ndarray) -> bool:
    """Set the gains of robots to the robot's own, in place; False where they are already."""
    if body.kp_scale is None or body.kd_scale is None:
        return False
    body.kp_scale[which] = body.kd_scale[which] = 1.0
    return True


class CRobots:
    """Robots on MuJoCo's C engine."""

    def __init__(self, physics: CPhysics, body: BodyParameters | None, threads: int | None) -> None:
        self.physics = physics
        self._body, self._threads = body, threads
        self._substeps = round(1.0 / (POLICY_RATE_HZ * physics.timestep))

    @property
    def diverged(self) -> np.ndarray:
        return self.physics.diverged

    def read(self) -> Reading:
        return self.physics.read()

    def step(self, position: np.ndarray, wrench: Mapping[str, np.ndarray] | None) -> Reading:
        return self.physics.step(JointTarget(position), self._substeps, wrench)

    def use_robot_gains(self, which: np.ndarray) -> None:
        if self._body is not None and which.any() and _reset_gains(self._body, which):
            self.physics.set_parameters(self._body, which)

    def take(self, kept: np.ndarray) -> CRobots:
        state, body = self.physics.state(), self._body
        if body is not None:
            body = BodyParameters(**{k: None if v is None else v[kept] for k, v in vars(body).items()})
        fewer = CPhysics(len(kept), self.physics.profile, self._threads, body, self.physics.model)
        fewer.set_state(type(state)(**{f.name: getattr(state, f.name)[kept] for f in fields(state)}))
        self.close()
        return CRobots(fewer, body, self._threads)

    def close(self) -> None:
        self.physics.close()


class MjxRobots:
    """Robots on MJX's jax backend. Scenarios see to it that the floor is flat, motors are whole and nobody pushes."""

    def __init__(self, conditions: list[Conditions], body: BodyParameters | None, joints: np.ndarray) -> None:
        try:
            from asimov_gym.physics import functional
        except ModuleNotFoundError as error:
            raise ModuleNotFoundError(f"conditions.physics 'mjx': {error}") from error
        import jax
        import jax.numpy as jnp

        variant = variant_named("mjx")
        engine = functional.MjxEngine(variant.profile, "jax")
        qpos, qvel = engine.standing()
        n = len(conditions)
        start = engine.configuration(
            jnp.asarray(joints, dtype=jnp.float32), np.tile(qpos[:3], (n, 1)), np.tile(qpos[3:7], (n, 1))
        )
        self._engine, self._substeps = engine, variant.substeps
        self._simulation = engine.start(start, jnp.tile(jnp.asarray(qvel, dtype=jnp.float32), (n, 1)))
        self._body = body

        def step(simulation: Any, position: Any, gains: tuple[Any, Any]) -> Any:
            own = None if body is None else replace(body, kp_scale=gains[0], kd_scale=gains[1])
            return engine.step(simulation, JointTarget(position), variant.substeps, own)

        self._step = jax.jit(step)
        self.diverged = np.zeros(n, dtype=bool)

    def read(self) -> Reading:
        reading = self._engine.read(self._simulation)
        return Reading(**{f.name: np.asarray(getattr(reading, f.name), dtype=np.float64) for f in fields(reading)})

    def step(self, position: np.ndarray, wrench: Mapping[str, np.ndarray] | None) -> Reading:
        assert wrench is None
        gains = (None, None) if self._body is None else (self._body.kp_scale, self._body.kd_scale)
        self._simulation, diverged = self._step(self._simulation, np.asarray(position, dtype=np.float32), gains)
        self.diverged = np.asarray(diverged)
        return self.read()

    def use_robot_gains(self, which: np.ndarray) -> None:
        if self._body is not None:
            _reset_gains(self._body, which)

    def take(self, kept: np.ndarray) -> None:
        return None  # another batch size would be compiled anew

    def close(self) -> None:
        return None
