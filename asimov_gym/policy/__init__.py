"""The walking network as a contract: what it was trained with, whether the robot can honour it, and running it.

Running a policy needs onnxruntime alone; writing one is `train.export`.
"""

from asimov_gym.policy.contract import (
    ObservationSchema,
    ObservationTerm,
    PolicyContract,
    clip_action,
    clip_command,
    default_contract,
    joint_gains,
    targets,
)
from asimov_gym.policy.driver import PolicyDriver, PolicyState
from asimov_gym.policy.field_checks import ContractError
from asimov_gym.policy.runner import Policy, PolicyFileError, PolicyRunner, load_policy
from asimov_gym.policy.verification import ModelMismatchWarning, verify_contract

__all__ = [
    "ContractError",
    "ModelMismatchWarning",
    "ObservationSchema",
    "ObservationTerm",
    "Policy",
    "PolicyContract",
    "PolicyDriver",
    "PolicyFileError",
    "PolicyRunner",
    "PolicyState",
    "clip_action",
    "clip_command",
    "default_contract",
    "joint_gains",
    "load_policy",
    "targets",
    "verify_contract",
]
