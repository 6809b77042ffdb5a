"""The contract survives its file exactly, refuses malformed values by name, and turns actions into targets."""

from __future__ import annotations

import json
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from asimov_gym.policy import (
    ContractError,
    PolicyContract,
    clip_action,
    clip_command,
    default_contract,
    targets,
)
from asimov_gym.robot.joints import KP, POLICY_JOINT_NAMES, POLICY_TO_JOINT, RANGE, STAND_POSITION
from asimov_gym.robot.model import model_sha256

NAN, INF = float("nan"), float("inf")


def test_default_contract_is_the_robots_own_table(contract: PolicyContract) -> None:
    assert contract.joint_names == POLICY_JOINT_NAMES
    assert contract.default_joint_pos[POLICY_JOINT_NAMES.index("left_knee_joint")] == 0.45
    np.testing.assert_array_equal(contract.joint_stiffness, KP[POLICY_TO_JOINT])
    np.testing.assert_array_equal(contract.target_limits, RANGE[POLICY_TO_JOINT])
    assert contract.model_sha256 == model_sha256()
    assert contract.observation.width == 80 and contract.gait_frequency_hz == 1.5
    without_clock = default_contract("asimov-78")
    assert without_clock.observation.width == 78 and without_clock.gait_frequency_hz is None


def test_default_contract_refuses_an_unknown_layout() -> None:
    with pytest.raises(ValueError, match=r"'asimov-99'.*asimov-80, asimov-78"):
        default_contract("asimov-99")


@pytest.mark.parametrize("layout", ["asimov-80", "asimov-78"])
def test_metadata_round_trip_is_exact(layout: str) -> None:
    awkward = tuple(0.1 + 0.2 + i / 3.0 for i in range(23))
    before = replace(
        default_contract(
            layout, action_scale=1.0 / 3.0, command_ranges=((-0.1 - 0.2, 0.8), (-0.4, 0.4), (-1 / 7, 1.0))
        ),
        joint_stiffness=awkward,
        training={"preset": "laptop", "samples": 12_400_000},
    )
    metadata = before.to_metadata()
    assert PolicyContract.from_metadata(metadata) == before
    assert json.loads(metadata["joint_stiffness"])[2] == awkward[2], "numbers are written in full"


def test_metadata_has_every_key_of_the_file_format(contract: PolicyContract) -> None:
    keys = "schema_version observation joint_names default_joint_pos action_scale action_clip target_limits"
    keys += " joint_stiffness joint_damping policy_rate_hz sim_dt decimation gait_frequency_hz standing_threshold"
    keys += " command_ranges robot_revision model_sha256 trained_commit training"
    metadata = contract.to_metadata()
    assert set(metadata) == set(keys.split())
    observation = json.loads(metadata["observation"])
    assert observation["layout"] == "asimov-80"
    assert [term["name"] for term in observation["terms"]][:3] == ["gyro", "gravity", "command"]
    assert observation["terms"][0] == {"name": "gyro", "size": 3, "scale": 0.25, "joints": []}
    assert observation["terms"][5]["joints"][0] == "left_ankle_pitch_joint"
    assert json.loads(metadata["command_ranges"])["vx"] == [-0.6, 0.8]


def test_an_unclipped_policy_without_a_stated_model_round_trips(contract: PolicyContract) -> None:
    before = replace(
        contract, action_clip=None, robot_revision=None, model_sha256=None, trained_commit=None, training=None
    )
    assert PolicyContract.from_metadata(before.to_metadata()) == before


@pytest.mark.parametrize("key", [field.name for field in fields(PolicyContract) if field.name != "training"])
def test_a_missing_key_is_named(contract: PolicyContract, key: str) -> None:
    metadata = contract.to_metadata()
    del metadata[key]
    with pytest.raises(ContractError, match=f"{key} is missing") as caught:
        PolicyContract.from_metadata(metadata)
    assert caught.value.field == key


@pytest.mark.parametrize(
    ("key", "text", "field"),
    [
        ("schema_version", "2", "schema_version"),
        ("joint_names", "left_knee_joint", "joint_names"),
        ("joint_names", '["a", 3]', "joint_names[1]"),
        ("action_scale", "0.25", "action_scale"),
        ("action_scale", "[0.25]", "action_scale"),
        ("joint_stiffness", json.dumps([100.0] * 22 + [NAN]), "joint_stiffness[22]"),
        ("joint_damping", json.dumps([1.0] * 22 + [10**400]), "joint_damping[22]"),
        ("observation", '{"layout": "asimov-80"}', "observation"),
        ("observation", '{"layout": "asimov-80", "terms": {}}', "observation.terms"),
        ("observation", '{"layout": "asimov-80", "terms": ["gyro"]}', "observation.terms[0]"),
        ("command_ranges", "[[-1, 1], [-1, 1], [-1, 1]]", "command_ranges"),
        ("command_ranges", '{"vx": [-1, 1], "vy": [-1, 1], "wz": 1}', "command_ranges[2]"),
        ("decimation", "4.0", "decimation"),
        ("sim_dt", '"0.005"', "sim_dt"),
        ("sim_dt", "true", "sim_dt"),
    ],
)
def test_malformed_metadata_names_the_field(contract: PolicyContract, key: str, text: str, field: str) -> None:
    with pytest.raises(ContractError) as caught:
        PolicyContract.from_metadata(contract.to_metadata() | {key: text})
    assert caught.value.field == field


def _with(values: tuple[Any, ...], index: int, value: Any) -> tuple[Any, ...]:
    return (*values[:index], value, *values[index + 1 :])


@pytest.mark.parametrize(
    ("field", "index", "value", "message"),
    [
        ("default_joint_pos", 3, NAN, "finite"),
        ("default_joint_pos", 3, 2.0, r"within target_limits\[3\], \[0.0, 1.5\]"),
        ("action_scale", 0, 0.0, "above 0"),
        ("action_scale", 0, -0.25, "above 0"),
        ("target_limits", 2, (0.5, -0.5), "low to high"),
        ("target_limits", 2, (-INF, 0.5), "finite"),
        ("joint_stiffness", 7, -1.0, "at least 0"),
        ("joint_damping", 7, INF, "finite"),
    ],
)
def test_a_bad_entry_is_named_with_its_index(
    contract: PolicyContract, field: str, index: int, value: Any, message: str
) -> None:
    with pytest.raises(ContractError, match=message) as caught:
        replace(contract, **{field: _with(getattr(contract, field), index, value)})
    assert caught.value.field.startswith(f"{field}[{index}]")


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"action_clip": 0.0}, "action_clip"),
        ({"action_clip": INF}, "action_clip"),
        ({"joint_names": POLICY_JOINT_NAMES[:1] * 23}, "joint_names"),
        ({"policy_rate_hz": 100.0}, "policy_rate_hz"),
        ({"decimation": 0}, "decimation"),
        ({"gait_frequency_hz": None}, "gait_frequency_hz"),
        ({"gait_frequency_hz": 25.0}, "gait_frequency_hz"),
        ({"standing_threshold": -0.1}, "standing_threshold"),
        ({"command_ranges": ((0.2, 0.8), (-0.4, 0.4), (-0.8, 0.8))}, "command_ranges.vx"),
        ({"command_ranges": ((-0.6, 0.8), (-0.4, 0.4))}, "command_ranges"),
        ({"robot_revision": 3}, "robot_revision"),
        ({"training": "long"}, "training"),
    ],
)
def test_a_bad_field_is_named(contract: PolicyContract, changes: dict[str, Any], field: str) -> None:
    with pytest.raises(ContractError) as caught:
        replace(contract, **changes)
    assert caught.value.field == field


def test_a_clock_rate_without_a_clock_is_refused() -> None:
    with pytest.raises(ContractError, match=r"gait_frequency_hz.*no clock"):
        replace(default_contract("asimov-78"), gait_frequency_hz=1.5)


def test_targets_clip_scale_offset_and_limit(contract: PolicyContract) -> None:
    knee = POLICY_JOINT_NAMES.index("left_knee_joint")
    action = np.zeros((4, 23))
    action[1, knee] = 2.0
    action[2, knee] = 100.0  # clipped to 8, and 0.45 + 0.25 × 8 is beyond the knee's 1.5 rad
    action[3, knee] = -100.0
    result = targets(contract, action)
    np.testing.assert_array_equal(result[0], STAND_POSITION[POLICY_TO_JOINT])
    np.testing.assert_allclose(result[:, knee], [0.45, 0.95, 1.5, 0.0], atol=1e-12)
    np.testing.assert_array_equal(np.delete(result, knee, axis=1), np.delete(result[[0] * 4], knee, axis=1))


def test_targets_clip_actions_before_scaling() -> None:
    narrow = default_contract(action_clip=1.0)
    shoulder = POLICY_JOINT_NAMES.index("left_shoulder_yaw_joint")
    action = np.full(23, 5.0, dtype=np.float32)
    assert targets(narrow, action)[shoulder] == pytest.approx(0.25)
    assert targets(narrow, action).dtype == np.float32
    np.testing.assert_array_equal(clip_action(replace(narrow, action_clip=None), action), action)


def test_clip_command_uses_the_trained_range(contract: PolicyContract) -> None:
    command = np.array([[2.0, -1.0, 0.1], [-2.0, 1.0, -2.0]])
    np.testing.assert_allclose(clip_command(contract, command), [[0.8, -0.4, 0.1], [-0.6, 0.4, -0.8]])


def test_array_functions_run_inside_torch(contract: PolicyContract) -> None:
    torch = pytest.importorskip("torch", reason="needs torch, the train extra")
    action = np.random.default_rng(0).normal(0.0, 5.0, (6, 23))
    result = targets(contract, torch.from_numpy(action))
    np.testing.assert_allclose(result.numpy(), targets(contract, action), rtol=0.0, atol=1e-15)
