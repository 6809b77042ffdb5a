"""How the robot moves: physics engines that take a `JointTarget` and return a `Reading`."""

from asimov_gym.physics.c_physics import CPhysics, compile_model
from asimov_gym.physics.parameters import BodyParameters
from asimov_gym.physics.profile import DECIMATION, ENGINES, PROFILES, TIMESTEP, PhysicsProfile, physics_profile
from asimov_gym.physics.quantities import JointTarget, PhysicsState, Reading, delayed_position

__all__ = [
    "DECIMATION",
    "ENGINES",
    "PROFILES",
    "TIMESTEP",
    "BodyParameters",
    "CPhysics",
    "JointTarget",
    "PhysicsProfile",
    "PhysicsState",
    "Reading",
    "compile_model",
    "delayed_position",
    "physics_profile",
]
