"""The robot as URDF, made from its MuJoCo model: for tools that do not read MJCF.

Links, masses, joints, limits, friction and the shapes that touch something are the model's. URDF knows no capsules, no
reflected inertia of drives and no servo gains: a capsule becomes a cylinder between two spheres, the others are left
out. The builtin meshes of the model's shell have no files and are left out, too.
"""

from __future__ import annotations

from xml.etree import ElementTree

import mujoco
import numpy as np

from asimov_gym.robot.joints import JOINTS
from asimov_gym.robot.model import robot_model

_Element = ElementTree.Element
_FREE = int(mujoco.mjtJoint.mjJNT_FREE)
_VELOCITY = {joint.name: joint.velocity_limit for joint in JOINTS}
_PASSIVE_VELOCITY = 100.0
"""Velocity limit of a joint without a drive, rad/s: URDF wants one."""


def urdf(leg_frames: str = "shifted", foot: str = "rigid") -> str:
    """The robot's description, with the pelvis as root.

    Sensor sites (IMU, soles) are links without mass on fixed joints.

    Args:
        leg_frames: see `asimov_gym.robot.model.Revision`.
        foot: likewise.

    Returns:
        An XML document.

    Raises:
        ValueError: an option is unknown.
    """
    model = robot_model(leg_frames, foot)
    root = ElementTree.Element("robot", name="asimov1")
    root.append(ElementTree.Comment(f" Asimov 1, revision {leg_frames}/{foot}. Units: m, kg, s, rad, N m. "))
    for body in range(1, model.nbody):
        root.append(_link(model, body))
    for joint in range(model.njnt):
        if model.jnt_type[joint] != _FREE:
            root.append(_joint(model, joint))
    for site in range(model.nsite):
        _add_frame(root, model, site)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _link(model: mujoco.MjModel, body: int) -> _Element:
    link = ElementTree.Element("link", name=model.body(body).name)
    inertial = ElementTree.SubElement(link, "inertial")
    _origin(inertial, model.body_ipos[body])
    ElementTree.SubElement(inertial, "mass", value=_text(model.body_mass[body]))
    tensor = _inertia(model.body_iquat[body], model.body_inertia[body])
    names = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    places = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
    entries = {name: _text(tensor[place]) for name, place in zip(names, places, strict=True)}
    ElementTree.SubElement(inertial, "inertia", entries)
    for geom in range(model.ngeom):
        if model.geom_bodyid[geom] != body:
            continue
        touches = model.geom_contype[geom] or model.geom_conaffinity[geom]
        for shape in _shapes(model, geom):
            link.append(_with_shape("collision" if touches else "visual", *shape))
            if touches and model.geom(geom).name:
                link[-1].set("name", f"{model.geom(geom).name}{len(link) - 2}")
    return link


def _with_shape(kind: str, name: str, sizes: dict[str, str], position: np.ndarray, quat: np.ndarray) -> _Element:
    element = ElementTree.Element(kind)
    _origin(element, position, quat)
    ElementTree.SubElement(ElementTree.SubElement(element, "geometry"), name, sizes)
    return element


def _shapes(model: mujoco.MjModel, geom: int) -> list[tuple[str, dict[str, str], np.ndarray, np.ndarray]]:
    """The URDF shapes of a geom: name, sizes, position and orientation in the link. None for a mesh."""
    size, position, quat = model.geom_size[geom], model.geom_pos[geom], model.geom_quat[geom]
    kind = mujoco.mjtGeom(int(model.geom_type[geom]))
    match kind:
        case mujoco.mjtGeom.mjGEOM_BOX:
            return [("box", {"size": _text(*(2.0 * size))}, position, quat)]
        case mujoco.mjtGeom.mjGEOM_SPHERE:
            return [("sphere", {"radius": _text(size[0])}, position, quat)]
        case mujoco.mjtGeom.mjGEOM_CYLINDER | mujoco.mjtGeom.mjGEOM_CAPSULE:
            shapes = [("cylinder", {"radius": _text(size[0]), "length": _text(2.0 * size[1])}, position, quat)]
            if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
                half = _rotation(quat)[:, 2] * size[1]
                ends = (position - half, position + half)
                shapes += [("sphere", {"radius": _text(size[0])}, end, quat) for end in ends]
            return shapes
    return []


def _joint(model: mujoco.MjModel, index: int) -> _Element:
    body = int(model.jnt_bodyid[index])
    name = model.joint(index).name
    joint = ElementTree.Element("joint", name=name, type="revolute")
    _origin(joint, model.body_pos[body], _zero_frame(model, index))
    ElementTree.SubElement(joint, "parent", link=model.body(model.body_parentid[body]).name)
    ElementTree.SubElement(joint, "child", link=model.body(body).name)
    ElementTree.SubElement(joint, "axis", xyz=_text(*model.jnt_axis[index]))
    low, high = model.jnt_range[index]
    effort = model.jnt_actfrcrange[index, 1]
    limit = {"lower": low, "upper": high, "effort": effort, "velocity": _VELOCITY.get(name, _PASSIVE_VELOCITY)}
    ElementTree.SubElement(joint, "limit", {key: _text(value) for key, value in limit.items()})
    dof = int(model.jnt_dofadr[index])
    friction = {"damping": model.dof_damping[dof], "friction": model.dof_frictionloss[dof]}
    ElementTree.SubElement(joint, "dynamics", {key: _text(np.ravel(value)[0]) for key, value in friction.items()})
    return joint


def _zero_frame(model: mujoco.MjModel, index: int) -> np.ndarray:
    """Orientation of a joint's link at angle 0: MJCF gives it at the joint's reference angle, the elbows' is not 0."""
    back, quat = np.empty(4), np.empty(4)
    mujoco.mju_axisAngle2Quat(back, model.jnt_axis[index], -float(model.qpos0[model.jnt_qposadr[index]]))
    mujoco.mju_mulQuat(quat, model.body_quat[model.jnt_bodyid[index]], back)
    return quat


def _add_frame(root: _Element, model: mujoco.MjModel, site: int) -> None:
    """A link without mass where a site is."""
    name = model.site(site).name
    ElementTree.SubElement(root, "link", name=name)
    joint = ElementTree.SubElement(root, "joint", name=f"{name}_fixed", type="fixed")
    _origin(joint, model.site_pos[site], model.site_quat[site])
    ElementTree.SubElement(joint, "parent", link=model.body(model.site_bodyid[site]).name)
    ElementTree.SubElement(joint, "child", link=name)


def _origin(parent: _Element, position: np.ndarray, quat: np.ndarray | None = None) -> None:
    turned = (0.0, 0.0, 0.0) if quat is None else _roll_pitch_yaw(_rotation(quat))
    ElementTree.SubElement(parent, "origin", xyz=_text(*position), rpy=_text(*turned))


def _rotation(quat: np.ndarray) -> np.ndarray:
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, quat)
    return matrix.reshape(3, 3)


def _roll_pitch_yaw(matrix: np.ndarray) -> tuple[float, float, float]:
    """Angles about the fixed axes x, y, z, in this order, rad."""
    flat = float(np.hypot(matrix[0, 0], matrix[1, 0]))
    pitch = float(np.arctan2(-matrix[2, 0], flat))
    if flat < 1e-9:  # straight up or down: roll and yaw turn about the same axis
        return float(np.arctan2(-matrix[1, 2], matrix[1, 1])), pitch, 0.0
    return float(np.arctan2(matrix[2, 1], matrix[2, 2])), pitch, float(np.arctan2(matrix[1, 0], matrix[0, 0]))


def _inertia(quat: np.ndarray, principal: np.ndarray) -> np.ndarray:
    """Inertia tensor in the link's axes, kg·m², (3, 3)."""
    turn = _rotation(quat)
    return turn @ np.diag(principal) @ turn.T


def _text(*values: float) -> str:
    return " ".join(format(float(value) + 0.0, ".12g") for value in values)
