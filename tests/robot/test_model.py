"""The shipped model against one built from the robot's numbers, and its behaviour at rest."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import pytest

from asimov_gym.robot.joints import JOINT_NAMES, JOINTS, KD, KP, STAND_POSITION
from asimov_gym.robot.model import Revision, model_sha256, robot_model, robot_revision, robot_spec

REVISIONS = [(leg_frames, foot) for leg_frames in ("shifted", "cad") for foot in ("rigid", "toe")]
every_revision = pytest.mark.parametrize(("leg_frames", "foot"), REVISIONS, ids=["/".join(r) for r in REVISIONS])

Figures = dict[str, Any]
Reference = Callable[[str, str], mujoco.MjModel]


@every_revision
def test_total_mass(figures: Figures, leg_frames: str, foot: str) -> None:
    mass = robot_model(leg_frames, foot).body("pelvis_link").subtreemass[0]
    assert mass == pytest.approx(figures["total_mass"][foot], abs=5e-5)


@every_revision
def test_mass_matrix(reference_model: Reference, leg_frames: str, foot: str) -> None:
    """Same generalised inertia and gravity load at 20 random poses, so same masses, frames, axes and armatures."""
    model, reference = robot_model(leg_frames, foot), reference_model(leg_frames, foot)
    assert [model.joint(i).name for i in range(model.njnt)] == [reference.joint(i).name for i in range(reference.njnt)]
    rng = np.random.default_rng(20)
    for _ in range(20):
        qpos = np.concatenate([rng.normal(size=7), rng.uniform(model.jnt_range[1:, 0], model.jnt_range[1:, 1])])
        qpos[3:7] /= np.linalg.norm(qpos[3:7])
        qvel = rng.normal(size=model.nv)
        (inertia, bias), (expected_inertia, expected_bias) = (
            _dynamics(model, qpos, qvel),
            _dynamics(reference, qpos, qvel),
        )
        np.testing.assert_allclose(inertia, expected_inertia, rtol=0, atol=1e-5)
        np.testing.assert_allclose(bias, expected_bias, rtol=0, atol=1e-5)


def _dynamics(model: mujoco.MjModel, qpos: np.ndarray, qvel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mass matrix (nv, nv), and gravity with Coriolis forces (nv,)."""
    data = mujoco.MjData(model)
    data.qpos, data.qvel = qpos, qvel
    mujoco.mj_forward(model, data)
    inertia = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, inertia)
    return inertia, data.qfrc_bias.copy()


@every_revision
def test_joints_and_sites(reference_model: Reference, leg_frames: str, foot: str) -> None:
    model, reference = robot_model(leg_frames, foot), reference_model(leg_frames, foot)
    fields = ("jnt_range", "jnt_limited", "jnt_actfrcrange", "jnt_actfrclimited", "jnt_stiffness", "jnt_margin")
    fields += ("jnt_solref", "jnt_solimp", "dof_armature", "dof_frictionloss", "dof_damping", "qpos_spring", "qpos0")
    for field in fields:
        np.testing.assert_allclose(getattr(model, field), getattr(reference, field), err_msg=field)
    for name in ("imu_in_pelvis", "pelvis_site", "left_foot", "right_foot"):
        assert model.site(name).bodyid == reference.site(name).bodyid
        np.testing.assert_allclose(model.site(name).pos, reference.site(name).pos, err_msg=name)


@every_revision
def test_collision_shapes(reference_model: Reference, leg_frames: str, foot: str) -> None:
    model, reference = robot_model(leg_frames, foot), reference_model(leg_frames, foot)
    colliding = {model.geom(i).name for i in range(model.ngeom) if model.geom_contype[i] or model.geom_conaffinity[i]}
    assert colliding == {reference.geom(i).name for i in range(reference.ngeom)} | {"floor"}
    for name in colliding - {"floor"}:
        geom, expected = model.geom(name), reference.geom(name)
        for field in ("type", "bodyid", "size", "pos", "friction", "condim", "priority", "solref", "solimp"):
            np.testing.assert_allclose(
                getattr(geom, field), getattr(expected, field), atol=1e-9, err_msg=f"{name}.{field}"
            )
        # a capsule's quaternion is free to turn about its axis; only the axis counts
        np.testing.assert_allclose(_axis(geom.quat), _axis(expected.quat), atol=1e-9, err_msg=name)
    assert set(model.exclude_signature) == set(reference.exclude_signature)


def _axis(quat: np.ndarray) -> np.ndarray:
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, quat)
    return matrix.reshape(3, 3)[:, 2]


def test_floor(figures: Figures) -> None:
    floor = robot_model().geom("floor")
    assert floor.condim[0] == figures["contact"]["floor"]["condim"]
    np.testing.assert_allclose(floor.friction, figures["contact"]["floor"]["friction"])


@every_revision
def test_actuators_are_in_joint_order(leg_frames: str, foot: str) -> None:
    """Inputs 0..24 are servos, 25..49 added torques, both in the control interface's order, and torques are limited."""
    model = robot_model(leg_frames, foot)
    assert model.nu == 50
    driven = [model.joint(model.actuator_trnid[i, 0]).name for i in range(model.nu)]
    assert driven == [*JOINT_NAMES, *JOINT_NAMES]
    np.testing.assert_array_equal(model.actuator_gainprm[:25, 0], KP)
    np.testing.assert_array_equal(model.actuator_biasprm[:25, 1], -KP)
    np.testing.assert_array_equal(model.actuator_biasprm[:25, 2], -KD)
    np.testing.assert_array_equal(model.actuator_gainprm[25:, 0], 1.0)
    for joint in JOINTS:
        limits = model.jnt_actfrcrange[model.joint(joint.name).id]
        assert tuple(limits) == (-joint.effort, joint.effort)


@every_revision
def test_sensors_follow_joint_order(leg_frames: str, foot: str) -> None:
    """Each joint's torque sensor reads the torque of its two inputs after the limit."""
    model = robot_model(leg_frames, foot)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("zero").id)
    rng = np.random.default_rng(1)
    data.ctrl[25:] = rng.uniform(-60.0, 60.0, 25)
    mujoco.mj_forward(model, data)
    read = np.array([data.sensor(name.removesuffix("_joint") + "_torque").data[0] for name in JOINT_NAMES])
    # at the zero pose the servos are silent, so only the added torques are there
    limits = np.array([joint.effort for joint in JOINTS])
    np.testing.assert_allclose(read, np.clip(data.ctrl[25:], -limits, limits))


@every_revision
@pytest.mark.parametrize("keyframe", ["stand", "zero"])
def test_soles_touch_the_floor(
    figures: Figures, reference_model: Reference, leg_frames: str, foot: str, keyframe: str
) -> None:
    """The keyframe's pelvis height is the one at which the lowest contact point lies at 0."""
    model, reference = robot_model(leg_frames, foot), reference_model(leg_frames, foot)
    key = model.key(keyframe)
    table = figures["pelvis_height"]["touching" if keyframe == "stand" else "touching_zero"]
    if f"{leg_frames}_{foot}" in table:
        assert key.qpos[2] == pytest.approx(table[f"{leg_frames}_{foot}"], abs=5e-5)
    data = mujoco.MjData(reference)
    data.qpos = key.qpos
    mujoco.mj_kinematics(reference, data)
    depth = data.geom_xpos[:, 2] - reference.geom_size[:, 0]  # spheres
    capsule = reference.geom_type == mujoco.mjtGeom.mjGEOM_CAPSULE
    depth = depth - capsule * reference.geom_size[:, 1] * np.abs(data.geom_xmat[:, 8])
    assert depth.min() == pytest.approx(0.0, abs=1e-4)


@every_revision
def test_keyframes_hold_the_table_s_poses(leg_frames: str, foot: str) -> None:
    model = robot_model(leg_frames, foot)
    for keyframe, pose in (("stand", STAND_POSITION), ("zero", np.zeros(25))):
        key = model.key(keyframe)
        angles = np.array([key.qpos[model.joint(name).qposadr[0]] for name in JOINT_NAMES])
        np.testing.assert_array_equal(angles, pose)
        np.testing.assert_array_equal(key.ctrl[:25], pose)
        np.testing.assert_array_equal(key.ctrl[25:], 0.0)
    assert (model.nq, model.nv) == ((32, 31) if foot == "rigid" else (34, 33))


@every_revision
def test_no_contact_with_itself_at_rest(leg_frames: str, foot: str) -> None:
    model = robot_model(leg_frames, foot)
    data = mujoco.MjData(model)
    for keyframe in ("stand", "zero"):
        mujoco.mj_resetDataKeyframe(model, data, model.key(keyframe).id)
        data.qpos[2] += 0.1
        mujoco.mj_forward(model, data)
        assert data.ncon == 0


@every_revision
def test_stands_ten_seconds(figures: Figures, leg_frames: str, foot: str) -> None:
    """Under its PD gains alone the robot leans a little and stays.

    An independent model, with other solver settings, settled at 0.6082 m (shifted/rigid), 0.6062 m (cad/toe) and
    0.6072 m (cad/rigid), the published 0.606 to 0.608 m. Solver settings move the height by about 0.1 mm, hence the
    bound of 0.2 mm. No source has a figure for shifted/toe, so it only has to lose less than 1 cm.
    """
    model = robot_model(leg_frames, foot)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("stand").id)
    heights = []
    for _ in range(round(10.0 / model.opt.timestep)):
        mujoco.mj_step(model, data)
        heights.append(data.qpos[2])
    settled = figures["pelvis_height"]["settled"].get(f"{leg_frames}_{foot}")
    if settled is None:
        assert heights[0] - 0.01 < data.qpos[2] < heights[0]
    else:
        assert data.qpos[2] == pytest.approx(settled, abs=2e-4)
    assert min(heights) > 0.60
    tilt = np.degrees(np.arccos(data.body("pelvis_link").xmat[8]))
    assert tilt < 4.0
    assert np.abs(data.qvel).max() < 1e-2
    weight = data.sensor("left_foot_force").data[2] + data.sensor("right_foot_force").data[2]
    assert weight == pytest.approx(figures["total_mass"][foot] * 9.81, rel=1e-2)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"leg_frames": "CAD"}, r"leg_frames must be one of 'shifted', 'cad', got 'CAD'"),
        ({"foot": "flat"}, r"foot must be one of 'rigid', 'toe', got 'flat'"),
    ],
)
def test_unknown_revision_is_refused(arguments: dict[str, str], message: str) -> None:
    for make in (robot_spec, robot_model, robot_revision, model_sha256):
        with pytest.raises(ValueError, match=message):
            make(**arguments)


def test_revision_string() -> None:
    assert robot_revision() == "shifted/rigid"
    for leg_frames, foot in REVISIONS:
        assert Revision.parse(robot_revision(leg_frames, foot)) == Revision(leg_frames, foot)
    with pytest.raises(ValueError, match="'leg_frames/foot'"):
        Revision.parse("shifted")
    with pytest.raises(ValueError, match="foot must be"):
        Revision.parse("shifted/paw")


def test_hash_tells_revisions_apart_and_ignores_appearance(monkeypatch: pytest.MonkeyPatch) -> None:
    hashes = {model_sha256(*revision) for revision in REVISIONS}
    assert len(hashes) == len(REVISIONS)

    def changed(change: Callable[[mujoco.MjSpec], None]) -> str:
        def altered(leg_frames: str, foot: str, visuals: bool = True) -> mujoco.MjSpec:
            spec = robot_spec(leg_frames, foot, visuals)
            change(spec)
            return spec

        model_sha256.cache_clear()
        with monkeypatch.context() as patch:
            patch.setattr("asimov_gym.robot.model.robot_spec", altered)
            result = model_sha256()
        model_sha256.cache_clear()
        return result

    def repaint(spec: mujoco.MjSpec) -> None:
        spec.material("shell").rgba = [1.0, 0.0, 0.0, 1.0]
        for geom in spec.body("waist_yaw_link").geoms:
            if not geom.name:
                geom.pos = [0.0, 0.0, 1.0]

    def fatten(spec: mujoco.MjSpec) -> None:
        spec.body("waist_yaw_link").mass += 1e-6

    def stiffen(spec: mujoco.MjSpec) -> None:
        spec.joint("left_knee_joint").frictionloss *= 1.001

    assert changed(repaint) == model_sha256()
    assert changed(fatten) != model_sha256()
    assert changed(stiffen) != model_sha256()
