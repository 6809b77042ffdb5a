"""The URDF of the robot is the robot: loaded back into MuJoCo it has the same masses, frames, axes and limits."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest

from asimov_gym.cli import main
from asimov_gym.robot.joints import EFFORT, JOINT_NAMES, RANGE, VELOCITY_LIMIT
from asimov_gym.robot.model import robot_model, robot_spec
from asimov_gym.robot.urdf import urdf

REVISIONS = [("shifted", "rigid"), ("cad", "rigid"), ("shifted", "toe")]
ROOT = "pelvis_link"


def loaded(text: str) -> mujoco.MjModel:
    """The URDF as MuJoCo reads it, every link a body of its own."""
    spec = mujoco.MjSpec.from_string(text)
    spec.compiler.fusestatic = False
    return spec.compile()


def hinges(model: mujoco.MjModel) -> list[str]:
    return [model.joint(i).name for i in range(model.njnt) if model.jnt_type[i] == mujoco.mjtJoint.mjJNT_HINGE]


def posed(model: mujoco.MjModel, angles: dict[str, float]) -> mujoco.MjData:
    data = mujoco.MjData(model)
    for name, angle in angles.items():
        data.joint(name).qpos[0] = angle
    mujoco.mj_forward(model, data)
    return data


@pytest.mark.parametrize(("leg_frames", "foot"), REVISIONS)
def test_frames_agree_at_random_poses(leg_frames: str, foot: str) -> None:
    ours, theirs = robot_model(leg_frames, foot), loaded(urdf(leg_frames, foot))
    names = hinges(ours)
    assert sorted(hinges(theirs)) == sorted(names)
    random = np.random.default_rng(0)
    for _ in range(10):
        low, high = np.array([ours.joint(name).range for name in names]).T
        angles = dict(zip(names, random.uniform(low, high).tolist(), strict=True))
        one, other = posed(ours, angles), posed(theirs, angles)
        base, turn = one.body(ROOT).xpos, one.body(ROOT).xmat.reshape(3, 3)
        for body in range(1, ours.nbody):
            name = ours.body(body).name
            seen = turn.T @ (one.body(name).xpos - base)
            assert other.body(name).xpos == pytest.approx(seen, abs=1e-9), name
            there = other.body(name).xmat.reshape(3, 3)
            assert there == pytest.approx(turn.T @ one.body(name).xmat.reshape(3, 3), abs=1e-9), name
        for site in range(ours.nsite):
            name = ours.site(site).name
            assert other.body(name).xpos == pytest.approx(turn.T @ (one.site(name).xpos - base), abs=1e-9), name


@pytest.mark.parametrize(("leg_frames", "foot"), REVISIONS)
def test_masses_and_inertias_agree(leg_frames: str, foot: str) -> None:
    """Link by link, and as the joints feel them: the mass matrix of the robot held at its pelvis."""
    spec = robot_spec(leg_frames, foot)
    spec.delete(spec.joint("floating_base"))
    for key in list(spec.keys):
        spec.delete(key)
    for joint in spec.joints:
        joint.armature = 0.0
    ours, theirs = spec.compile(), loaded(urdf(leg_frames, foot))
    for body in range(1, ours.nbody):
        name = ours.body(body).name
        assert theirs.body(name).mass == pytest.approx(ours.body(name).mass, rel=1e-9)
        assert theirs.body(name).ipos == pytest.approx(ours.body(name).ipos, abs=1e-9)
    assert float(theirs.body_mass.sum()) == pytest.approx(float(ours.body_mass.sum()), rel=1e-9)
    names = hinges(ours)
    random = np.random.default_rng(1)
    for _ in range(5):
        angles = dict(zip(names, random.uniform(-1.0, 1.0, len(names)).tolist(), strict=True))
        assert mass_matrix(theirs, angles, names) == pytest.approx(mass_matrix(ours, angles, names), abs=1e-8)


def mass_matrix(model: mujoco.MjModel, angles: dict[str, float], names: list[str]) -> np.ndarray:
    data, full = posed(model, angles), np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    order = [int(model.joint(name).dofadr[0]) for name in names]
    return full[np.ix_(order, order)]


def test_limits_are_those_of_the_joint_table() -> None:
    joints = {joint.get("name"): joint for joint in ElementTree.fromstring(urdf()).iter("joint")}
    for index, name in enumerate(JOINT_NAMES):
        limit = joints[name].find("limit")
        assert limit is not None
        found = [float(limit.get(key) or "nan") for key in ("lower", "upper", "effort", "velocity")]
        assert found == pytest.approx([*RANGE[index], EFFORT[index], VELOCITY_LIMIT[index]], abs=1e-5)


def test_collision_shapes_reach_as_far_as_the_models() -> None:
    """The lowest point of the feet, from shapes that URDF has: the standing robot touches the floor with both."""
    model = robot_model()
    stand = model.key("stand").qpos
    angles = {name: float(stand[model.joint(name).qposadr[0]]) for name in hinges(model)}
    theirs = loaded(urdf())
    data = posed(theirs, angles)
    feet = [g for g in range(theirs.ngeom) if "ankle_roll" in theirs.body(theirs.geom_bodyid[g]).name]
    lowest = min(data.geom_xpos[g][2] - theirs.geom_size[g][0] for g in feet if theirs.geom_contype[g])
    assert lowest == pytest.approx(-float(stand[2]), abs=1e-3)


def test_the_command_writes_it_and_says_where(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "robot.urdf"
    assert main(["export-urdf", str(path)]) == 0
    assert capsys.readouterr().out.strip() == f"wrote {path}"
    assert path.read_text(encoding="utf-8") == urdf()
    assert main(["export-urdf", "-", "--foot", "toe"]) == 0
    assert capsys.readouterr().out == urdf(foot="toe")
    assert main(["export-urdf", str(tmp_path / "no" / "folder.urdf")]) == 2
    assert "No such file" in capsys.readouterr().err
