"""Joints are sensed as late as their turn on the motor bus makes them, the same on every array library."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from asimov_gym.envs.walk_batch import WalkBatch
from asimov_gym.robot.joints import JOINT_NAMES, JOINTS
from asimov_gym.robot.observation import CAN_GROUPS
from asimov_gym.tasks.walk import WalkConfig
from asimov_gym.tasks.walk.bus_age import BUS_DRAWS, OLDEST, aged, slot_ages
from asimov_gym.tasks.walk.config import NoiseConfig

ON = WalkConfig(noise=NoiseConfig(can_slot_delay=True), episode_s=0.3)


def test_ages_by_slot() -> None:
    ages = slot_ages(np.random.default_rng(0).random((3000, BUS_DRAWS)))
    assert ages.shape == (3000, 25) and ages.dtype.kind == "i"
    for group, largest in zip(CAN_GROUPS, (2, 1, 0), strict=True):
        of_group = ages[:, [JOINT_NAMES.index(name) for name in group]]
        assert (of_group == of_group[:, :1]).all()  # a group is as old as one of its joints
        shares = np.bincount(of_group[:, 0], minlength=3)[: largest + 1] / 3000
        np.testing.assert_allclose(shares, 1.0 / (largest + 1), atol=0.04)  # four standard deviations
    assert {j.can_slot for j, age in zip(JOINTS, ages.max(axis=0), strict=True) if age == OLDEST} == {0, 1}


def test_ages_and_readings_on_jax_are_those_on_numpy() -> None:
    jax = pytest.importorskip("jax", reason="needs JAX: pip install 'asimov-gym[mjx]'")
    from asimov_gym.physics import functional  # noqa: F401  (lets JAX look into a reading)

    rng = np.random.default_rng(1)
    draws = rng.random((64, BUS_DRAWS), dtype=np.float32)
    trail = rng.standard_normal((64, OLDEST, 2, 25)).astype(np.float32)
    reading = WalkBatch(copies=64).reading
    ages = slot_ages(draws)
    np.testing.assert_array_equal(jax.jit(slot_ages)(draws), ages)
    here, there = aged(reading, trail, ages), jax.jit(aged)(reading, trail, ages)
    for name in ("joint_position", "joint_velocity"):
        np.testing.assert_array_equal(getattr(there, name), getattr(here, name))
        assert not np.array_equal(getattr(here, name), getattr(reading, name))


def test_an_age_picks_its_moment() -> None:
    reading = WalkBatch(copies=1).reading
    trail = np.stack([np.full((1, 2, 25), 100.0), np.full((1, 2, 25), 200.0)], axis=1)
    ages = np.zeros((1, 25), dtype=int)
    ages[0, 3], ages[0, 4] = 1, 2
    seen = aged(reading, trail, ages)
    for name in ("joint_position", "joint_velocity"):
        value, now = getattr(seen, name)[0], getattr(reading, name)[0]
        assert value[3] == 100.0 and value[4] == 200.0
        np.testing.assert_array_equal(np.delete(value, [3, 4]), np.delete(now, [3, 4]))


def test_the_actor_sees_late_joints_and_the_critic_does_not() -> None:
    """Without other noise, over several episodes: each joint shows one of its last three states."""
    silent = NoiseConfig(gyro=0.0, gravity=0.0, joint_position=0.0, joint_velocity=0.0, joint_zero=0.0)
    config = replace(ON, noise=replace(silent, can_slot_delay=True))
    batch = WalkBatch(config, copies=8, seed=0, randomise=False, kicks=False)
    rng, late = np.random.default_rng(0), 0
    for _ in range(40):
        step = batch.step(rng.normal(0.0, 1.0, (8, 23)).astype(np.float32))
        clean = batch.task.observe(batch.state, batch.reading)
        np.testing.assert_array_equal(step.privileged[:, :80], clean)
        changed = step.observation != clean
        layout = batch.task.layout.slices
        joints = np.zeros(80, dtype=bool)
        for group in (0, 1):
            joints[layout[f"joint_position_{group}"]] = joints[layout[f"joint_velocity_{group}"]] = True
        assert not changed[:, ~joints].any()
        late += int(changed.any(axis=1).sum())
        done = step.terminated | step.truncated
        assert not changed[done].any()  # nothing lies before a start
    assert late > 100


def test_it_is_off_by_default_and_needs_a_truth_value() -> None:
    assert not WalkConfig().noise.can_slot_delay
    assert WalkBatch(copies=1).physics.trail == 0 and WalkBatch(ON, copies=1).physics.trail == OLDEST
    assert WalkBatch(ON, copies=1, noise=False).physics.trail == 0
    with pytest.raises(ValueError, match=r"noise\.can_slot_delay must be true or false, got 1"):
        NoiseConfig(can_slot_delay=1)  # type: ignore[arg-type]


def test_a_late_batch_continues_exactly_from_a_snapshot() -> None:
    actions = np.random.default_rng(3).standard_normal((30, 4, 23))
    batch, other = (WalkBatch(ON, copies=4, seed=seed) for seed in (5, 99))
    for action in actions[:15]:
        batch.step(action)
    other.restore(batch.snapshot())
    for action in actions[15:]:
        np.testing.assert_array_equal(other.step(action).observation, batch.step(action).observation)
