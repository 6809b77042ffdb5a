"""The engines under JAX do what C MuJoCo does: the same state, the same bodies, the same control law."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

if importlib.util.find_spec("jax") is None or importlib.util.find_spec("mujoco.mjx") is None:
    pytest.skip("needs JAX and MJX: pip install 'asimov-gym[mjx]'", allow_module_level=True)

from asimov_gym.physics import BodyParameters, CPhysics, JointTarget, PhysicsProfile
from asimov_gym.physics.functional import CEngine, Engine, MjxEngine, Simulation, make_engine  # prepares JAX
from asimov_gym.robot.joints import STAND_POSITION

# isort: split
import jax
import jax.numpy as jnp

N, SUBSTEPS = 8, 4
CONVERGED = PhysicsProfile(
    "converged", False, 1.0, 0, iterations=50, ls_iterations=50, bodies_collide=False, dry_friction=False
)
"""The training profile with a solver that runs to its end. With the three iterations of training the solution depends
on where the solver starts: even C MuJoCo leaves its own path after some steps if the state is rounded to float32."""


def bodies(n: int = N) -> BodyParameters:
    rng = np.random.default_rng(1)
    return BodyParameters(
        foot_friction=rng.uniform(0.4, 1.2, n),
        kp_scale=rng.uniform(0.85, 1.15, (n, 25)),
        kd_scale=rng.uniform(0.85, 1.15, (n, 25)),
        torso_mass=rng.uniform(-0.5, 2.0, n),
        torso_com=rng.uniform(-0.02, 0.04, (n, 3)),
    )


def tape(steps: int, amplitude: float, n: int = N) -> np.ndarray:
    """Joint targets that swing about the standing pose, (steps, n, 25)."""
    rng = np.random.default_rng(0)
    phase, reach = rng.uniform(0.0, 2.0 * np.pi, (n, 25)), rng.uniform(0.0, amplitude, (n, 25))
    time = np.arange(steps)[:, None, None] * 0.02
    return STAND_POSITION + reach * np.sin(2.0 * np.pi * time + phase) * np.minimum(1.0, 2.0 * time)


def floats(tree):
    return jax.tree.map(lambda a: jnp.asarray(a, dtype=jnp.float32), tree)


def largest_differences(engine: Engine, steps: int, body: BodyParameters | None) -> dict[str, float]:
    """Of each quantity over a rollout against C MuJoCo in float64 from the standing pose."""
    reference = CPhysics(N, engine.profile, parameters=body)
    step = jax.jit(lambda s, p, b: engine.step(s, JointTarget(p), SUBSTEPS, b))
    simulation, given = engine.stand(N), floats(body)
    worst: dict[str, float] = {}
    for position in tape(steps, 0.1):
        simulation, diverged = step(simulation, jnp.asarray(position, dtype=jnp.float32), given)
        wanted, seen = reference.step(JointTarget(position), SUBSTEPS), engine.read(simulation)
        assert not diverged.any()
        for name, value in vars(wanted).items():
            error = float(np.abs(np.asarray(getattr(seen, name)) - value).max())
            worst[name] = max(error, worst.get(name, 0.0))
    reference.close()
    return worst


def test_c_engine_repeats_c_physics() -> None:
    # Ten steps: 1e-6 in the pose. The first step agrees to 2e-6 in everything but torques and forces (1e-3).
    worst = largest_differences(CEngine(CONVERGED), 10, bodies())
    assert worst["base_position"] < 1e-5 and worst["joint_position"] < 1e-5 and worst["joint_velocity"] < 1e-3


def test_copies_under_vmap_are_stepped_as_one_batch() -> None:
    engine = CEngine(CONVERGED)
    simulation, position = engine.stand(N), jnp.asarray(tape(5, 0.1)[-1], dtype=jnp.float32)
    batch, _ = engine.step(simulation, JointTarget(position), SUBSTEPS, floats(bodies()))
    calls = []
    engine._pool = lambda copies, own=engine._pool: calls.append(copies) or own(copies)  # type: ignore[method-assign]

    def one(s: Simulation, p: jax.Array, b: BodyParameters) -> Simulation:
        alone = jax.tree.map(lambda a: a[None], (s, p, b))
        return jax.tree.map(lambda a: a[0], engine.step(alone[0], JointTarget(alone[1]), SUBSTEPS, alone[2])[0])

    mapped = jax.vmap(one)(simulation, position, floats(bodies()))
    assert calls == [N]
    jax.tree.map(np.testing.assert_array_equal, mapped, batch)


def test_bodies_can_change_from_call_to_call() -> None:
    engine = CEngine(CONVERGED)
    position = JointTarget(jnp.asarray(tape(5, 0.1)[-1], dtype=jnp.float32))
    heavy = floats(replace(bodies(), torso_mass=np.full(N, 2.0)))
    first, _ = engine.step(engine.stand(N), position, SUBSTEPS, floats(bodies()))
    other, _ = engine.step(engine.stand(N), position, SUBSTEPS, heavy)
    again, _ = engine.step(engine.stand(N), position, SUBSTEPS, floats(bodies()))
    np.testing.assert_array_equal(first.qvel, again.qvel)
    assert (np.abs(first.qvel - other.qvel).max(axis=1) > 0.0).all()


@pytest.mark.parametrize("make", [CEngine, pytest.param(MjxEngine, marks=pytest.mark.slow)])
def test_force_on_a_body_is_momentum(make: Callable[..., Engine]) -> None:
    """In the air the momentum changes by force times time, gravity's too; a force off the middle turns the robot."""
    engine = make(CONVERGED)
    qpos, qvel = (np.tile(part, (N, 1)) for part in engine.standing())
    qpos[:, 2] = 3.0
    forces = np.zeros((N, 6))
    forces[0, 0], forces[1, 1] = 300.0, -200.0
    target = JointTarget(jnp.asarray(np.tile(STAND_POSITION, (N, 1)), dtype=jnp.float32))
    wrench = {"left_shoulder_pitch_link": jnp.asarray(forces, jnp.float32)}
    simulation, _ = engine.step(engine.start(qpos, qvel), target, SUBSTEPS, None, wrench)
    momentum = np.array([momenta(engine.model, simulation, copy) for copy in range(3)])
    mass, time = engine.model.body_mass.sum(), SUBSTEPS * engine.timestep
    given = forces[:3, :3] * time - np.array([0.0, 0.0, 9.81 * mass * time])
    np.testing.assert_allclose(momentum[:, 0], given, atol=0.06)  # N s; a step of 5 ms is not exact
    assert momentum[0, 1, 2] < -0.3  # a push forward on the left shoulder turns it to the right
    assert abs(momentum[2, 1]).max() < 0.01


def momenta(model: mujoco.MjModel, simulation: Simulation, copy: int) -> np.ndarray:
    """Linear and angular momentum of a copy, (2, 3)."""
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = simulation.qpos[copy], simulation.qvel[copy]
    mujoco.mj_forward(model, data)
    mujoco.mj_subtreeVel(model, data)
    return np.stack([data.subtree_linvel[0] * model.body_mass.sum(), data.subtree_angmom[0]])


def throw(engine: Engine) -> tuple[Simulation, jax.Array]:
    """Step a batch of two of which one is thrown at 10 km/s."""
    speed = jnp.zeros((2, 6)).at[1, 0].set(1e4)
    target = JointTarget(jnp.asarray(np.tile(STAND_POSITION, (2, 1)), dtype=jnp.float32))
    return engine.step(engine.kick(engine.stand(2), speed), target, SUBSTEPS)


def test_diverged_copies_stand_again_on_c() -> None:
    engine = CEngine()
    after, diverged = throw(engine)
    assert diverged.tolist() == [False, True]
    np.testing.assert_allclose(after.qpos[1], engine.standing()[0], atol=1e-6)
    assert np.isfinite(after.qpos).all() and float(after.time[1]) == 0.0 and float(after.time[0]) > 0.0


def test_state_goes_to_c_physics_and_back() -> None:
    engine, physics = CEngine(CONVERGED), CPhysics(N, CONVERGED)
    position = tape(5, 0.1)[-1]
    simulation, _ = engine.step(engine.stand(N), JointTarget(jnp.asarray(position, jnp.float32)), SUBSTEPS)
    physics.set_state(engine.physics_state(simulation))
    for name, value in vars(physics.read()).items():
        np.testing.assert_allclose(getattr(engine.read(simulation), name), value, atol=1e-6, err_msg=name)
    physics.close()


@pytest.mark.parametrize(
    ("name", "profile", "words"),
    [
        ("gpu", "training", "physics must be one of c, mjx, warp, got 'gpu'"),
        ("mjx", "evaluation", "'evaluation' cannot run on MJX.*use 'training', or physics='c'"),
    ],
)
def test_engines_that_cannot_be(name: str, profile: str, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        make_engine(name, profile)


def test_missing_packages_are_named() -> None:
    code = (
        "import sys; sys.modules['jax'] = None\n"
        "import importlib.util as u; find = u.find_spec\n"
        "u.find_spec = lambda name, *a: None if name == 'jax' else find(name, *a)\n"
        "import asimov_gym.envs.functional"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert "jax is not installed, which environments on JAX need: pip install 'asimov-gym[mjx]'" in done.stderr


@pytest.mark.slow
def test_mjx_follows_c_physics() -> None:
    worst = largest_differences(MjxEngine(CONVERGED), 50, bodies())
    # Measured over 50 policy steps (200 physics steps): 4e-5 m, 1e-4 in the quaternion, 4e-4 rad, 3e-2 rad/s.
    assert worst["base_position"] < 5e-4 and worst["base_quat"] < 1e-3
    assert worst["joint_position"] < 4e-3 and worst["joint_velocity"] < 0.3
    assert worst["foot_position"] < 1e-3


@pytest.mark.gpu
@pytest.mark.skipif(not any(Path("/dev").glob("nvidia[0-9]*")), reason="needs an NVIDIA GPU")
@pytest.mark.parametrize("backend", ["jax", "warp"])
def test_mjx_follows_c_physics_on_a_gpu(backend: Any) -> None:
    pytest.importorskip("warp" if backend == "warp" else "jax", reason="needs warp: pip install 'mujoco-mjx[warp]'")
    assert jax.default_backend() == "gpu", "JAX was installed without its GPU plugin: pip install 'jax[cuda12]'"
    worst = largest_differences(MjxEngine(CONVERGED, backend), 50, bodies())
    assert worst["base_position"] < 5e-4 and worst["joint_position"] < 4e-3 and worst["foot_position"] < 1e-3


@pytest.mark.slow
def test_mjx_has_the_whole_control_law() -> None:
    rng = np.random.default_rng(3)
    position = STAND_POSITION + rng.normal(0.0, 0.05, (N, SUBSTEPS, 25))
    target = JointTarget(
        position=position,
        velocity=rng.normal(0.0, 0.5, (N, 25)),
        load=rng.normal(0.0, 2.0, (N, 25)),
        kp=rng.uniform(20.0, 200.0, (N, 25)),
        kd=rng.uniform(1.0, 5.0, (N, 25)),
    )
    reference, engine = CPhysics(N, CONVERGED), MjxEngine(CONVERGED)
    qpos, qvel = (np.tile(part, (N, 1)) for part in engine.standing())
    qpos[:, 2] += 0.5  # in the air, where nothing but the law moves the joints
    reference.reset(qpos, qvel)
    wanted = reference.step(target, SUBSTEPS)
    step = jax.jit(lambda s, t: engine.step(s, t, SUBSTEPS))
    seen = engine.read(step(engine.start(qpos, qvel), floats(target))[0])
    np.testing.assert_allclose(seen.joint_position, wanted.joint_position, atol=1e-5)
    np.testing.assert_allclose(seen.joint_velocity, wanted.joint_velocity, atol=1e-3)
    np.testing.assert_allclose(seen.joint_torque, wanted.joint_torque, atol=1e-2)
    reference.close()


@pytest.mark.slow
def test_diverged_copies_stand_again_on_mjx() -> None:
    engine = MjxEngine()
    after, diverged = throw(engine)
    assert diverged.tolist() == [False, True]
    np.testing.assert_allclose(after.qpos[1], engine.standing()[0], atol=1e-6)


@pytest.mark.slow
def test_large_batches_on_few_cores_do_not_hang() -> None:
    code = (
        "import jax\n"
        "from asimov_gym.physics.functional import MjxEngine\n"
        "import jax.numpy as jnp; from asimov_gym.physics import JointTarget\n"
        "engine = MjxEngine(); s = engine.stand(128)\n"
        "step = jax.jit(lambda s: engine.step(s, JointTarget(s.qpos[:, 7:]), 1)[0])\n"
        "for _ in range(3): s = step(s)\n"
        "print(bool(jnp.isfinite(s.qpos).all()))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=240)
    assert done.stdout.strip() == "True", done.stderr


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("warp") is None, reason="needs warp: pip install 'mujoco-mjx[warp]'")
def test_warp_follows_c_physics() -> None:
    """On the CPU where there is no NVIDIA GPU: slow, but the same kernels."""
    worst = largest_differences(MjxEngine(CONVERGED, "warp"), 10, bodies())
    assert worst["base_position"] < 5e-4 and worst["joint_position"] < 4e-3 and worst["foot_position"] < 1e-3
