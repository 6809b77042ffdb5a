"""Shoves: where, how hard, in which direction and for how long."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from asimov_gym.envs.walk_batch import WalkBatch
from asimov_gym.tasks.walk import WalkConfig, WalkState, WalkTask
from asimov_gym.tasks.walk.config import ShoveConfig
from asimov_gym.tasks.walk.state import RESET_DRAWS, SHOVE_DRAWS

N = 4000
SHOVE = ShoveConfig(
    interval_s=(1.0, 2.0),
    duration_s=(0.1, 0.2),
    horizontal={"pelvis_link": 600.0, "left_shoulder_pitch_link": 300.0},
    downward={"left_shoulder_pitch_link": 1200.0, "waist_yaw_link": 900.0},
    first=0.5,
)
PELVIS, SHOULDER, WAIST = range(3)


def start(config: ShoveConfig = SHOVE, n: int = N) -> tuple[WalkTask, WalkState]:
    task = WalkTask(WalkConfig(shove=config))
    return task, task.initial_state(np.random.default_rng(0).random((n, RESET_DRAWS)))


def due(level: float, config: ShoveConfig = SHOVE) -> np.ndarray:
    """Forces of N shoves that begin, (N, B, 3)."""
    task, state = start(config)
    state = replace(state, shove_wait=np.zeros(N, dtype=np.int64))
    return task.shove(state, np.random.default_rng(1).random((N, SHOVE_DRAWS)), level).shove


def test_each_body_gets_its_own_kind_of_force() -> None:
    force = due(1.0)
    assert (np.abs(force).max(axis=2) > 0.0).sum(axis=1).tolist() == [1] * N  # one body at a time
    flat, down = np.linalg.norm(force[:, :, :2], axis=2), -force[:, :, 2]
    assert (down >= 0.0).all()
    for body, strongest in ((PELVIS, 600.0), (SHOULDER, 300.0)):
        sizes = flat[flat[:, body] > 0.0, body]
        assert 0.3 * strongest - 1e-9 <= sizes.min() and 0.97 * strongest < sizes.max() <= strongest
    for body, strongest in ((SHOULDER, 1200.0), (WAIST, 900.0)):
        sizes = down[down[:, body] > 0.0, body]
        assert 0.97 * strongest < sizes.max() <= strongest
    assert not down[:, PELVIS].any() and not flat[:, WAIST].any()
    pressed, shoved = (down[:, SHOULDER] > 0.0).sum(), (flat[:, SHOULDER] > 0.0).sum()
    assert 0.28 < pressed / (pressed + shoved) < 0.39  # a third, 1,300 draws
    angle = np.arctan2(force[:, PELVIS, 1], force[:, PELVIS, 0])[flat[:, PELVIS] > 0.0]
    assert np.histogram(angle, 4, (-np.pi, np.pi))[0].min() > 0.2 * len(angle)  # from all sides


def test_the_weakest_shove_is_a_share_of_the_strongest_of_its_time() -> None:
    sizes = np.linalg.norm(due(0.0, replace(SHOVE, mildest=0.7))[:, PELVIS], axis=1)
    sizes = sizes[sizes > 0.0] / (0.5 * 600.0)
    assert 0.7 - 1e-9 <= sizes.min() < 0.71 and 0.99 < sizes.max() <= 1.0
    assert 0.84 < sizes.mean() < 0.86  # evenly between the two


def test_curriculum_scales_the_force() -> None:
    np.testing.assert_allclose(due(0.0), 0.5 * due(1.0))
    np.testing.assert_allclose(due(0.5), 0.75 * due(1.0))


def test_lasts_its_time_and_comes_again_after_the_pause() -> None:
    task, state = start(n=200)
    rng, acting = np.random.default_rng(2), []
    for _ in range(400):
        state = task.shove(state, rng.random((200, SHOVE_DRAWS)), 1.0)
        acting.append(np.abs(state.shove).max(axis=(1, 2)))
        state = task.advance(state, rng.random((200, 6)))
    force = np.array(acting)
    on = force > 0.0
    edges = np.diff(np.concatenate([np.zeros((1, 200), bool), on, np.zeros((1, 200), bool)]).astype(int), axis=0)
    first = np.argwhere(edges.T == 1)
    last = np.argwhere(edges.T == -1)
    lengths = (last - first)[:, 1]
    whole = last[:, 1] < 400
    assert set(lengths[whole]) <= {5, 6, 7, 8, 9, 10} and len(set(lengths[whole])) == 6  # 0.1 to 0.2 s
    pauses = np.concatenate([first[first[:, 0] == i][1:, 1] - last[last[:, 0] == i][:-1, 1] for i in range(200)])
    assert pauses.min() >= 49 and pauses.max() <= 101 and len(pauses) > 200
    steady = [np.ptp(force[a:b, i]) for (i, a), (_, b) in zip(first, last, strict=True)]
    assert max(steady) < 1e-9  # the force of one shove does not change


def test_same_on_another_array_library() -> None:
    torch = pytest.importorskip("torch")
    task, state = start(n=16)
    state = replace(state, shove_wait=np.arange(16) % 2)
    draws = np.random.default_rng(3).random((16, SHOVE_DRAWS))
    other: Any = replace(state, **{name: torch.as_tensor(value) for name, value in vars(state).items()})
    there = task.shove(other, torch.as_tensor(draws), 0.7)
    wanted = task.shove(state, draws, 0.7)
    for name, value in vars(wanted).items():
        np.testing.assert_array_equal(np.asarray(getattr(there, name)), value, err_msg=name)
    for name, value in task.wrench(wanted).items():
        np.testing.assert_array_equal(np.asarray(task.wrench(there)[name]), value, err_msg=name)


def test_shoves_move_the_robot_and_nothing_else_changes() -> None:
    """Up to the first shove a batch with shoves does what one without does; a step later the pushed ones differ."""
    calm = WalkConfig(kick=replace(WalkConfig().kick, interval_s=(100.0, 200.0)))
    shoving = replace(calm, shove=replace(SHOVE, interval_s=(0.2, 0.2), duration_s=(0.1, 0.1)))
    a, b = (WalkBatch(config, 16, seed=5, noise=False) for config in (calm, shoving))
    zero = np.zeros((16, 23))
    for _ in range(10):
        one, other = a.step(zero), b.step(zero)
        np.testing.assert_array_equal(one.observation, other.observation)
    one, other = a.step(zero), b.step(zero)
    assert b.state.shove.any(axis=(1, 2)).all()
    assert (np.abs(one.reading.base_velocity - other.reading.base_velocity).max(axis=1) > 1e-3).all()
    a.close()
    b.close()


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"horizontal": {"pelvis": 1.0}}, "shove.horizontal names the unknown body 'pelvis'; known: pelvis_link"),
        ({"downward": {"pelvis_link": 9e9}}, r"shove.downward.pelvis_link must lie in \[0, 5000\], got 9"),
        ({"duration_s": (0.0, 0.1)}, r"shove.duration_s\[0\] must lie in"),
        ({"first": 1.5}, r"shove.first must lie in \[0, 1\], got 1.5"),
        ({"mildest": -0.1}, r"shove.mildest must lie in \[0, 1\], got -0.1"),
    ],
)
def test_settings_are_checked(fields: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        ShoveConfig(**fields)


def test_comes_sooner_at_rest() -> None:
    config = replace(SHOVE, pace_at_rest=4)
    task, state = start(config, n=2)
    state = replace(state, command=np.array([[0.0, 0, 0], [0.5, 0, 0]]), command_left=np.full(2, 500))
    state = replace(state, shove_wait=np.full(2, 100), shove_left=np.array([3, 0]))
    waits = []
    for _ in range(4):
        state = task.shove(state, np.zeros((2, SHOVE_DRAWS)), 1.0)
        state = task.advance(state, np.zeros((2, 6)))
        waits.append(state.shove_wait.tolist())
    assert waits == [[99, 99], [98, 98], [94, 97], [90, 96]]  # the shove that acts first comes to its end
    with pytest.raises(ValueError, match=r"shove.pace_at_rest must lie in \[1, 100\], got 0"):
        replace(config, pace_at_rest=0)
