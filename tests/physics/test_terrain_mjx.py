"""The engines under JAX on terrain: the forces and the paths of C MuJoCo, and arrays that hold every contact."""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

if importlib.util.find_spec("jax") is None or importlib.util.find_spec("mujoco.mjx") is None:
    pytest.skip("needs JAX and MJX: pip install 'asimov-gym[mjx]'", allow_module_level=True)

from asimov_gym.physics import CPhysics, JointTarget, PhysicsProfile
from asimov_gym.physics.functional import CEngine, Engine, MjxEngine, Simulation  # prepares JAX
from asimov_gym.physics.functional.ground_contact import MOST_CONTACTS, possible_contacts
from asimov_gym.robot.joints import STAND_POSITION, joint_index
from asimov_gym.robot.model import robot_spec

# isort: split
import jax
import jax.numpy as jnp
from mujoco import mjx

N, SUBSTEPS = 8, 4
CONVERGED = PhysicsProfile(
    "converged", False, 1.0, 0, iterations=50, ls_iterations=50, bodies_collide=False, dry_friction=False
)
WEIGHT = 32.2249 * 9.81
"""N."""
needs_warp = pytest.mark.skipif(
    importlib.util.find_spec("warp") is None, reason="needs warp: pip install 'mujoco-mjx[warp]'"
)


def start(engine: Engine) -> tuple[np.ndarray, np.ndarray]:
    """Standing robots that face +x over places of the terrain, a centimetre up, (N, nq) and (N, nv)."""
    qpos, qvel = (np.tile(part, (N, 1)) for part in engine.standing())
    qpos[:, 0:3] = engine.terrain.start(np.random.default_rng(4).random((N, 2)))
    qpos[:, 2] += 0.6245
    return qpos, qvel


def pose_on(engine: Engine) -> np.ndarray:
    """The standing pose, with soles flat on a tilted floor for robots that face uphill, (25,)."""
    pose = STAND_POSITION.copy()
    for side, sign in (("left", -1.0), ("right", 1.0)):
        pose[joint_index(f"{side}_ankle_pitch_joint")] += sign * np.radians(engine.terrain.tilt_deg)
    return pose


def tape(engine: Engine, steps: int, amplitude: float) -> np.ndarray:
    """Joint targets that swing about the standing pose, (steps, N, 25)."""
    rng = np.random.default_rng(0)
    phase, reach = rng.uniform(0.0, 2.0 * np.pi, (N, 25)), rng.uniform(0.0, amplitude, (N, 25))
    time = np.arange(steps)[:, None, None] * 0.02
    return pose_on(engine) + reach * np.sin(2.0 * np.pi * time + phase) * np.minimum(1.0, 2.0 * time)


Step = Callable[[Simulation, Any], tuple[Simulation, Any]]


def compiled(engine: Engine) -> Step:
    return jax.jit(lambda s, p: engine.step(s, JointTarget(p), SUBSTEPS))


def apart(engine: Engine, step: Step, steps: int, amplitude: float = 0.05) -> dict[str, np.ndarray]:
    """Of each quantity, the largest difference over a rollout from C MuJoCo in float64, by copy, (N,)."""
    physics = CPhysics(N, engine.profile, threads=1, model=engine.model)
    qpos, qvel = start(engine)
    physics.reset(qpos, qvel)
    simulation = engine.start(qpos, qvel)
    worst: dict[str, np.ndarray] = {}
    for position in tape(engine, steps, amplitude):
        simulation, diverged = step(simulation, jnp.asarray(position, dtype=jnp.float32))
        assert not diverged.any()
        wanted, seen = physics.step(JointTarget(position), SUBSTEPS), engine.read(simulation)
        for name, value in vars(wanted).items():
            error = np.abs(np.asarray(getattr(seen, name)) - value).reshape(N, -1).max(axis=1)
            worst[name] = np.maximum(error, worst.get(name, 0.0))
    physics.close()
    return worst


def force_at_rest(engine: Engine, step: Step, steps: int = 100) -> np.ndarray:
    """Mean vertical force on both feet, N, of the copies that stand still after a while."""
    qpos, qvel = start(engine)
    position = jnp.asarray(np.tile(pose_on(engine), (N, 1)), dtype=jnp.float32)
    simulation, forces = engine.start(qpos, qvel), []
    for _ in range(steps):
        simulation, _ = step(simulation, position)
        forces.append(np.asarray(simulation.foot_force)[:, :, 2].sum(axis=1))
    still = np.abs(np.asarray(simulation.qvel)).max(axis=1) < 0.5
    assert still.sum() >= N // 2, "too many toppled for this to say anything"
    return np.mean(forces[-25:], axis=0)[still]


@pytest.mark.parametrize(
    ("terrain", "contacts"),
    [
        ("flat", 8),
        ("slope:6", 8),
        ("rough", 40),
        ("steps", 40),
        ("slope_10deg", 32),
        ("stairs_10cm", 48),
        ("obstacles", 120),
    ],
)
def test_arrays_hold_every_contact_that_can_be(terrain: str, contacts: int) -> None:
    """MJX on JAX keeps a place for each contact that its functions can find: our count is theirs."""
    engine = MjxEngine(terrain=terrain)
    assert engine.contacts == contacts
    assert engine._template(1)._impl.contact.dist.shape == (contacts,)  # type: ignore[union-attr]


def test_toes_are_counted_too() -> None:
    """Capsules, which touch a plane twice and a height field up to four times."""
    for terrain in ("flat", "rough"):
        engine = MjxEngine(spec=lambda: robot_spec(foot="toe", visuals=False), terrain=terrain)
        assert engine._template(1)._impl.contact.dist.shape == (engine.contacts,)  # type: ignore[union-attr]


@pytest.mark.parametrize("backend", ["jax", pytest.param("warp", marks=needs_warp)])
def test_too_many_contacts_are_refused(backend: Any) -> None:
    with pytest.raises(ValueError, match=r"'rough_tiles' cannot run on MJX.*3208 contacts.*use physics='c'"):
        MjxEngine(backend=backend, terrain="rough_tiles")
    assert possible_contacts(CEngine().model, "flat") == 8 <= MOST_CONTACTS


def test_unknown_terrain() -> None:
    with pytest.raises(ValueError, match="terrain 'hills' is unknown; known terrains: flat"):
        CEngine(terrain="hills")


def test_c_engine_repeats_c_physics_on_terrain() -> None:
    engine = CEngine(CONVERGED, threads=1, terrain="rough")
    worst = apart(engine, compiled(engine), 5)
    # As on flat ground: the state passes through float32 between two steps.
    assert worst["base_position"].max() < 1e-5 and worst["joint_position"].max() < 1e-4


@pytest.mark.slow
@pytest.mark.parametrize(
    ("terrain", "position", "angle"), [("slope:3", 1e-4, 1e-3), ("steps", 2e-4, 2e-3), ("rough:0.03", 1e-2, 2e-2)]
)
def test_mjx_follows_c_physics_on_terrain(terrain: str, position: float, angle: float) -> None:
    """Bounds of the copy that differs most over 50 policy steps (200 physics steps), in m and rad. Measured: 5e-6 and
    8e-5 on the slope, 2e-5 and 1.3e-4 on steps, 1.6e-3 and 2.9e-3 on rough ground, where a sole that just clears a
    cell's edge on one engine touches it on the other."""
    engine = MjxEngine(CONVERGED, terrain=terrain)
    step = compiled(engine)
    worst = apart(engine, step, 50)
    assert worst["base_position"].max() < position and worst["foot_position"].max() < position
    assert worst["joint_position"].max() < angle
    assert np.median(worst["base_position"]) < 2e-4 and np.median(worst["joint_position"]) < 2e-3
    np.testing.assert_allclose(force_at_rest(engine, step), WEIGHT, rtol=0.02)


@pytest.mark.slow
@needs_warp
def test_warp_follows_c_physics_on_terrain() -> None:
    """On the CPU where there is no NVIDIA GPU: slow, but the same kernels."""
    engine = MjxEngine(CONVERGED, "warp", terrain="rough:0.03")
    step = compiled(engine)
    worst = apart(engine, step, 10)
    # Measured: 2e-6 m and 2e-5 rad in the median, 4e-4 m and 1.2e-2 rad in the copy that differs most.
    assert np.median(worst["base_position"]) < 1e-4 and np.median(worst["joint_position"]) < 1e-3
    assert worst["base_position"].max() < 5e-3 and worst["joint_position"].max() < 5e-2
    np.testing.assert_allclose(force_at_rest(engine, step), WEIGHT, rtol=0.02)


@pytest.mark.slow
@needs_warp
@pytest.mark.parametrize("terrain", ["rough:0.03", "steps"])
def test_warp_has_room_for_every_contact(terrain: str) -> None:
    """All soles of a batch sunk into the ground at once."""
    engine = MjxEngine(CONVERGED, "warp", terrain=terrain)
    qpos, _ = start(engine)
    qpos[:, 2] -= 0.06
    data = engine._template(N)
    batch = jax.vmap(lambda q: data.replace(qpos=q))(jnp.asarray(qpos, dtype=jnp.float32))
    after = jax.jit(jax.vmap(lambda d: mjx.step(engine._mjx_model, d)))(batch)._impl
    overflow: Any = importlib.import_module("mujoco.mjx.third_party.mujoco_warp").OverflowType
    harmless = overflow.ITERATIONS | overflow.LS_ITERATIONS
    assert N * 4 <= np.asarray(after.nacon).max() <= N * engine.contacts
    assert not (np.asarray(after.overflow) & ~int(harmless)).any()
