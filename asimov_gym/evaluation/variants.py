"""The physics that a policy is judged in: the evaluation conditions, and others that a good policy does not notice."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import lru_cache
from types import MappingProxyType
from typing import Literal

import mujoco

from asimov_gym.physics import DECIMATION, PROFILES, TIMESTEP, PhysicsProfile, compile_model
from asimov_gym.robot.joints import JOINT_NAMES

_SOLVERS = {
    "newton": mujoco.mjtSolver.mjSOL_NEWTON,
    "cg": mujoco.mjtSolver.mjSOL_CG,
    "pgs": mujoco.mjtSolver.mjSOL_PGS,
}


@dataclass(frozen=True)
class Variant:
    """Engine, contact settings, solver and time step."""

    name: str
    description: str
    profile: PhysicsProfile
    engine: Literal["c", "mjx"] = "c"
    solver: str = "newton"
    substeps: int = DECIMATION
    """Physics steps per policy step of 20 ms."""

    @property
    def timestep(self) -> float:
        """Physics step, s."""
        return TIMESTEP * DECIMATION / self.substeps


_EVALUATION = PROFILES["evaluation"]
# What MJX can do of the evaluation conditions: it has no noslip iterations, and testing every pair of bodies for
# contact would take it minutes. C MuJoCo with the same settings is beside it, so that one thing differs at a time.
# Iterations are the evaluation's: with 10 the solver is stopped early, and the feet slip until the robot falls.
_FEET_ONLY = replace(_EVALUATION, name="feet_only", noslip_iterations=0, bodies_collide=False)

VARIANTS = MappingProxyType(
    {
        variant.name: variant
        for variant in (
            Variant("evaluation", "the evaluation conditions", _EVALUATION),
            Variant("half_step", "time step of 2.5 ms instead of 5", _EVALUATION, substeps=2 * DECIMATION),
            Variant("cg", "conjugate gradients instead of Newton", _EVALUATION, solver="cg"),
            Variant("feet_only", "only the feet touch, only the ground; no noslip iterations", _FEET_ONLY),
            Variant("mjx", "`feet_only` on MJX, float32", _FEET_ONLY, engine="mjx"),
            Variant("training", "the fast physics of the training", PROFILES["training"]),
        )
    }
)
"""Variants by name."""


def variant_named(name: str) -> Variant:
    """A variant.

    Raises:
        ValueError: the name is unknown; the message lists the known ones.
    """
    if name not in VARIANTS:
        raise ValueError(f"conditions.physics must be one of {', '.join(VARIANTS)}, got {name!r}")
    return VARIANTS[name]


@lru_cache(maxsize=16)
def _compiled(variant: str, terrain: str) -> mujoco.MjModel:
    v = VARIANTS[variant]
    model = compile_model(v.profile, visuals=False, terrain=terrain)
    model.opt.solver = _SOLVERS[v.solver]
    model.opt.timestep = v.timestep
    return model


def build_model(
    variant: Variant, terrain: str = "flat", motor_strength: float = 1.0, weak_joints: Iterable[str] = ()
) -> mujoco.MjModel:
    """The robot on its ground under a variant, for the C engine.

    Args:
        variant: the physics.
        terrain: name for `asimov_gym.robot.terrain.terrain_named`.
        motor_strength: factor on the torque limits.
        weak_joints: joints that it acts on; all when empty.
    """
    model = mujoco.MjModel.__copy__(_compiled(variant.name, terrain))
    if motor_strength != 1.0:
        for name in tuple(weak_joints) or JOINT_NAMES:
            model.jnt_actfrcrange[model.joint(name).id] *= motor_strength
    return model
