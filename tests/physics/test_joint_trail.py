"""Engines remember where the joints were in the physics steps before."""

from __future__ import annotations

import importlib.util
from typing import Any

import numpy as np
import pytest

from asimov_gym.physics import CPhysics, JointTarget
from asimov_gym.robot.joints import STAND_POSITION


def targets(steps: int, copies: int = 2) -> np.ndarray:
    return STAND_POSITION + 0.1 * np.random.default_rng(0).standard_normal((steps, copies, 25))


def in_the_air(physics: CPhysics) -> tuple[np.ndarray, np.ndarray]:
    """A state of the batch in which a step does not depend on where the solver starts, for nothing touches."""
    qpos, qvel = (np.tile(part, (physics.copies, 1)) for part in physics.standing())
    qpos[:, 2] += 1.0
    return qpos, qvel


def joints(physics: CPhysics) -> np.ndarray:
    """(N, 2, 25)."""
    return np.stack([physics.read().joint_position, physics.read().joint_velocity], axis=1)


def test_c_physics_remembers() -> None:
    whole, parts = CPhysics(2, "training", trail=2), CPhysics(2, "training")
    for physics in (whole, parts):
        physics.reset(*in_the_air(physics))
    passed = 3 * [joints(parts)]  # before a reset all is as at it
    np.testing.assert_array_equal(whole.joint_trail(), np.stack(passed[:2], axis=1))
    for target, substeps in zip(targets(3), (4, 1, 2), strict=True):
        for _ in range(substeps):
            parts.step(JointTarget(target), 1)
            passed.append(joints(parts))
        whole.step(JointTarget(target), substeps)
        np.testing.assert_allclose(joints(whole), passed[-1], atol=1e-9)
        np.testing.assert_allclose(whole.joint_trail(), np.stack([passed[-2], passed[-3]], axis=1), atol=1e-9)


def test_a_reset_forgets_and_spares_the_others() -> None:
    physics = CPhysics(2, "training", trail=2)
    physics.step(JointTarget(targets(1)[0]), 4)
    kept = physics.joint_trail()[1]
    physics.reset(*physics.standing(), copies=np.array([True, False]))
    np.testing.assert_array_equal(physics.joint_trail()[0], joints(physics)[[0, 0]])
    np.testing.assert_array_equal(physics.joint_trail()[1], kept)
    assert not np.array_equal(kept[0], joints(physics)[1])
    physics.set_state(physics.state())
    np.testing.assert_array_equal(physics.joint_trail()[1], joints(physics)[[1, 1]])


def test_bad_length() -> None:
    with pytest.raises(ValueError, match="trail must be at least 0, got -1"):
        CPhysics(1, trail=-1)


needs_jax = pytest.mark.skipif(
    importlib.util.find_spec("jax") is None or importlib.util.find_spec("mujoco.mjx") is None,
    reason="needs JAX and MJX: pip install 'asimov-gym[mjx]'",
)


def compare(engine: Any) -> None:
    """An engine under JAX against C physics, in the air."""
    import jax
    import jax.numpy as jnp

    physics = CPhysics(2, engine.profile, trail=2)
    qpos, qvel = in_the_air(physics)
    physics.reset(qpos, qvel)
    simulation, step = engine.start(qpos, qvel), jax.jit(lambda s, p: engine.step(s, JointTarget(p), 4))
    for target in (None, *targets(2)):
        if target is not None:
            simulation, _ = step(simulation, jnp.asarray(target, dtype=jnp.float32))
            physics.step(JointTarget(target), 4)
        trail, wanted = np.asarray(simulation.joint_trail), physics.joint_trail()
        np.testing.assert_allclose(trail[:, :, 0], wanted[:, :, 0], atol=2e-5)  # float32 states, as in the parity tests
        np.testing.assert_allclose(trail[:, :, 1], wanted[:, :, 1], atol=2e-3)


@needs_jax
def test_c_engine_remembers() -> None:
    from asimov_gym.physics.functional import CEngine

    compare(CEngine("training", trail=2))


@needs_jax
@pytest.mark.slow
def test_mjx_remembers() -> None:
    from asimov_gym.physics.functional import MjxEngine

    compare(MjxEngine("training", trail=2))
