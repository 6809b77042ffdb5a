"""The joint table against the robot's numbers, and the orders that the world's interfaces use."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from asimov_gym.robot.joints import (
    EFFORT,
    JOINT_NAMES,
    JOINTS,
    KD,
    KP,
    MOTOR_NAMES,
    MOTORS,
    NECK,
    POLICY_JOINT_NAMES,
    POLICY_TO_JOINT,
    RANGE,
    STAND_POSITION,
    VELOCITY_LIMIT,
    joint_index,
    permutation,
)

Figures = dict[str, Any]


def test_every_joint_s_figures(figures: Figures) -> None:
    expected = {joint["name"]: joint for joint in figures["joints"]}
    assert set(expected) == set(JOINT_NAMES)
    for joint in JOINTS:
        row = expected[joint.name]
        assert joint.body == row["body"]
        assert joint.range == tuple(row["range"])
        for field in (
            "stand",
            "kp",
            "kd",
            "effort",
            "velocity_limit",
            "armature",
            "frictionloss",
            "damping",
            "can_slot",
        ):
            assert getattr(joint, field) == row[field], f"{joint.name}.{field}"
        assert joint.assumed == (row["motor"] is None)
        if row["motor"] is not None:
            assert joint.motor == row["motor"]


def test_vectors_are_the_table_s_columns() -> None:
    columns = {"stand": STAND_POSITION, "kp": KP, "kd": KD, "effort": EFFORT, "range": RANGE}
    columns["velocity_limit"] = VELOCITY_LIMIT
    for field, vector in columns.items():
        np.testing.assert_array_equal(vector, [getattr(joint, field) for joint in JOINTS])
        with pytest.raises(ValueError, match="read-only"):
            vector[0] = 0.0


def test_motor_families(figures: Figures) -> None:
    assert set(MOTORS) == set(figures["motors"])
    for name, row in figures["motors"].items():
        motor = MOTORS[name]
        assert (motor.rated_torque, motor.peak_torque) == (row["rated_torque"], row["peak_torque"])
        assert (motor.rated_speed, motor.peak_speed) == (row["rated_speed"], row["peak_speed"])
        assert (motor.kt, motor.peak_current) == (row["kt"], row["peak_phase_current"])
    assert {joint.motor for joint in JOINTS} == set(MOTORS)


def test_contract_order(figures: Figures) -> None:
    """Joint order is the contract's: same slots as its motors, with pitch and roll where the ankle motors are."""
    assert list(MOTOR_NAMES) == figures["orders"]["contract"]
    assert [MOTOR_NAMES[i] for i in NECK] == ["Neck_Pitch", "Neck_Yaw"]
    for joint, motor in zip(JOINT_NAMES, MOTOR_NAMES, strict=True):
        side = {"L": "left_", "R": "right_"}.get(motor.split("_")[0], "")
        words = motor.lower().split("_")[1 if side else 0 :]
        plain = {"ankle_a": "ankle_pitch", "ankle_b": "ankle_roll"}.get("_".join(words), "_".join(words))
        assert joint == f"{side}{plain}_joint"


def test_dialect_b_swaps_the_neck(figures: Figures) -> None:
    """The SDK's dialect lists the neck as yaw, pitch; nothing else differs from the contract's order."""
    to_b = permutation(MOTOR_NAMES, figures["orders"]["dialect_b"])
    vector = np.arange(25.0)
    np.testing.assert_array_equal(vector[to_b], [*range(23), 24, 23])
    np.testing.assert_array_equal(to_b, permutation(JOINT_NAMES, figures["orders"]["model"]))
    back = permutation(figures["orders"]["dialect_b"], MOTOR_NAMES)
    np.testing.assert_array_equal(vector[to_b][back], vector)


def test_policy_order(figures: Figures) -> None:
    assert list(POLICY_JOINT_NAMES) == figures["orders"]["policy"]
    by_index = {row["policy_index"]: row["name"] for row in figures["joints"] if row["policy_index"] is not None}
    assert [by_index[i] for i in range(23)] == list(POLICY_JOINT_NAMES)
    assert [JOINT_NAMES[i] for i in POLICY_TO_JOINT] == list(POLICY_JOINT_NAMES)
    assert set(range(25)) - set(POLICY_TO_JOINT) == set(NECK)


def test_model_order_is_a_permutation_by_name() -> None:
    """The model's tree order (right arm first, waist between) differs from joint order, and the names bridge it."""
    from asimov_gym.robot.model import robot_model

    model = robot_model()
    tree = [model.joint(i).name for i in range(1, model.njnt)]
    to_tree = permutation(JOINT_NAMES, tree)
    assert not np.array_equal(to_tree, np.arange(25))
    expected = model.key("stand").qpos[7:]
    np.testing.assert_array_equal(STAND_POSITION[to_tree], expected)


def test_left_and_right_mirror() -> None:
    for joint in JOINTS:
        if joint.name.startswith("left_"):
            other = JOINTS[joint_index(joint.name.replace("left_", "right_"))]
            assert other.range == (-joint.range[1], -joint.range[0])
            assert other.stand == -joint.stand
            assert (other.kp, other.kd, other.effort, other.motor) == (joint.kp, joint.kd, joint.effort, joint.motor)


def test_unknown_names_are_refused() -> None:
    with pytest.raises(ValueError, match="unknown joint 'left_elbow'"):
        joint_index("left_elbow")
    with pytest.raises(ValueError, match="left_toe_joint"):
        permutation(JOINT_NAMES, ["left_toe_joint"])
