"""The C physics batch: one control law, per-copy bodies, exact state, contained divergence."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from asimov_gym.physics import BodyParameters, CPhysics, JointTarget, PhysicsProfile, compile_model, delayed_position
from asimov_gym.physics.places import as_places
from asimov_gym.robot.joints import EFFORT, JOINT_NAMES, KD, KP, STAND_POSITION, joint_index

STAND = STAND_POSITION[None]


def _hold(physics: CPhysics, steps: int, **extra: np.ndarray) -> None:
    target = JointTarget(np.tile(STAND_POSITION, (physics.copies, 1)), **extra)
    for _ in range(steps):
        physics.step(target, 4)


def test_stands_like_a_plain_simulation() -> None:
    """The batch is MuJoCo and nothing else: it agrees with mj_step to solver accuracy."""
    physics = CPhysics(copies=1, profile="evaluation")
    model = compile_model("evaluation")
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("stand").id)
    target = STAND.copy()
    target[0, joint_index("left_knee_joint")] += 0.1
    data.ctrl[:25] = target[0]
    for _ in range(50):
        reading = physics.step(JointTarget(target), 4)
        mujoco.mj_step(model, data, 4)
    np.testing.assert_allclose(physics.state().qpos[0], data.qpos, atol=1e-6)
    np.testing.assert_allclose(reading.base_position[0], data.qpos[:3], atol=1e-6)


@pytest.mark.parametrize("profile", ["training", "evaluation"])
def test_both_profiles_stand(profile: str) -> None:
    physics = CPhysics(copies=2, profile=profile)
    _hold(physics, 250)
    reading = physics.read()
    assert ((reading.base_position[:, 2] > 0.60) & (reading.base_position[:, 2] < 0.615)).all()
    np.testing.assert_allclose(reading.foot_force[:, :, 2].sum(axis=1), 32.2249 * 9.81, rtol=0.02)


def test_one_law_for_position_velocity_load_and_gains() -> None:
    """In the air and from rest the first step's torque is kp (position - q) + kd (velocity - q') + load, clamped."""
    physics = CPhysics(copies=1)
    qpos, qvel = physics.standing()
    qpos[2] = 2.0
    knee, hip = joint_index("left_knee_joint"), joint_index("right_hip_yaw_joint")
    cases: list[tuple[dict[str, np.ndarray], int, float]] = []
    position, load, velocity = STAND.copy(), np.zeros((1, 25)), np.zeros((1, 25))
    position[0, knee] += 0.05
    load[0, hip], velocity[0, hip] = 3.0, 0.4
    cases.append(({}, knee, KP[knee] * 0.05))
    cases.append(({"load": load}, hip, 3.0))
    cases.append(({"velocity": velocity}, hip, KD[hip] * 0.4))
    kp, kd = np.full((1, 25), 20.0), np.full((1, 25), 1.0)
    cases.append(({"kp": kp}, knee, 20.0 * 0.05))
    cases.append(({"kp": kp, "kd": kd, "velocity": velocity, "load": load}, hip, 3.0 + 0.4))
    cases.append(({"load": 1000.0 * load}, hip, EFFORT[hip]))
    for extra, joint, expected in cases:
        physics.reset(qpos, qvel)
        torque = physics.step(JointTarget(position, **extra), 1).joint_torque[0, joint]
        assert torque == pytest.approx(expected, rel=0.02), extra


def test_explicit_gains_are_lent_for_one_call() -> None:
    physics, plain = CPhysics(copies=2), CPhysics(copies=2)
    limp = np.zeros((2, 25))
    physics.step(JointTarget(np.tile(STAND_POSITION, (2, 1)), kp=limp, kd=limp + 2.0), 4)
    physics.reset(*physics.standing())
    _hold(physics, 5)
    _hold(plain, 5)
    np.testing.assert_array_equal(physics.state().qpos, plain.state().qpos)


def test_gains_by_substep() -> None:
    """Gains that change from substep to substep equal separate steps with those gains."""
    whole, parts = CPhysics(copies=1), CPhysics(copies=1)
    position = np.tile(STAND_POSITION, (1, 4, 1))
    kp = np.tile(KP, (1, 4, 1)) * np.array([1.0, 0.2, 0.5, 0.0])[None, :, None]
    whole.step(JointTarget(position, kp=kp), 4)
    for k in range(4):
        parts.step(JointTarget(position[:, k], kp=kp[:, k]), 1)
    np.testing.assert_array_equal(whole.state().qpos, parts.state().qpos)


def test_state_continues_exactly() -> None:
    rng = np.random.default_rng(0)
    targets = STAND_POSITION + 0.2 * rng.standard_normal((30, 3, 4, 25))
    physics = CPhysics(copies=3, profile="training")
    for row in targets[:10]:
        physics.step(JointTarget(row), 4)
    saved = physics.state()
    for row in targets[10:]:
        physics.step(JointTarget(row), 4)
    first = physics.state()
    other = CPhysics(copies=3, profile="training", threads=1)
    other.set_state(saved)
    for row in targets[10:]:
        other.step(JointTarget(row), 4)
    for name, value in vars(other.state()).items():
        np.testing.assert_array_equal(value, getattr(first, name), err_msg=name)


def test_a_reading_is_taken_once_and_keeps_its_moment() -> None:
    """It is the same object until the state changes, whoever changes it, and earlier ones stay as they were."""
    physics = CPhysics(copies=2)
    saved = physics.state()
    changes = {
        "step": lambda: physics.step(JointTarget(np.tile(STAND_POSITION - 0.1, (2, 1)))),
        "kick": lambda: physics.kick(np.full((2, 6), 0.3)),
        "reset": lambda: physics.reset(*physics.standing(), copies=np.array([True, False])),
        "set_state": lambda: physics.set_state(saved),
    }
    for name, change in changes.items():
        reading = physics.read()
        assert physics.read() is reading
        kept = {field: value.copy() for field, value in vars(reading).items()}
        change()
        assert physics.read() is not reading, name
        assert not np.array_equal(physics.read().base_velocity, kept["base_velocity"]), name
        np.testing.assert_array_equal(physics.read().base_velocity, physics.state().qvel[:, 0:3], err_msg=name)
        for field, value in kept.items():
            np.testing.assert_array_equal(getattr(reading, field), value, err_msg=f"{field} after {name}")


def test_nobody_moves_the_robot_through_a_reading() -> None:
    physics = CPhysics(copies=2)
    for reading in (physics.read(), physics.step(JointTarget(np.tile(STAND_POSITION, (2, 1))), 4)):
        for name, value in vars(reading).items():
            with pytest.raises(ValueError, match="read-only"):
                value[...] = 0.0
            assert value.astype(np.float32).flags.writeable, name


def test_joints_and_sensors_are_read_by_name() -> None:
    """Each quantity of the reading is the one that the model has under its name."""
    physics = CPhysics(copies=2)
    rng = np.random.default_rng(2)
    for _ in range(5):
        reading = physics.step(JointTarget(STAND_POSITION + 0.1 * rng.standard_normal((2, 25))), 2)
    state, model = physics.state(), physics.model
    for i, name in enumerate(JOINT_NAMES):
        joint, torque = model.joint(name), model.sensor(name.removesuffix("_joint") + "_torque")
        np.testing.assert_array_equal(reading.joint_position[:, i], state.qpos[:, joint.qposadr[0]])
        np.testing.assert_array_equal(reading.joint_velocity[:, i], state.qvel[:, joint.dofadr[0]])
        np.testing.assert_array_equal(reading.joint_torque[:, i], state.sensors[:, torque.adr[0]])
    for i, side in enumerate(("left", "right")):
        for quantity in ("position", "velocity", "up", "force"):
            start = model.sensor(f"{side}_foot_{quantity}").adr[0]
            measured = getattr(reading, f"foot_{quantity}")[:, i]
            np.testing.assert_array_equal(measured, state.sensors[:, start : start + 3])


def test_places_are_slices_only_where_they_are_runs() -> None:
    assert as_places(np.array([3, 4, 5])) == slice(3, 6)
    for scattered in ([3, 5], [5, 4], [2, 2]):
        np.testing.assert_array_equal(as_places(np.array(scattered)), scattered)


def test_copies_do_not_depend_on_each_other() -> None:
    rng = np.random.default_rng(1)
    targets = STAND_POSITION + 0.3 * rng.standard_normal((20, 5, 4, 25))
    many, one = CPhysics(copies=5), CPhysics(copies=1)
    for row in targets:
        many.step(JointTarget(row), 4)
        one.step(JointTarget(row[3:4]), 4)
    np.testing.assert_array_equal(many.state().qpos[3], one.state().qpos[0])


def test_bodies_differ_by_copy() -> None:
    n = 3
    mass = np.array([-1.0, 0.0, 3.0])
    body = BodyParameters(foot_friction=np.array([0.1, 0.6, 1.0]), torso_mass=mass, torso_com=np.zeros((n, 3)))
    physics = CPhysics(copies=n, parameters=body)
    _hold(physics, 150)
    weight = physics.read().foot_force[:, :, 2].sum(axis=1)
    np.testing.assert_allclose(weight, (32.2249 + mass) * 9.81, rtol=0.02)
    # Pushed sideways while standing, the copy on ice slides farthest.
    physics.kick(np.tile([0.0, 0.5, 0.0, 0.0, 0.0, 0.0], (n, 1)))
    before = physics.read().foot_position[:, 0, 1]
    _hold(physics, 15)
    slid = np.abs(physics.read().foot_position[:, 0, 1] - before)
    assert slid[0] > 2.0 * slid[2]


def test_wrench_acts_at_the_centre_of_mass() -> None:
    """In free fall without gains, a force F on the whole robot changes its momentum by F t."""
    physics = CPhysics(copies=2)
    qpos, qvel = physics.standing()
    qpos[2] = 5.0
    physics.reset(qpos, qvel)
    force = np.zeros((2, 6))
    force[1, 0] = 100.0
    stand = np.tile(STAND_POSITION, (2, 1))
    for _ in range(5):
        physics.step(JointTarget(stand), 4, wrench={"pelvis_link": force})
    data = mujoco.MjData(physics.model)
    momentum = []
    for q, v in zip(physics.state().qpos, physics.state().qvel, strict=True):
        data.qpos[:], data.qvel[:] = q, v
        mujoco.mj_forward(physics.model, data)
        mujoco.mj_subtreeVel(physics.model, data)
        momentum.append(data.subtree_linvel[1] * physics.model.body_subtreemass[1])
    np.testing.assert_allclose(momentum[1] - momentum[0], [100.0 * 0.1, 0.0, 0.0], atol=0.05)


def test_divergence_is_contained_and_kept_for_replay(tmp_path) -> None:
    physics = CPhysics(copies=3, profile="training", dump_dir=tmp_path)
    state = physics.state()
    state.qvel[1, 3:6] = 1e8
    physics.set_state(state)
    reading = physics.step(JointTarget(np.tile(STAND_POSITION, (3, 1))), 4)
    assert physics.diverged.tolist() == [False, True, False]
    assert physics.divergences == 1
    np.testing.assert_array_equal(physics.state().qpos[1], physics.standing()[0])
    assert all(np.isfinite(value).all() for value in vars(reading).values())
    (dump,) = tmp_path.glob("*.npz")
    with np.load(dump) as saved:
        np.testing.assert_array_equal(saved["qvel"][0], state.qvel[1])
        assert saved["position"].shape == (1, 25)
    physics.step(JointTarget(np.tile(STAND_POSITION, (3, 1))), 4)
    assert not physics.diverged.any()


def test_delay_counts_physics_steps() -> None:
    history = np.arange(3.0)[None, :, None] * np.ones((6, 3, 25))
    ages = delayed_position(history, np.arange(6), 4)[:, :, 0]
    assert ages.tolist() == [[0, 0, 0, 0], [1, 0, 0, 0], [1, 1, 0, 0], [1, 1, 1, 0], [1, 1, 1, 1], [2, 1, 1, 1]]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"copies": 0}, "copies must be at least 1"),
        ({"threads": 0}, "threads must be at least 1"),
        ({"profile": "fast"}, "'fast' is unknown; known profiles: evaluation, training"),
    ],
)
def test_bad_construction_names_the_field(arguments: dict, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        CPhysics(**arguments)


def test_bad_targets_name_the_field() -> None:
    physics = CPhysics(copies=2)
    with pytest.raises(ValueError, match=r"JointTarget.position has shape \(2, 24\)"):
        physics.step(JointTarget(np.zeros((2, 24))), 4)
    bad = np.zeros((2, 25))
    bad[1, 3] = np.nan
    with pytest.raises(ValueError, match=r"JointTarget\.load of copy 1, left_knee_joint, is not finite"):
        physics.step(JointTarget(np.zeros((2, 25)), load=bad), 4)
    with pytest.raises(ValueError, match="unknown body 'tail'"):
        physics.step(JointTarget(np.zeros((2, 25))), 4, wrench={"tail": np.zeros((2, 6))})
    with pytest.raises(ValueError, match="qpos or qvel holds NaN"):
        physics.reset(np.full(physics.model.nq, np.nan), np.zeros(physics.model.nv))


def test_profiles_change_what_they_say() -> None:
    training, evaluation = compile_model("training"), compile_model("evaluation")
    assert training.opt.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL
    assert evaluation.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
    assert (evaluation.opt.noslip_iterations, evaluation.opt.impratio) == (5, 10.0)
    assert evaluation.opt.iterations == 100
    assert training.dof_frictionloss.max() == 0.0 < evaluation.dof_frictionloss.max()
    own = PhysicsProfile("own", True, 10.0, 5, 100, 50, bodies_collide=False, dry_friction=True)
    touching = [i for i in range(training.ngeom) if training.geom_contype[i] or training.geom_conaffinity[i]]
    assert len(touching) == 9  # the floor and four points under each foot
    assert compile_model(own).dof_frictionloss.max() > 0.0
