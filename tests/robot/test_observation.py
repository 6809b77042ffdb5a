"""Every entry of the observation stands where its term says, scaled and bounded, in any array library."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from asimov_gym.robot.joints import JOINT_NAMES, STAND_POSITION
from asimov_gym.robot.observation import LAYOUTS, ObservationLayout

layouts = pytest.mark.parametrize("layout", LAYOUTS.values(), ids=LAYOUTS)


def _quantities() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    sizes = {
        "gyro": 3,
        "gravity": 3,
        "command": 3,
        "joint_position": 25,
        "joint_velocity": 25,
        "action": 23,
        "clock": 2,
    }
    return {name: rng.uniform(-1.0, 1.0, (6, size)) for name, size in sizes.items()}


def _entry(layout: ObservationLayout, term: str, place: int, raw: dict[str, np.ndarray]) -> np.ndarray:
    """The raw quantity that belongs at a place of a term, looked up by the joint's name."""
    block = next(t for t in layout.terms if t.name == term)
    if not block.joints:
        return raw[term][:, place]
    joint = JOINT_NAMES.index(block.joints[place])
    if term.startswith("joint_position"):
        return raw["joint_position"][:, joint] - STAND_POSITION[joint]
    return raw["joint_velocity"][:, joint]


@layouts
def test_entries_by_name(layout: ObservationLayout) -> None:
    raw = _quantities()
    vector = layout.observe(**raw)
    assert vector.shape == (6, layout.width)
    assert vector.dtype == np.float32
    for term in layout.terms:
        block = vector[:, layout.slices[term.name]]
        for place in range(term.size):
            expected = np.clip(term.scale * _entry(layout, term.name, place, raw), -term.bound, term.bound)
            np.testing.assert_allclose(block[:, place], expected, rtol=1e-6, atol=1e-7, err_msg=f"{term.name}[{place}]")


@layouts
def test_entries_stay_within_their_bounds(layout: ObservationLayout) -> None:
    vector = layout.observe(**{name: 1e6 * value for name, value in _quantities().items()})
    np.testing.assert_array_equal(np.abs(vector), np.broadcast_to(layout.bounds, vector.shape))


def test_mixed_types_and_torch_give_the_same() -> None:
    layout, raw = LAYOUTS["asimov-80"], _quantities()
    raw["action"] = raw["action"].astype(np.float32)
    ours = layout.observe(**raw)
    assert ours.dtype == np.float32
    torch = pytest.importorskip("torch", reason="torch comes with the training extra")
    theirs: Any = layout.observe(**{name: torch.tensor(value) for name, value in raw.items()})
    assert theirs.dtype == torch.float32
    np.testing.assert_array_equal(theirs.numpy(), ours)
