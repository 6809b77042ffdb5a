"""Rotations between the frames, against a rotation matrix written out here, and alike on another array library."""

from __future__ import annotations

import math

import numpy as np
import pytest

from asimov_gym.robot.frames import heading, projected_gravity, rotate_inverse, to_heading, yaw_rate


def _matrix(quat: np.ndarray) -> np.ndarray:
    """Body to world."""
    w, x, y, z = quat
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


@pytest.fixture
def quats() -> np.ndarray:
    draws = np.random.default_rng(0).normal(size=(4, 5, 4))
    return draws / np.linalg.norm(draws, axis=-1, keepdims=True)


def test_vectors_turn_into_the_body_frame(quats: np.ndarray) -> None:
    vectors = np.random.default_rng(1).normal(size=(4, 5, 3))
    expected = np.einsum("abji,abj->abi", np.array([[_matrix(q) for q in row] for row in quats]), vectors)
    np.testing.assert_allclose(rotate_inverse(quats, vectors), expected, atol=1e-12)


def test_gravity_is_the_world_down_in_the_body_frame(quats: np.ndarray) -> None:
    down = np.broadcast_to([0.0, 0.0, -1.0], (4, 5, 3))
    np.testing.assert_allclose(projected_gravity(quats), rotate_inverse(quats, down), atol=1e-12)
    np.testing.assert_array_equal(projected_gravity(np.array([1.0, 0.0, 0.0, 0.0])), [0.0, 0.0, -1.0])
    lying = np.array([math.cos(math.pi / 4), 0.0, math.sin(math.pi / 4), 0.0])  # a quarter turn nose down
    np.testing.assert_allclose(projected_gravity(lying), [1.0, 0.0, 0.0], atol=1e-12)


def test_heading_frame_turns_with_the_pelvis() -> None:
    angle = np.array([0.3, -2.0])
    quat = np.stack([np.cos(angle / 2), 0.0 * angle, 0.0 * angle, np.sin(angle / 2)], axis=-1)
    np.testing.assert_allclose(heading(quat), angle)
    forward = np.stack([np.cos(angle), np.sin(angle), np.array([0.7, 0.7])], axis=-1)
    np.testing.assert_allclose(to_heading(angle, forward), [[1.0, 0.0, 0.7]] * 2, atol=1e-12)
    upright = np.array([[0.0, 0.0, -1.0]] * 2)
    np.testing.assert_allclose(yaw_rate(upright, np.array([[0.1, 0.2, 0.5]] * 2)), [0.5, 0.5])


def test_float32_torch_follows_numpy(quats: np.ndarray) -> None:
    torch = pytest.importorskip("torch", reason="torch comes with the training extra")
    vectors = np.random.default_rng(2).normal(size=(4, 5, 3))
    turn = torch.tensor(quats, dtype=torch.float32)
    for ours, theirs in (
        (projected_gravity(quats), projected_gravity(turn)),
        (rotate_inverse(quats, vectors), rotate_inverse(turn, torch.tensor(vectors, dtype=torch.float32))),
        (to_heading(heading(quats), vectors), to_heading(heading(turn), torch.tensor(vectors, dtype=torch.float32))),
    ):
        assert theirs.dtype == torch.float32
        np.testing.assert_allclose(theirs.numpy(), ours, atol=1e-5)
    assert projected_gravity(quats.astype(np.float32)).dtype == np.float32
