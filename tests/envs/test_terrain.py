"""The walking environments on terrain: copies start all over it, and heights count from the ground."""

from __future__ import annotations

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

from asimov_gym.envs.walk_batch import WalkBatch
from asimov_gym.robot.terrain import terrain_named
from asimov_gym.tasks.walk import WalkConfig, WalkTask

NAMES = ["slope:6", "rough:0.03", "steps", "stairs_10cm"]


@pytest.mark.parametrize("name", NAMES)
def test_copies_start_all_over_the_terrain_and_on_top_of_it(name: str) -> None:
    batch = WalkBatch(WalkConfig(terrain=name, episode_s=0.1), copies=64, seed=0, kicks=False)
    terrain, flat = terrain_named(name), WalkBatch(copies=64, seed=0)
    assert batch.task.terrain == terrain
    for _ in range(2):
        x, y, z = batch.reading.base_position.T
        for axis, (low, high) in zip((x, y), terrain.start_area, strict=True):
            assert axis.min() >= low and axis.max() <= high and np.ptp(axis) > 0.8 * (high - low)
        # On flat ground the disturbed pose puts the pelvis 0.62 to 0.65 m up; here that is above the highest point that
        # may be under a sole.
        over = z - terrain.standing_height(x.astype(np.float64), y.astype(np.float64))
        assert over.min() > 0.619 and over.max() < 0.65
        first = batch.reading.base_position.copy()
        for _ in range(5):
            step = batch.step(np.zeros((64, 23)))
        assert step.truncated.sum() > 60
        assert not np.array_equal(batch.reading.base_position[:, :2], first[:, :2])
    np.testing.assert_array_equal(flat.reading.base_position[:, :2], 0.0)


def test_heights_count_from_the_ground() -> None:
    """On a hillside the task's quantities are those on flat ground."""
    task, flat = WalkTask(WalkConfig(terrain="slope:10")), WalkTask()
    batch = WalkBatch(copies=4, seed=0)
    there = batch.reading
    x = np.array([-8.0, -2.0, 3.0, 5.0])
    rise = task.terrain.height(x, np.zeros(4))
    shift = np.stack([x, 0.0 * x, rise], axis=1)
    feet = there.foot_position + shift[:, None]
    feet[:, :, 2] += task.terrain.height(feet[:, :, 0], feet[:, :, 1]) - rise[:, None]
    here = replace(there, base_position=there.base_position + shift, foot_position=feet)
    np.testing.assert_array_equal(task.fallen(here), flat.fallen(there))
    np.testing.assert_allclose(
        task.motion(batch.state, here)[1].foot_height, flat.motion(batch.state, there)[1].foot_height, atol=1e-6
    )
    np.testing.assert_allclose(
        task.privilege(batch.state, here, batch.body), flat.privilege(batch.state, there, batch.body), atol=1e-5
    )
    sunk = replace(here, base_position=here.base_position - np.array([0.0, 0.0, 0.3]))
    assert task.fallen(sunk).all()
    assert not flat.fallen(sunk)[rise > 0.5].any()  # high enough above the sea


def test_robots_stand_on_it() -> None:
    """Most copies are still up after a second of holding the standing pose."""
    for name in ("rough:0.02", "steps:0.02"):
        batch = WalkBatch(WalkConfig(terrain=name), copies=64, seed=0, kicks=False, autoreset=False)
        fallen = np.zeros(64, dtype=bool)
        for _ in range(50):
            step = batch.step(np.zeros((64, 23)))
            fallen |= step.terminated
        assert fallen.mean() < 0.4
        up = ~fallen
        carried = step.reading.foot_force[up, :, 2].sum(axis=1)
        assert np.median(carried) == pytest.approx(316.0, rel=0.3)


def test_gymnasium_environments_take_a_terrain() -> None:
    env = gym.make("Asimov-Walk-v0", config={"terrain": "slope:5"})
    first, again = env.reset(seed=3)[0], env.reset(seed=3)[0]
    np.testing.assert_array_equal(first, again)
    env.step(np.zeros(23, dtype=np.float32))
    env.close()
    with pytest.raises(ValueError, match="terrain 'hills' is unknown; known terrains: flat"):
        gym.make("Asimov-Walk-v0", config={"terrain": "hills"})
    with pytest.raises(ValueError, match="terrain must be a name"):
        WalkConfig(terrain=3)  # type: ignore[arg-type]


def test_a_batch_on_terrain_continues_exactly_from_a_snapshot() -> None:
    actions = np.random.default_rng(3).standard_normal((30, 4, 23))
    config = WalkConfig(terrain="rough", episode_s=0.3)
    batch, other = (WalkBatch(config, copies=4, seed=seed) for seed in (5, 99))
    for action in actions[:15]:
        batch.step(action)
    other.restore(batch.snapshot())
    for action in actions[15:]:
        one, two = batch.step(action), other.step(action)
        np.testing.assert_array_equal(one.observation, two.observation)
        np.testing.assert_array_equal(one.privileged, two.privileged)


def test_engines_have_the_task_s_terrain() -> None:
    pytest.importorskip("mujoco.mjx", reason="needs JAX and MJX: pip install 'asimov-gym[mjx]'")
    from asimov_gym.envs.functional import FunctionalWalk
    from asimov_gym.physics.functional import CEngine

    assert FunctionalWalk(WalkConfig(terrain="steps"), "c").engine.terrain == terrain_named("steps")
    with pytest.raises(ValueError, match=r"an engine on terrain 'flat', the task needs 'rough:0\.03,0'"):
        FunctionalWalk(WalkConfig(terrain="rough"), CEngine())
    late = replace(WalkConfig(), noise=replace(WalkConfig().noise, can_slot_delay=True))
    with pytest.raises(ValueError, match=r"trail=0, the task needs trail=2"):
        FunctionalWalk(late, CEngine())
