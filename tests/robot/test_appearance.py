"""What is seen: cameras that show the robot, shapes that weigh and touch nothing."""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np
import pytest

from asimov_gym.robot.model import robot_model

CAMERAS = ("first_person", "third_person", "side", "front")


@pytest.fixture(scope="module")
def renderer() -> Iterator[mujoco.Renderer]:
    try:
        made = mujoco.Renderer(robot_model(), height=180, width=320)
    except Exception as error:  # MuJoCo raises whatever the missing OpenGL back end raises
        pytest.skip(f"no renderer on this machine (try MUJOCO_GL=egl or osmesa): {error}")
    made.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = False
    yield made
    made.close()


@pytest.mark.parametrize("camera", CAMERAS)
def test_camera_sees_the_robot_wherever_it_goes(renderer: mujoco.Renderer, camera: str) -> None:
    """Three metres on, the outside cameras still have the robot in mid-picture; the chest camera never."""
    model = robot_model()
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("stand").id)
    data.qpos[:2] = 3.0, -1.0
    mujoco.mj_forward(model, data)
    renderer.enable_segmentation_rendering()
    renderer.update_scene(data, camera)
    ids = renderer.render()[..., 0]
    renderer.disable_segmentation_rendering()
    shown = ids >= 0
    body = np.where(shown, model.geom_bodyid[np.where(shown, ids, 0)], -1)
    robot = body > 0
    if camera == "first_person":
        assert robot.mean() < 0.02  # at most the hands
        assert (body == 0).any()  # the floor ahead
    else:
        rows, columns = np.nonzero(robot)
        assert 0.03 < robot.mean() < 0.5
        assert rows.min() > 0
        assert rows.max() < 179
        assert columns.min() > 60
        assert columns.max() < 260


def test_picture_is_lit_and_the_shells_are_dark(renderer: mujoco.Renderer) -> None:
    model = robot_model()
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("stand").id)
    mujoco.mj_forward(model, data)
    renderer.update_scene(data, "front")
    picture = renderer.render().astype(float).mean(axis=-1)
    chest = picture[80:100, 150:170].mean()
    surroundings = picture[:, :60].mean()
    assert 5.0 < chest < 90.0
    assert 110.0 < surroundings < 250.0


def test_chest_camera() -> None:
    model = robot_model()
    camera = model.camera("first_person")
    assert model.body(camera.bodyid[0]).name == "waist_yaw_link"
    np.testing.assert_allclose(camera.pos, [0.095, 0.0, 0.245])
    assert camera.fovy[0] == 60.0
    assert tuple(model.cam_resolution[camera.id]) == (1920, 1080)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    view = data.cam_xmat[camera.id].reshape(3, 3)
    np.testing.assert_allclose(-view[:, 2], [1.0, 0.0, 0.0], atol=1e-6)  # a MuJoCo camera looks along its -z
    np.testing.assert_allclose(view[:, 1], [0.0, 0.0, 1.0], atol=1e-6)


@pytest.mark.parametrize("foot", ["rigid", "toe"])
def test_dropping_the_visuals_changes_no_motion(foot: str) -> None:
    seen, bare = robot_model(foot=foot), robot_model(foot=foot, visuals=False)
    assert bare.ngeom < seen.ngeom
    assert (bare.nmesh, bare.ntex) == (0, 0)
    trajectories = []
    for model in (seen, bare):
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, model.key("stand").id)
        rng = np.random.default_rng(6)
        path = []
        for _ in range(100):
            data.ctrl[:25] = model.key("stand").ctrl[:25] + rng.normal(0.0, 0.2, 25)
            mujoco.mj_step(model, data)
            path.append(np.concatenate([data.qpos, data.sensordata]))
        trajectories.append(np.array(path))
    np.testing.assert_array_equal(*trajectories)


@pytest.mark.parametrize("foot", ["rigid", "toe"])
def test_every_link_is_drawn(foot: str) -> None:
    model = robot_model(foot=foot)
    drawn = {model.geom_bodyid[i] for i in range(model.ngeom) if model.geom_group[i] == 2}
    assert drawn == set(range(1, model.nbody))
    for i in range(model.ngeom):
        if model.geom_group[i] == 2:
            assert model.geom_contype[i] == model.geom_conaffinity[i] == 0
