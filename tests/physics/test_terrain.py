"""Robots on terrain, on C MuJoCo: they stand, and their feet feel the ground whatever it is made of."""

from __future__ import annotations

import numpy as np
import pytest

from asimov_gym.physics import CPhysics, JointTarget, PhysicsProfile, compile_model
from asimov_gym.robot.joints import STAND_POSITION, joint_index
from asimov_gym.robot.terrain import Terrain, terrain_named

WEIGHT = 32.2249 * 9.81
"""N."""
STAND_HEIGHT = 0.6145
"""Of the pelvis over the soles, m."""
CONVERGED = PhysicsProfile(
    "converged", False, 1.0, 0, iterations=50, ls_iterations=50, bodies_collide=False, dry_friction=False
)
"""The training profile with a solver that runs to its end: the forces of the shortened one tremble."""


def pose_on(terrain: Terrain) -> np.ndarray:
    """The standing pose, on a tilted floor with soles flat on it for a robot that faces uphill, (25,)."""
    pose = STAND_POSITION.copy()
    for side, sign in (("left", -1.0), ("right", 1.0)):  # the joints of a pair turn in opposite directions
        pose[joint_index(f"{side}_ankle_pitch_joint")] += sign * np.radians(terrain.tilt_deg)
    return pose


def standing(terrain: Terrain, places: np.ndarray, profile: str | PhysicsProfile) -> CPhysics:
    """Robots at rest that face +x over places (N, 2)."""
    model = compile_model(profile, visuals=False, terrain=terrain)
    physics = CPhysics(len(places), profile, threads=1, model=model)
    qpos, qvel = (np.tile(part, (len(places), 1)) for part in physics.standing())
    qpos[:, 0:2], qpos[:, 2] = places, STAND_HEIGHT + terrain.standing_height(*places.T)
    physics.reset(qpos, qvel)
    return physics


PLACES = {
    "flat": [[0.0, 0.0], [3.0, -2.0]],
    "slope:3": [[0.0, 0.0], [2.0, 1.0], [-1.0, 0.5]],
    "rough:0.02": [[-4.0, 3.0], [0.0, 0.0], [1.0, 2.0], [3.0, -5.0], [5.0, 5.0], [-2.0, -3.0]],
    "steps": [[3.05, 0.0], [2.0, 2.65]],
    "stairs_10cm": [[3.65, 0.0], [-0.5, 0.0]],
    "slope_10deg": [[3.95, 1.0]],
    "rough_tiles": [[2.0, 0.0], [4.0, 1.0], [5.0, -1.0], [3.5, 2.0]],
}
"""Where robots stand that hold a pose and nothing else; on uneven ground some of them topple."""


@pytest.mark.parametrize("profile", ["evaluation", CONVERGED], ids=["evaluation", "feet only"])
@pytest.mark.parametrize("name", PLACES)
def test_feet_carry_the_weight(name: str, profile: str | PhysicsProfile) -> None:
    terrain, places = terrain_named(name), np.array(PLACES[name])
    physics = standing(terrain, places, profile)
    target, forces = JointTarget(np.tile(pose_on(terrain), (len(places), 1))), []
    for _ in range(100):
        reading = physics.step(target, 4)
        forces.append(reading.foot_force[:, :, 2].sum(axis=1))
    pelvis = reading.base_position
    upright = (reading.gravity[:, 2] < -0.98) & (np.abs(physics.state().qvel).max(axis=1) < 0.5)
    assert upright.sum() >= (len(places) + 1) // 2, "too many toppled for this to say anything"
    np.testing.assert_allclose(np.mean(forces[-25:], axis=0)[upright], WEIGHT, rtol=0.02)
    height = (pelvis[:, 2] - terrain.height(*pelvis[:, :2].T))[upright]
    assert ((height > 0.59) & (height < 0.64)).all()
    physics.close()


def test_both_feet_are_felt_apart() -> None:
    """One foot on the top of a flight of stairs, the other in the air beside it."""
    terrain = terrain_named("stairs_10cm")
    physics = standing(terrain, np.array([[3.65, 3.0]]), CONVERGED)
    force = physics.step(JointTarget(STAND_POSITION[None]), 12).foot_force[0, :, 2]
    assert force[0] == 0.0 and force[1] > 50.0  # the robot's left is +y, where the stairs end
    physics.close()
