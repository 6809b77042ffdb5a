"""Whether this robot can honour a policy's contract: the last check before a network moves it."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np

from asimov_gym.policy.contract import ObservationSchema, ObservationTerm, PolicyContract
from asimov_gym.policy.field_checks import ContractError
from asimov_gym.robot.ankle import gains_to_joint
from asimov_gym.robot.joints import JOINT_NAMES, POLICY_JOINT_NAMES, POLICY_TO_JOINT, RANGE
from asimov_gym.robot.observation import LAYOUTS, POLICY_RATE_HZ

MOTOR_KP_LIMIT = 500.0
"""Largest position gain that a motor takes, N·m/rad."""
MOTOR_KD_LIMIT = 5.0
"""Largest damping gain that a motor takes, N·m·s/rad."""
_RANGE_TOLERANCE = 1e-6
"""rad; published tables round the joint ranges to six digits."""


class ModelMismatchWarning(UserWarning):
    """The policy was trained on a robot model with other figures than the present one."""


def verify_contract(contract: PolicyContract, *, strict: bool = False) -> None:
    """Check that the robot can do what the policy was trained with.

    Args:
        contract: what the policy's file states.
        strict: refuse a policy trained on another model too, instead of warning (`ModelMismatchWarning`).

    Raises:
        ContractError: names the first field that the robot cannot honour.
    """
    verify_joint_names(contract.joint_names)
    _verify_observation(contract.observation)
    if abs(contract.policy_rate_hz - POLICY_RATE_HZ) > 1e-6:
        raise ContractError("policy_rate_hz", contract.policy_rate_hz, f"{POLICY_RATE_HZ:g}, the robot's policy rate")
    _verify_positions(contract)
    _verify_gains(contract)
    _verify_model(contract, strict)


def gain_limits() -> tuple[np.ndarray, np.ndarray]:
    """Largest position and damping gains at the joints, policy order, (23,) each.

    The motors' own limits, except at the ankles, where two motors act through the linkage.
    """
    n = len(JOINT_NAMES)
    kp, kd = gains_to_joint(np.full(n, MOTOR_KP_LIMIT), np.full(n, MOTOR_KD_LIMIT))
    return kp[POLICY_TO_JOINT], kd[POLICY_TO_JOINT]


def verify_joint_names(names: Sequence[str]) -> None:
    """Raise ContractError unless these are the robot's policy joints in order; else limbs would be scrambled."""
    n = len(POLICY_JOINT_NAMES)
    if len(names) != n:
        raise ContractError("joint_names", list(names), f"the {n} joints {', '.join(POLICY_JOINT_NAMES)}")
    for i, (name, expected) in enumerate(zip(names, POLICY_JOINT_NAMES, strict=True)):
        if name != expected:
            raise ContractError(f"joint_names[{i}]", name, f"{expected!r}, as the robot's policy order has it")


def _verify_observation(observation: ObservationSchema) -> None:
    if observation.layout not in LAYOUTS:
        raise ContractError("observation.layout", observation.layout, " or ".join(LAYOUTS))
    expected = ObservationSchema.of(LAYOUTS[observation.layout]).terms
    names, expected_names = [t.name for t in observation.terms], [t.name for t in expected]
    if names != expected_names:
        raise ContractError("observation.terms", names, f"{expected_names} in this order, layout {observation.layout}")
    for i, (term, known) in enumerate(zip(observation.terms, expected, strict=True)):
        _verify_term(f"observation.terms[{i}]", term, known)


def _verify_term(place: str, term: ObservationTerm, known: ObservationTerm) -> None:
    for key in ("size", "scale", "joints"):
        value, expected = getattr(term, key), getattr(known, key)
        if value != expected:
            raise ContractError(f"{place}.{key}", value, f"{expected!r} for term {term.name!r}")


def _verify_positions(contract: PolicyContract) -> None:
    for i, (name, (low, high)) in enumerate(zip(POLICY_JOINT_NAMES, RANGE[POLICY_TO_JOINT], strict=True)):
        for side, limit in enumerate(contract.target_limits[i]):
            if not low - _RANGE_TOLERANCE <= limit <= high + _RANGE_TOLERANCE:
                raise ContractError(f"target_limits[{i}][{side}]", limit, f"[{low:g}, {high:g}], the range of {name}")


def _verify_gains(contract: PolicyContract) -> None:
    for field, limits in zip(("joint_stiffness", "joint_damping"), gain_limits(), strict=True):
        for i, (gain, limit) in enumerate(zip(getattr(contract, field), limits, strict=True)):
            if gain > limit:
                raise ContractError(f"{field}[{i}]", gain, f"[0, {limit:g}], the reach of {POLICY_JOINT_NAMES[i]}")


def _verify_model(contract: PolicyContract, strict: bool) -> None:
    if contract.robot_revision is None:
        return
    # Imported here: the model brings MuJoCo with it, which a contract that is silent about the model does not need.
    from asimov_gym.robot.model import Revision, model_sha256

    try:
        revision = Revision.parse(contract.robot_revision)
    except ValueError as error:
        raise ContractError("robot_revision", contract.robot_revision, str(error)) from None
    present = model_sha256(revision.leg_frames, revision.foot)
    if contract.model_sha256 is None or contract.model_sha256 == present:
        return
    if strict:
        raise ContractError("model_sha256", contract.model_sha256, f"{present}, the hash of the present model")
    warnings.warn(
        f"the policy was trained on another robot model: model_sha256 is {contract.model_sha256}, the present model "
        f"({contract.robot_revision}) has {present}; expect it to walk worse",
        ModelMismatchWarning,
        stacklevel=4,
    )
