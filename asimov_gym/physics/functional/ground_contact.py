"""Contacts of the feet with the ground on MJX: how many there can be, and what force they carry."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from asimov_gym.physics.functional.quiet_mjx import mjx

_PLANE, _FIELD, _BOX = (mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtGeom.mjGEOM_HFIELD, mujoco.mjtGeom.mjGEOM_BOX)
_SPHERE, _CAPSULE = mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_CAPSULE
CONTACTS: Mapping[tuple[mujoco.mjtGeom, mujoco.mjtGeom], int] = MappingProxyType(
    {
        (_PLANE, _SPHERE): 1,
        (_PLANE, _CAPSULE): 2,
        (_PLANE, _BOX): 4,
        (_FIELD, _SPHERE): 4,
        (_FIELD, _CAPSULE): 4,
        (_BOX, _SPHERE): 1,
        (_BOX, _CAPSULE): 2,
    }
)
"""Most contacts between a shape of the ground and one of a foot, on either backend. (C MuJoCo allows more between a
height field and a shape; MJX keeps four of them.)"""
MOST_CONTACTS = 128
"""Contacts that a robot may possibly have before MJX is refused: it calculates with all of them in every step."""


def possible_contacts(model: mujoco.MjModel, ground_name: str) -> int:
    """Most contacts that one robot can have at a time, where only its feet touch, and only the ground.

    Args:
        model: compiled.
        ground_name: of the terrain, for the message.

    Raises:
        ValueError: more than MJX is used with, or a pair of shapes that it is not used with; says what can be done.
    """
    ground = np.flatnonzero((model.geom_bodyid == 0) & (model.geom_contype != 0))
    feet = np.flatnonzero((model.geom_bodyid != 0) & (model.geom_conaffinity != 0))
    total = 0
    for below in ground:
        for foot in feet:
            pair = mujoco.mjtGeom(model.geom_type[below]), mujoco.mjtGeom(model.geom_type[foot])
            if pair not in CONTACTS:
                names = f"{model.geom(below).name!r} and {model.geom(foot).name!r}"
                raise ValueError(f"MJX is not prepared for contacts between {names}: use physics='c'")
            total += CONTACTS[pair]
    if total > MOST_CONTACTS:
        raise ValueError(
            f"terrain {ground_name!r} cannot run on MJX: a robot could have {total} contacts with it, at most "
            f"{MOST_CONTACTS} are affordable; use physics='c', or another terrain such as 'rough'"
        )
    return total


def foot_signs(model: mujoco.MjModel) -> np.ndarray:
    """1 where a geom belongs to the left or the right foot, (2, ngeom)."""
    roots = [model.body(f"{side}_ankle_roll_link").id for side in ("left", "right")]
    signs = np.zeros((2, model.ngeom), dtype=np.float32)
    for geom in range(model.ngeom):
        body = model.geom_bodyid[geom]
        while body not in (0, *roots):
            body = model.body_parentid[body]
        if body:
            signs[roots.index(body), geom] = 1.0
    return signs


def ground_force(data: mjx.Data, elliptic: bool, signs: np.ndarray) -> jax.Array:
    """Net force of the ground on each foot in the last step, world frame, N, (2, 3); for the jax backend.

    Args:
        data: of one robot whose contacts all have one normal and two tangential directions.
        elliptic: friction cone; pyramidal otherwise.
        signs: `foot_signs`.
    """
    contact, force = data._impl.contact, data._impl.efc_force
    first = np.asarray(contact.efc_address)[:, None]
    if elliptic:
        local = force[first + np.arange(3)]
    else:  # two edges of the pyramid for each tangential direction
        edges, friction = force[first + np.arange(4)], contact.friction
        tangents = [friction[:, 0] * (edges[:, 0] - edges[:, 1]), friction[:, 1] * (edges[:, 2] - edges[:, 3])]
        local = jnp.stack([jnp.sum(edges, axis=1), *tangents], axis=1)
    touching = contact.dist < contact.includemargin
    world = jnp.sum(jnp.where(touching[:, None], local, 0.0)[:, :, None] * contact.frame, axis=1)
    table = jnp.asarray(signs)
    acting = table[:, contact.geom[:, 1]] - table[:, contact.geom[:, 0]]  # the force acts on a contact's second geom
    return jnp.sum(acting[:, :, None] * world, axis=1)
