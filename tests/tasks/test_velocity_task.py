"""The waypoint task's pure functions: geometry, progress, reaching, reward."""

import dataclasses

import numpy as np
import pytest

from asimov_gym.physics import CPhysics, Reading
from asimov_gym.robot.joints import STAND_POSITION
from asimov_gym.tasks.velocity import VelocityConfig, VelocityState, VelocityTask
from asimov_gym.tasks.velocity.task import OBSERVATION_BOUND, OBSERVATION_SLICES


def reading_at(*places: tuple[float, float, float]) -> Reading:
    """Robots that stand at (x, y, heading)."""
    physics = CPhysics(len(places))
    x, y, yaw = np.array(places).T
    position = np.stack([x, y, np.full_like(x, 0.6145)], axis=-1)
    zero = np.zeros_like(yaw)
    quat = np.stack([np.cos(0.5 * yaw), zero, zero, np.sin(0.5 * yaw)], axis=-1)
    physics.reset(
        physics.configuration(np.tile(STAND_POSITION, (len(x), 1)), position, quat), np.zeros(physics.model.nv)
    )
    reading = physics.read()
    physics.close()
    return reading


def state_with(waypoints: list[tuple[float, float]], copies: int) -> VelocityState:
    return VelocityState(
        step=np.zeros(copies, dtype=np.int64),
        waypoint=np.tile(np.array(waypoints)[None], (copies, 1, 1)),
        aim=np.zeros(copies, dtype=np.int64),
        command=np.zeros((copies, 2, 3)),
    )


def test_the_waypoint_is_shown_in_the_heading_frame():
    task = VelocityTask(VelocityConfig(waypoints=1))
    state = state_with([(2.0, 1.0)], 3)
    reading = reading_at((0.0, 0.0, 0.0), (2.0, 0.0, np.pi / 2), (2.0, 3.0, np.pi))
    shown = task.observe(state, reading)[:, OBSERVATION_SLICES["waypoint"]]
    assert np.allclose(shown, [(2.0, 1.0), (1.0, 0.0), (0.0, 2.0)], atol=1e-6)
    assert np.allclose(task.distance(state, reading), [np.sqrt(5.0), 1.0, 2.0])


def test_observation_is_within_its_bounds_far_away():
    task = VelocityTask(VelocityConfig(waypoints=1))
    observation = task.observe(state_with([(500.0, -400.0)], 1), reading_at((0.0, 0.0, 0.0)))
    assert observation.shape == (1, 61)
    assert observation.dtype == np.float32
    assert np.all(np.abs(observation) <= OBSERVATION_BOUND.astype(np.float32))


def test_progress_and_reaching():
    task = VelocityTask(VelocityConfig(waypoints=2, rewards={"progress": 1.0, "reached": 2.0}))
    state = state_with([(1.0, 0.0), (3.0, 0.0)], 3)
    before = reading_at((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.5, 0.0, 0.0))
    after = reading_at((0.1, 0.0, 0.0), (-0.1, 0.0, 0.0), (0.8, 0.0, 0.0))
    state, advance = task.advance(state, before, after, np.zeros(3, dtype=bool))
    reward, shares = task.reward(advance)
    assert np.allclose(reward, [0.1, -0.1, 2.3])
    assert np.allclose(shares["reached"], [0.0, 0.0, 2.0])
    assert state.aim.tolist() == [0, 0, 1]
    assert np.allclose(task.distance(state, after), [0.9, 1.1, 2.2]), "the third robot aims at the second waypoint now"
    assert task.finished(state).tolist() == [False, False, False]


def test_the_last_waypoint_ends_it_and_a_fall_reaches_nothing():
    task = VelocityTask(VelocityConfig(waypoints=1))
    here = reading_at((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    state, advance = task.advance(state_with([(0.1, 0.0)], 2), here, here, np.array([False, True]))
    assert task.finished(state).tolist() == [True, False]
    reward, _ = task.reward(advance)
    assert reward[0] == pytest.approx(2.0 - 0.01)
    assert reward[1] == pytest.approx(-5.0 - 0.01)


def test_legs_have_the_configured_length_and_turn():
    task = VelocityTask(VelocityConfig(waypoints=6, distance=(0.5, 1.5), turn=0.4))
    draws = np.random.default_rng(0).random((200, task.start_draws))
    state, heading = task.initial_state(draws)
    points = np.concatenate([np.zeros((200, 1, 2)), state.waypoint], axis=1)
    legs = np.diff(points, axis=1)
    lengths = np.linalg.norm(legs, axis=-1)
    assert lengths.min() >= 0.5 - 1e-9
    assert lengths.max() <= 1.5 + 1e-9
    direction = np.concatenate([heading[:, None], np.arctan2(legs[..., 1], legs[..., 0])], axis=1)
    turns = np.angle(np.exp(1j * np.diff(direction, axis=1)))
    assert np.abs(turns).max() <= 0.4 + 1e-9
    assert turns.min() < -0.3 and turns.max() > 0.3


def test_commands_are_kept_within_the_interface():
    task = VelocityTask()
    state = state_with([(1.0, 0.0)] * 4, 1)
    state = task.push_command(state, np.array([[5.0, -5.0, 0.3]]))
    state = task.push_command(state, np.array([[0.1, 0.2, -9.0]]))
    assert np.allclose(state.command[0], [(0.1, 0.2, -2.0), (2.0, -1.0, 0.3)])


def test_same_on_another_array_library():
    torch = pytest.importorskip("torch", reason="needs torch: pip install 'asimov-gym[train]'")
    task = VelocityTask()
    draws = np.random.default_rng(1).random((3, task.start_draws))
    reading = reading_at((0.0, 0.0, 0.5), (1.0, 0.0, 0.0), (0.0, -1.0, 2.0))
    other = type(reading)(**{f.name: torch.tensor(getattr(reading, f.name)) for f in dataclasses.fields(reading)})

    def run(draws, reading):
        state, _ = task.initial_state(draws)
        state = task.push_command(state, draws[:, 0:3])
        state, advance = task.advance(state, reading, reading, task.fallen(reading))
        return task.observe(state, reading), task.reward(advance)[0]

    for ours, theirs in zip(run(draws, reading), run(torch.tensor(draws), other), strict=True):
        assert np.allclose(ours, theirs.numpy(), atol=1e-6)
