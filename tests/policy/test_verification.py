"""A contract that the robot cannot honour is refused, and the field is named."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from asimov_gym.policy import (
    ContractError,
    ModelMismatchWarning,
    ObservationSchema,
    PolicyContract,
    default_contract,
    verify_contract,
)
from asimov_gym.policy.verification import gain_limits
from asimov_gym.robot.joints import POLICY_JOINT_NAMES

PITCH = POLICY_JOINT_NAMES.index("left_ankle_pitch_joint")
ROLL = POLICY_JOINT_NAMES.index("right_ankle_roll_joint")


@pytest.mark.parametrize("layout", ["asimov-80", "asimov-78"])
@pytest.mark.parametrize("revision", ["shifted/rigid", "cad/toe"])
def test_our_own_contracts_are_honoured_without_a_warning(layout: str, revision: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        verify_contract(default_contract(layout, robot_revision=revision), strict=True)


def _swap(values: tuple[Any, ...], i: int, j: int) -> tuple[Any, ...]:
    swapped = list(values)
    swapped[i], swapped[j] = swapped[j], swapped[i]
    return tuple(swapped)


def _observation(contract: PolicyContract, index: int, **changes: Any) -> ObservationSchema:
    terms = list(contract.observation.terms)
    terms[index] = replace(terms[index], **changes)
    return replace(contract.observation, terms=tuple(terms))


def _entry(values: tuple[Any, ...], index: int, value: Any) -> tuple[Any, ...]:
    return (*values[:index], value, *values[index + 1 :])


REFUSALS = {
    "unknown layout": ("observation.layout", lambda c: {"observation": replace(c.observation, layout="legs-47")}),
    "term order": (
        "observation.terms",
        lambda c: {"observation": replace(c.observation, terms=_swap(c.observation.terms, 0, 1))},
    ),
    "unknown term": ("observation.terms", lambda c: {"observation": _observation(c, 0, name="base_velocity")}),
    "term scale": ("observation.terms[0].scale", lambda c: {"observation": _observation(c, 0, scale=1.0)}),
    "term size": ("observation.terms[2].size", lambda c: {"observation": _observation(c, 2, size=4)}),
    "joint order within a term": (
        "observation.terms[3].joints",
        lambda c: {"observation": _observation(c, 3, joints=_swap(c.observation.terms[3].joints, 0, 1))},
    ),
    "joint order": ("joint_names[3]", lambda c: {"joint_names": _swap(c.joint_names, 3, 9)}),
    "unknown joint": ("joint_names[22]", lambda c: {"joint_names": _entry(c.joint_names, 22, "tail_joint")}),
    "policy rate": ("policy_rate_hz", lambda c: {"policy_rate_hz": 100.0, "decimation": 2}),
    "target limits beyond the joint": (
        "target_limits[3][1]",
        lambda c: {"target_limits": _entry(c.target_limits, 3, (0.0, 1.6))},
    ),
    "stiffness": ("joint_stiffness[0]", lambda c: {"joint_stiffness": _entry(c.joint_stiffness, 0, 501.0)}),
    "damping": ("joint_damping[0]", lambda c: {"joint_damping": _entry(c.joint_damping, 0, 5.1)}),
    "ankle pitch damping": ("joint_damping[4]", lambda c: {"joint_damping": _entry(c.joint_damping, PITCH, 41.0)}),
    "ankle roll damping": ("joint_damping[11]", lambda c: {"joint_damping": _entry(c.joint_damping, ROLL, 6.5)}),
    "revision": ("robot_revision", lambda c: {"robot_revision": "shifted/wheels"}),
    "revision's form": ("robot_revision", lambda c: {"robot_revision": "asimov"}),
}


@pytest.mark.parametrize("case", list(REFUSALS))
def test_refusal_names_the_field(contract: PolicyContract, case: str) -> None:
    field, changes = REFUSALS[case]
    with pytest.raises(ContractError) as caught:
        verify_contract(replace(contract, **changes(contract)))
    assert caught.value.field == field
    assert field in str(caught.value) and "allowed: " in str(caught.value)


def test_a_contract_for_fewer_joints_is_refused(contract: PolicyContract) -> None:
    legs = {
        name: getattr(contract, name)[:12]
        for name in (
            "joint_names",
            "default_joint_pos",
            "action_scale",
            "target_limits",
            "joint_stiffness",
            "joint_damping",
        )
    }
    with pytest.raises(ContractError, match=r"joint_names.*the 23 joints"):
        verify_contract(replace(contract, **legs))


def test_ankle_gains_reach_through_the_linkage(contract: PolicyContract) -> None:
    kp, kd = gain_limits()
    # Two motors act on each ankle joint: 2 K² times the motor's gain, K 2.02 for pitch and 0.80 for roll.
    np.testing.assert_allclose([kp[PITCH], kd[PITCH]], [2 * 2.02**2 * 500, 2 * 2.02**2 * 5])
    np.testing.assert_allclose([kp[ROLL], kd[ROLL]], [2 * 0.8**2 * 500, 2 * 0.8**2 * 5])
    assert kp[0] == 500 and kd[0] == 5
    verify_contract(replace(contract, joint_damping=_entry(contract.joint_damping, PITCH, 20.0)))


def test_finer_physics_at_the_same_policy_rate_is_honoured(contract: PolicyContract) -> None:
    verify_contract(replace(contract, sim_dt=0.002, decimation=10))


def test_another_model_is_a_warning_or_with_strict_a_refusal(contract: PolicyContract) -> None:
    foreign = replace(contract, model_sha256="0" * 64)
    with pytest.warns(ModelMismatchWarning, match="model_sha256"):
        verify_contract(foreign)
    with pytest.raises(ContractError, match="model_sha256"):
        verify_contract(foreign, strict=True)


def test_the_hash_is_compared_with_the_stated_revision(contract: PolicyContract) -> None:
    with pytest.warns(ModelMismatchWarning, match="cad/rigid"):
        verify_contract(replace(contract, robot_revision="cad/rigid"))
