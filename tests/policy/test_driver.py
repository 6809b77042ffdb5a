"""The 50 Hz loop equals the same loop written by hand, for one robot as for three."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from asimov_gym.policy import PolicyDriver, load_policy
from asimov_gym.robot.joints import NECK, POLICY_TO_JOINT, RANGE, STAND_POSITION
from asimov_gym.robot.observation import LAYOUTS

STEPS = 40


def senses(steps: int, n: int) -> dict[str, np.ndarray]:
    """Random senses for a number of steps, (steps, n, ...)."""
    rng = np.random.default_rng(3)
    gravity = np.array([0.0, 0.0, -1.0]) + rng.normal(0.0, 0.1, (steps, n, 3))
    return {
        "gyro": rng.normal(0.0, 0.5, (steps, n, 3)),
        "gravity": gravity / np.linalg.norm(gravity, axis=-1, keepdims=True),
        "joint_position": STAND_POSITION + rng.normal(0.0, 0.1, (steps, n, 25)),
        "joint_velocity": rng.normal(0.0, 1.0, (steps, n, 25)),
    }


def commands(steps: int, n: int) -> np.ndarray:
    """Walk, stand, then ask for more than was trained; (steps, n, 3)."""
    command = np.zeros((steps, n, 3))
    command[: steps // 4] = (0.3, 0.1, -0.2)
    command[steps // 2 :] = (2.0, -1.0, 2.0)
    return command


def test_driver_equals_a_loop_by_hand(contract, policy_file, toy) -> None:
    driver = PolicyDriver(load_policy(policy_file(contract)), copies=3)
    network, sensed, asked = toy(80), senses(STEPS, 3), commands(STEPS, 3)
    action, phase = np.zeros((3, 23), dtype=np.float32), 0.0
    for k in range(STEPS):
        command = np.clip(asked[k], [-0.6, -0.4, -0.8], [0.8, 0.4, 0.8])
        moving = np.linalg.norm(command[0]) >= 0.05
        clock = np.tile([math.cos(phase), math.sin(phase)] if moving else [0.0, 0.0], (3, 1))
        now = {name: value[k] for name, value in sensed.items()}
        action = np.clip(
            network(LAYOUTS["asimov-80"].observe(**now, command=command, action=action, clock=clock)), -8, 8
        )
        if moving:
            phase = (phase + 2.0 * math.pi * 1.5 / 50.0) % (2.0 * math.pi)
        expected = np.tile(STAND_POSITION, (3, 1))
        expected[:, POLICY_TO_JOINT] += 0.25 * action
        expected = np.clip(expected, RANGE[:, 0], RANGE[:, 1])

        answer = driver.step(command=asked[k], **now)
        np.testing.assert_allclose(answer, expected, atol=1e-6)
        np.testing.assert_array_equal(answer[:, NECK], np.tile(STAND_POSITION[NECK], (3, 1)))
        np.testing.assert_allclose(driver.command, command)
    assert (answer >= RANGE[:, 0]).all() and (answer <= RANGE[:, 1]).all()


def test_three_robots_walk_as_three_times_one(contract, policy_file) -> None:
    policy = load_policy(policy_file(contract))
    together, alone = PolicyDriver(policy, copies=3), [PolicyDriver(policy) for _ in range(3)]
    sensed, asked = senses(STEPS, 3), commands(STEPS, 3)
    asked[:, 1] *= -0.4
    for k in range(STEPS):
        now = {name: value[k] for name, value in sensed.items()} | {"command": asked[k]}
        answer = together.step(**now)
        for i, single in enumerate(alone):
            one = single.step(**{name: value[i : i + 1] for name, value in now.items()})
            # Last digits may differ: matrix products of one and of three rows are summed in another order.
            np.testing.assert_allclose(answer[i], one[0], atol=1e-5)


def test_clock_rests_while_standing_and_shows_the_phase_before_the_step(contract, policy_file) -> None:
    driver = PolicyDriver(load_policy(policy_file(contract)))
    now = {name: value[0] for name, value in senses(1, 1).items()}
    walk, stand = np.array([[0.3, 0.0, 0.0]]), np.zeros((1, 3))
    driver.step(command=walk, **now)
    np.testing.assert_allclose(driver.observation[0, -2:], [1.0, 0.0], atol=1e-7)
    phase = driver.state.phase[0]
    assert phase == pytest.approx(2.0 * math.pi * 1.5 / 50.0)
    driver.step(command=stand, **now)
    np.testing.assert_array_equal(driver.observation[0, -2:], [0.0, 0.0])
    assert driver.state.phase[0] == phase
    driver.step(command=walk, **now)
    np.testing.assert_allclose(driver.observation[0, -2:], [math.cos(phase), math.sin(phase)], atol=1e-6)


def test_reset_forgets_only_the_chosen_robots(contract, policy_file) -> None:
    driver = PolicyDriver(load_policy(policy_file(contract)), copies=2)
    now = {name: value[0] for name, value in senses(1, 2).items()}
    driver.step(command=np.full((2, 3), 0.3), **now)
    before = driver.state
    driver.reset(np.array([True, False]), phase=math.pi)
    after = driver.state
    np.testing.assert_array_equal(after.action[0], 0.0)
    np.testing.assert_array_equal(after.action[1], before.action[1])
    np.testing.assert_allclose(after.phase, [math.pi, before.phase[1]])
    driver.reset()
    np.testing.assert_array_equal(driver.state.phase, 0.0)


def test_a_restored_state_continues_the_same(contract, policy_file) -> None:
    driver = PolicyDriver(load_policy(policy_file(contract)))
    sensed, asked = senses(20, 1), commands(20, 1)

    def play(start: int) -> np.ndarray:
        return np.stack(
            [driver.step(command=asked[k], **{n: v[k] for n, v in sensed.items()}) for k in range(start, 20)]
        )

    first = play(0)
    driver.reset()
    play(10)
    driver.reset()
    for k in range(10):
        driver.step(command=asked[k], **{n: v[k] for n, v in sensed.items()})
    middle = driver.state
    play(15)
    driver.state = middle
    np.testing.assert_array_equal(play(10), first[10:])


def test_another_default_pose_is_the_origin_of_the_observed_positions(contract, policy_file) -> None:
    pose = tuple(np.asarray(contract.default_joint_pos) + np.where(np.arange(23) == 3, 0.2, 0.0))
    driver = PolicyDriver(load_policy(policy_file(contract, default_joint_pos=pose)))
    position = STAND_POSITION.copy()
    position[POLICY_TO_JOINT] = pose
    upright = {"gyro": np.zeros((1, 3)), "gravity": np.array([[0.0, 0.0, -1.0]]), "joint_velocity": np.zeros((1, 25))}
    driver.step(command=np.zeros((1, 3)), joint_position=position[None], **upright)
    np.testing.assert_allclose(driver.observation[0, 9:32], 0.0, atol=1e-7)


def test_non_finite_senses_show_as_a_fault_of_that_robot_only(contract, policy_file) -> None:
    driver = PolicyDriver(load_policy(policy_file(contract)), copies=2)
    now = {name: value[0] for name, value in senses(1, 2).items()}
    now["gyro"][0, 1] = np.nan
    answer = driver.step(command=np.zeros((2, 3)), **now)
    np.testing.assert_array_equal(driver.finite, [False, True])
    assert np.isfinite(answer[1]).all() and not np.isfinite(driver.raw[0]).all()
    driver.reset(~driver.finite)
    now["gyro"][0, 1] = 0.0
    driver.step(command=np.zeros((2, 3)), **now)
    assert driver.finite.all()


def test_last_action_is_clipped_and_raw_is_not(contract, policy_file) -> None:
    driver = PolicyDriver(load_policy(policy_file(contract, action_clip=0.5)))
    driver.step(command=np.zeros((1, 3)), **{name: value[0] for name, value in senses(1, 1).items()})
    assert np.abs(driver.raw).max() > 0.5
    np.testing.assert_array_equal(driver.state.action, np.clip(driver.raw, -0.5, 0.5))


@pytest.mark.parametrize("name", ["gyro", "gravity", "command", "joint_position", "joint_velocity"])
def test_wrong_shapes_name_the_argument(contract, policy_file, name: str) -> None:
    driver = PolicyDriver(load_policy(policy_file(contract)), copies=2)
    now: dict[str, Any] = {key: value[0] for key, value in senses(1, 2).items()} | {"command": np.zeros((2, 3))}
    with pytest.raises(ValueError, match=f"{name} must have shape"):
        driver.step(**now | {name: now[name][:1]})


def test_bad_copies_mask_and_state_are_errors(contract, policy_file) -> None:
    policy = load_policy(policy_file(contract))
    with pytest.raises(ValueError, match="copies"):
        PolicyDriver(policy, copies=0)
    driver = PolicyDriver(policy, copies=2)
    with pytest.raises(ValueError, match=r"mask must be bool of shape \(2,\)"):
        driver.reset(np.array([0, 1]))
    with pytest.raises(ValueError, match=r"state\.phase"):
        driver.state = replace(driver.state, phase=np.zeros(3))
