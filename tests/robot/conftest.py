"""A second model of the robot, built from tests/data/asimov1_figures.yaml and nothing of the package."""

from __future__ import annotations

import copy
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import pytest
import yaml

Figures = dict[str, Any]
_FIGURES = Path(__file__).parents[1] / "data" / "asimov1_figures.yaml"


@pytest.fixture(scope="session")
def figures() -> Figures:
    """The robot's numbers: shifted leg frames, rigid feet, the other revisions under `revisions`."""
    return yaml.safe_load(_FIGURES.read_text())


@pytest.fixture(scope="session")
def revision_figures(figures: Figures) -> Callable[[str, str], Figures]:
    """The numbers of a revision, by leg frames and foot."""

    def revise(leg_frames: str, foot: str) -> Figures:
        revised = copy.deepcopy(figures)
        bodies = {body["name"]: body for body in revised["bodies"]}
        if leg_frames == "cad":
            for change in figures["revisions"]["cad"]:
                bodies[change["name"]].update(change)
        if foot == "toe":
            toe = figures["revisions"]["toe"]
            for change in toe["bodies"]:
                bodies[change["name"]].update(change)
            revised["bodies"] += toe["extra_bodies"]
            revised["joints"] += toe["extra_joints"]
            revised["contact_exclude"] += toe["contact_exclude"]
        return revised

    return revise


@pytest.fixture(scope="session")
def reference_model(revision_figures: Callable[[str, str], Figures]) -> Callable[[str, str], mujoco.MjModel]:
    """Compiles the independent model of a revision: bodies, joints and collision shapes; no drives, no floor."""

    def build(leg_frames: str, foot: str) -> mujoco.MjModel:
        figures = revision_figures(leg_frames, foot)
        root = ET.Element("mujoco")
        ET.SubElement(root, "compiler", angle="radian", autolimits="true")
        _add_children(ET.SubElement(root, "worldbody"), "world", figures)
        contact = ET.SubElement(root, "contact")
        for body1, body2 in figures["contact_exclude"] + figures["suggested_contact_exclude"]:
            ET.SubElement(contact, "exclude", body1=body1, body2=body2)
        return mujoco.MjModel.from_xml_string(ET.tostring(root, encoding="unicode"))

    return build


def _add_children(parent: ET.Element, name: str, figures: Figures) -> None:
    joints = {joint["body"]: joint for joint in figures["joints"]}
    for body in figures["bodies"]:
        if body["parent"] != name:
            continue
        element = ET.SubElement(parent, "body", name=body["name"], pos=_text(body["pos"]))
        ET.SubElement(
            element,
            "inertial",
            pos=_text(body["com"]),
            mass=str(body["mass"]),
            fullinertia=_text(body["inertia"]),
        )
        if name == "world":
            ET.SubElement(element, "freejoint", name="floating_base")
        else:
            _add_joint(element, joints[body["name"]])
        for shape in body["collision"]:
            role = "foot" if "_foot" in shape["name"] or "_toe" in shape["name"] else "body"
            place = {"fromto": _text(shape["fromto"])} if "fromto" in shape else {"pos": _text(shape["pos"])}
            contact = figures["contact"][role]
            ET.SubElement(
                element,
                "geom",
                name=shape["name"],
                type=shape["type"],
                size=str(shape["radius"]),
                mass="0",
                friction=_text(contact["friction"]),
                condim=str(contact["condim"]),
                priority=str(contact["priority"]),
                attrib=place,
            )
        for site, pos in body.get("sites", {}).items():
            ET.SubElement(element, "site", name=site, pos=_text(pos))
        _add_children(element, body["name"], figures)


def _add_joint(parent: ET.Element, joint: Figures) -> None:
    vectors = ("axis", "range", "solreflimit", "solimplimit")
    scalars = ("ref", "armature", "frictionloss", "damping", "stiffness", "springref", "margin")
    attributes = {name: _text(joint[name]) for name in vectors if name in joint}
    attributes |= {name: str(joint[name]) for name in scalars if name in joint}
    if "effort" in joint:
        attributes["actuatorfrcrange"] = _text([-joint["effort"], joint["effort"]])
    ET.SubElement(parent, "joint", name=joint["name"], attrib=attributes)


def _text(values: list[float]) -> str:
    return " ".join(map(str, values))
