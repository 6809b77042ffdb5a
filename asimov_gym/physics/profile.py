"""How the robot's model is simulated: the solver and contact settings of training and of evaluation."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType

import mujoco

TIMESTEP = 0.005
"""Physics step, s: the rate of the robot's own control loop, 200 Hz."""
DECIMATION = 4
"""Physics steps per policy step: the policy runs at 50 Hz."""

ENGINES = ("c", "mjx", "warp")
"""What simulates it: MuJoCo in C on a thread pool, or MJX on its jax backend (any device) or warp backend (NVIDIA)."""


@dataclass(frozen=True)
class PhysicsProfile:
    """Settings laid over the MJCF. Everything not named here stays as the file has it."""

    name: str
    elliptic: bool
    """Elliptic friction cone; pyramidal otherwise."""
    impratio: float
    noslip_iterations: int
    iterations: int
    """Limit of solver iterations."""
    ls_iterations: int
    """Limit of line-search iterations."""
    bodies_collide: bool
    """Full collision set; otherwise only the feet touch, and only the ground."""
    dry_friction: bool
    """Dry joint friction as solver constraints; without it the step costs a quarter less."""

    def apply(self, spec: mujoco.MjSpec) -> None:
        """Write the settings into a specification of the robot."""
        option = spec.option
        option.timestep = TIMESTEP
        option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC if self.elliptic else mujoco.mjtCone.mjCONE_PYRAMIDAL
        option.impratio = self.impratio
        option.noslip_iterations = self.noslip_iterations
        option.iterations = self.iterations
        option.ls_iterations = self.ls_iterations
        if not self.bodies_collide:
            for geom in spec.geoms:
                is_ground = geom.parent.name == "world"
                is_foot = "_foot" in geom.name or "_toe" in geom.name
                geom.contype = int(is_ground and geom.contype != 0)
                geom.conaffinity = int(is_foot and geom.conaffinity != 0)
        if not self.dry_friction:
            for joint in spec.joints:
                joint.frictionloss = 0.0


PROFILES = MappingProxyType(
    {
        "evaluation": PhysicsProfile("evaluation", True, 10.0, 5, 100, 50, bodies_collide=True, dry_friction=True),
        "training": PhysicsProfile("training", False, 1.0, 0, 3, 4, bodies_collide=False, dry_friction=False),
    }
)
"""`evaluation` judges; `training` is the fast form for learning and is about three times cheaper."""


def physics_profile(name: str | PhysicsProfile) -> PhysicsProfile:
    """Profile by name; a profile passes unchanged.

    Raises:
        ValueError: the name is unknown; the message lists the known ones.
    """
    if isinstance(name, PhysicsProfile):
        return name
    if name not in PROFILES:
        raise ValueError(f"physics profile {name!r} is unknown; known profiles: {', '.join(PROFILES)}")
    return PROFILES[name]
