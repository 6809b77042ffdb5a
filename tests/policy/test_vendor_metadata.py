"""Policies exported by the robot's maker run, ours carry their keys, and what is not known of theirs is refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from asimov_gym.policy import ContractError, PolicyDriver, default_contract, load_policy
from asimov_gym.policy.vendor_metadata import COMMAND_RANGES, contract_from_vendor, file_metadata
from asimov_gym.robot.joints import POLICY_JOINT_NAMES, POLICY_TO_JOINT, RANGE, STAND_POSITION
from asimov_gym.robot.observation import LAYOUTS


def test_a_vendor_file_drives_the_robot(vendor_metadata, tmp_path: Path, toy) -> None:
    network = toy(78)
    policy = load_policy(network.save(tmp_path / "theirs.onnx", vendor_metadata, batch=1))
    driver = PolicyDriver(policy)
    position, action = STAND_POSITION[None] + 0.05, np.zeros((1, 23), np.float32)
    gyro, gravity = np.array([[0.1, -0.2, 0.3]]), np.array([[0.0, 0.1, -0.995]])
    command, velocity = np.array([[0.5, 0.0, 2.0]]), np.full((1, 25), 0.4)
    for _ in range(5):
        seen = LAYOUTS["asimov-78"].observe(
            gyro=gyro,
            gravity=gravity,
            command=np.array([[0.5, 0.0, 0.8]]),  # their trained yaw rates end at 0.8
            joint_position=position,
            joint_velocity=velocity,
            action=action,
            clock=None,
        )
        action = network(seen)
        expected = np.clip(
            STAND_POSITION[POLICY_TO_JOINT] + 0.25 * action, RANGE[POLICY_TO_JOINT, 0], RANGE[POLICY_TO_JOINT, 1]
        )
        answer = driver.step(gyro, gravity, command, position, velocity)
        np.testing.assert_allclose(answer[:, POLICY_TO_JOINT], expected, atol=1e-5)


def test_what_their_metadata_says_and_leaves_open(vendor_metadata) -> None:
    contract = contract_from_vendor(vendor_metadata)
    assert contract.observation.layout == "asimov-78"
    assert contract.joint_names == POLICY_JOINT_NAMES
    assert contract.action_clip is None and contract.gait_frequency_hz is None
    assert contract.trained_commit == "32aef5c5ec11-dirty"
    assert contract.command_ranges == COMMAND_RANGES
    np.testing.assert_array_equal(contract.target_limits, RANGE[POLICY_TO_JOINT])
    assert contract.robot_revision is None
    assert contract_from_vendor(vendor_metadata | {"robot_model_name": "asimov_1"}).robot_revision == "shifted/rigid"


def test_their_clips_are_of_targets_and_of_raw_actions(vendor_metadata) -> None:
    limits: list[Any] = [[None, None]] * 23
    limits[3], limits[5] = [0.1, None], [-9.0, 9.0]
    changed = vendor_metadata | {"action_clip": json.dumps(limits), "raw_action_clip": "4.0", "action_scale": "0.3"}
    contract = contract_from_vendor(changed)
    assert contract.action_clip == 4.0 and contract.action_scale == (0.3,) * 23
    assert contract.target_limits[3] == (0.1, 1.5)
    assert contract.target_limits[5] == (-0.35, 0.35)


@pytest.mark.parametrize(
    ("key", "value", "field"),
    [
        ("deploy_metadata_version", "2", "deploy_metadata_version"),
        ("obs_dim", "390", "obs_dim"),
        ("action_dim", "12", "action_dim"),
        ("joint_names", json.dumps([*POLICY_JOINT_NAMES[:21], *POLICY_JOINT_NAMES[:20:-1]]), "joint_names[21]"),
        ("joint_names", '"left_knee_joint"', "joint_names"),
        ("action_scale", "[0.25]", "action_scale"),
        ("action_scale", json.dumps([0.25] * 22 + [float("nan")]), "action_scale[22]"),
        ("action_offset", json.dumps([3.0] * 23), "action_offset[0]"),
        ("action_clip", "1.0", "action_clip"),
        ("action_clip", json.dumps([[None, float("nan")]] * 23), "action_clip[0]"),
        ("action_clip", json.dumps([[1.2, 1.0]] * 23), "action_clip[0]"),
        ("raw_action_clip", "-1.0", "raw_action_clip"),
        ("joint_stiffness", "null", "joint_stiffness"),
        ("policy_rate_hz", "200.0", "policy_rate_hz"),
        (
            "observation_names",
            '["base_ang_vel", "projected_gravity", "command", "joint_pos", "actions"]',
            "observation_names",
        ),
        ("robot_model_name", "asimov_2", "robot_model_name"),
    ],
)
def test_refusals_name_their_key(vendor_metadata, key: str, value: str, field: str) -> None:
    with pytest.raises(ContractError) as caught:
        contract_from_vendor(vendor_metadata | {key: value})
    assert caught.value.field == field


def test_a_term_without_known_scale_is_refused_by_its_place(vendor_metadata) -> None:
    names = json.loads(vendor_metadata["observation_names"])
    names[0] = "base_lin_vel"
    with pytest.raises(ContractError, match=r"observation_names\[0\] is 'base_lin_vel'; allowed: base_ang_vel"):
        contract_from_vendor(vendor_metadata | {"observation_names": json.dumps(names)})


@pytest.mark.parametrize("key", ["obs_dim", "joint_names", "action_offset", "joint_damping", "observation_names"])
def test_a_missing_key_is_named(vendor_metadata, key: str) -> None:
    del vendor_metadata[key]
    with pytest.raises(ContractError, match=f"{key} is missing"):
        contract_from_vendor(vendor_metadata)


def test_our_78_files_speak_both_schemas(vendor_metadata, tmp_path: Path, toy) -> None:
    ours = default_contract("asimov-78", action_clip=8.0, trained_commit="0123abc")
    metadata = file_metadata(ours)
    assert set(vendor_metadata) <= set(metadata)
    assert load_policy(toy(78).save(tmp_path / "both.onnx", metadata)).contract == ours
    # What a reader that knows only the maker's keys finds is the same policy.
    theirs = contract_from_vendor({k: v for k, v in metadata.items() if k != "schema_version"})
    for name in (
        "default_joint_pos",
        "action_scale",
        "action_clip",
        "target_limits",
        "joint_stiffness",
        "joint_damping",
    ):
        assert getattr(theirs, name) == getattr(ours, name)
    unclipped = default_contract("asimov-78", action_clip=None)
    assert load_policy(toy(78).save(tmp_path / "open.onnx", file_metadata(unclipped))).contract == unclipped


def test_files_with_a_clock_carry_no_vendor_keys(contract) -> None:
    assert "deploy_metadata_version" not in file_metadata(contract)
