"""The robot as a MuJoCo model: `assets/asimov1.xml` with the figures of the chosen revision laid over it."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache

import mujoco
import numpy as np

from asimov_gym.assets import asset_path
from asimov_gym.robot.revisions import (
    FEET,
    LEG_FRAMES,
    PELVIS_HEIGHT,
    TOE_FEET,
    TOES,
    BodyFigures,
    Capsule,
    Toe,
    Vector,
)
from asimov_gym.robot.terrain import Terrain, terrain_named

_VISUAL_GROUP = 2


@dataclass(frozen=True)
class Revision:
    """A revision of the robot; `str()` gives the form used in policy metadata, such as `shifted/rigid`.

    Raises:
        ValueError: an option is unknown; the message names the field, the value and the options.
    """

    leg_frames: str = "shifted"
    """`shifted` (the newest model file, used by official policies) or `cad` (axes as in the link meshes)."""
    foot: str = "rigid"
    """`rigid` (the newest part) or `toe` (a passive spring toe on each foot)."""

    def __post_init__(self) -> None:
        for field, value, options in (("leg_frames", self.leg_frames, tuple(LEG_FRAMES)), ("foot", self.foot, FEET)):
            if value not in options:
                raise ValueError(f"{field} must be one of {', '.join(map(repr, options))}, got {value!r}")

    def __str__(self) -> str:
        return f"{self.leg_frames}/{self.foot}"

    @classmethod
    def parse(cls, text: str) -> Revision:
        """The revision that a string such as `shifted/rigid` names.

        Raises:
            ValueError: not of the form `leg_frames/foot`, or an unknown option.
        """
        parts = text.split("/")
        if len(parts) != 2:
            raise ValueError(f"robot revision must read 'leg_frames/foot', such as 'shifted/rigid', got {text!r}")
        return cls(*parts)


def robot_spec(
    leg_frames: str = "shifted", foot: str = "rigid", visuals: bool = True, terrain: Terrain | str | None = None
) -> mujoco.MjSpec:
    """An editable specification of the robot on its ground.

    Args:
        leg_frames: `shifted` or `cad`; see `Revision`.
        foot: `rigid` or `toe`. Toes add two passive joints behind their ankle roll joints in tree order (nq 34, nv 33);
            the 25 actuators, their order and the sensors stay.
        visuals: False drops everything that is only seen (shapes, meshes, textures). The dynamics are the same, a step
            is about a tenth cheaper, and the model is small enough to be copied a thousand times.
        terrain: the ground, or its name; the flat floor when None. The keyframes stand on it.

    Raises:
        ValueError: an option is unknown.
    """
    revision = Revision(leg_frames, foot)
    spec = mujoco.MjSpec.from_file(str(asset_path("asimov1.xml")))
    for name, figures in LEG_FRAMES[revision.leg_frames].items():
        _write_figures(spec.body(name), figures)
    poses = {key.name: _joint_angles(spec, key) for key in spec.keys}
    if revision.foot == "toe":
        _replace_feet(spec)
    for key, height in zip(spec.keys, PELVIS_HEIGHT[revision.leg_frames, revision.foot], strict=True):
        angles = poses[key.name]
        hinges = [joint.name for joint in spec.joints if joint.type == mujoco.mjtJoint.mjJNT_HINGE]
        key.qpos = [0.0, 0.0, height, 1.0, 0.0, 0.0, 0.0, *(angles.get(name, 0.0) for name in hinges)]
    if terrain is not None:
        terrain_named(terrain).lay(spec)
    spec.compiler.discardvisual = not visuals
    return spec


def robot_model(
    leg_frames: str = "shifted", foot: str = "rigid", visuals: bool = True, terrain: Terrain | str | None = None
) -> mujoco.MjModel:
    """The compiled model; arguments and errors as for `robot_spec`."""
    return robot_spec(leg_frames, foot, visuals, terrain).compile()


def robot_revision(leg_frames: str = "shifted", foot: str = "rigid") -> str:
    """Name of a revision in policy metadata, such as `shifted/rigid`.

    Raises:
        ValueError: an option is unknown.
    """
    return str(Revision(leg_frames, foot))


@cache
def model_sha256(leg_frames: str = "shifted", foot: str = "rigid") -> str:
    """Hash of the robot's figures that a policy depends on.

    Covered: the tree of bodies with their frames and mass properties, joints with drives, collision shapes, contact
    exclusions, actuators, and the sites of the sensors. Not covered: what is only seen, the floor, solver and time step
    (a policy's contract states its rates itself). It is taken over the figures as written, to nine digits, before
    MuJoCo derives anything from them, so it is the same on every platform.

    Returns:
        64 hexadecimal digits.
    """
    return hashlib.sha256("\n".join(_canonical(robot_spec(leg_frames, foot))).encode()).hexdigest()


def _write_figures(body: mujoco.MjsBody, figures: BodyFigures) -> None:
    body.mass, body.ipos, body.fullinertia = figures.mass, figures.com, figures.inertia
    if figures.pos is not None:
        body.pos = figures.pos


def _joint_angles(spec: mujoco.MjSpec, key: mujoco.MjsKey) -> dict[str, float]:
    """Joint angles of a keyframe by name. Its qpos holds the free joint's seven values, then hinges in tree order."""
    hinges = [joint.name for joint in spec.joints if joint.type == mujoco.mjtJoint.mjJNT_HINGE]
    return dict(zip(hinges, np.asarray(key.qpos)[7:], strict=True))


def _replace_feet(spec: mujoco.MjSpec) -> None:
    """Exchange the rigid feet for feet with toes."""
    for mesh, extent in (("toe_foot_shell", (0.076, 0.040, 0.019)), ("toe_shell", (0.039, 0.042, 0.016))):
        added = spec.add_mesh(name=mesh, scale=extent)
        added.make_supersphere(28, 0.55, 0.55)
    for name, foot in TOE_FEET.items():
        body = spec.body(name)
        _write_figures(body, foot.figures)
        for geom in list(body.geoms):
            if geom.name or geom.type == mujoco.mjtGeom.mjGEOM_MESH:  # contact spheres and the shoe; brackets stay
                spec.delete(geom)
        _add_capsules(spec, body, foot.capsules)
        _add_shell(spec, body, "toe_foot_shell", (0.028, 0.0, -0.014), material="shell")
        spec.site(foot.site).pos = foot.site_pos
    for toe in TOES:
        _add_toe(spec, toe)


def _add_toe(spec: mujoco.MjSpec, toe: Toe) -> None:
    body = spec.body(toe.foot).add_body(name=toe.body, explicitinertial=True)
    _write_figures(body, toe.figures)
    body.add_joint(
        name=toe.joint,
        type=mujoco.mjtJoint.mjJNT_HINGE,
        axis=toe.axis,
        range=toe.range,
        stiffness=[toe.stiffness, 0.0, 0.0],
        damping=[toe.damping, 0.0, 0.0],
        armature=toe.armature,
        frictionloss=toe.frictionloss,
        solref_limit=toe.limit_solref,
        solimp_limit=[*toe.limit_solimp, 0.5, 2.0],
        margin=toe.limit_margin,
    )
    _add_capsules(spec, body, toe.capsules)
    _add_shell(spec, body, "toe_shell", (0.034, 0.0, -0.0125), material="toe_cap")
    spec.add_exclude(bodyname1=toe.foot, bodyname2=toe.body)


def _add_capsules(spec: mujoco.MjSpec, body: mujoco.MjsBody, capsules: Iterable[Capsule]) -> None:
    default = spec.find_default("foot_collision")
    for capsule in capsules:
        geom = body.add_geom(default, name=capsule.name, type=mujoco.mjtGeom.mjGEOM_CAPSULE)
        geom.fromto = [*capsule.start, *capsule.end]
        geom.size = [capsule.radius, 0.0, 0.0]


def _add_shell(spec: mujoco.MjSpec, body: mujoco.MjsBody, mesh: str, pos: Vector, material: str) -> None:
    geom = body.add_geom(spec.find_default("shell"), meshname=mesh, pos=pos)
    geom.material = material


def _canonical(spec: mujoco.MjSpec) -> list[str]:
    """The robot's figures as lines of text, in tree order."""
    lines: list[str] = []

    def write(kind: str, name: str, *values: object) -> None:
        lines.append(" ".join([kind, name, *map(_text, values)]))

    for body in spec.bodies[1:]:
        write("body", body.name, body.parent.name, body.pos, body.quat, body.mass, body.ipos, body.fullinertia)
        for joint in body.joints:
            write(
                "joint", joint.name, int(joint.type), joint.pos, joint.axis, joint.ref, joint.range, joint.actfrcrange
            )
            write(
                "drive", joint.name, joint.armature, joint.frictionloss, joint.damping, joint.stiffness, joint.springref
            )
            write("limit", joint.name, joint.solref_limit, joint.solimp_limit, joint.margin)
        for geom in body.geoms:
            if geom.contype or geom.conaffinity:
                # fromto is NaN where a shape is given by its pose instead
                write("geom", geom.name, int(geom.type), geom.size, geom.pos, geom.quat, geom.fromto)
                write("contact", geom.name, geom.friction, geom.condim, geom.priority, geom.solref, geom.solimp)
        for site in body.sites:
            write("site", site.name, site.pos, site.quat)
    for exclude in spec.excludes:
        write("exclude", *sorted((exclude.bodyname1, exclude.bodyname2)))
    for actuator in spec.actuators:
        write("actuator", actuator.name, actuator.target, actuator.gainprm, actuator.biasprm, actuator.gear)
    return lines


def _text(value: object) -> str:
    """A name as it is; numbers to nine digits, zero without sign.

    Trailing zeros are dropped: the length of some coefficient arrays differs between MuJoCo versions.
    """
    if isinstance(value, str):
        return value
    numbers = np.trim_zeros(np.atleast_1d(np.asarray(value, dtype=np.float64)), "b") + 0.0
    return ",".join(format(number, ".9g") for number in numbers)
