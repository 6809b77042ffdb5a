"""The metadata of policies exported by the robot's maker, read as a `PolicyContract`, and written beside ours.

Their exporter (schema `deploy_metadata_version` 1) names joints, gains, rates and the action's affine map, but neither
scales nor joint order of the observation: those stand in a configuration file beside the network. They are known for
one vector of 78 values, our layout `asimov-78`, whose terms are told by their names. Anything else is refused, since a
wrong guess would scramble the robot's senses.

Two keys mean different things in the two schemas. A file that carries both schemas is read by ours, and holds in
`action_clip` the maker's meaning, limits of the joint *targets* (pairs, null for an open side), and in
`raw_action_clip` the bound of the network's outputs, which our own key `action_clip` otherwise holds.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from asimov_gym.policy.contract import DEFAULT_REVISION, ObservationSchema, PolicyContract
from asimov_gym.policy.field_checks import ContractError, json_value
from asimov_gym.policy.verification import verify_joint_names
from asimov_gym.robot.joints import POLICY_JOINT_NAMES, POLICY_TO_JOINT, RANGE
from asimov_gym.robot.observation import STANDING_THRESHOLD, observation_layout

VERSION_KEY = "deploy_metadata_version"
VERSION = "1"
LAYOUT = "asimov-78"
ROBOT_MODEL = "asimov_1"
"""Name of the robot in the maker's description files of our default revision."""
COMMAND_RANGES = ((-0.6, 0.8), (-0.5, 0.5), (-0.8, 0.8))
"""Ranges of the maker's published training; their metadata has none. vx, vy in m/s, yaw rate in rad/s."""

TERM_NAMES: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "gyro": ("base_ang_vel",),
        "gravity": ("projected_gravity",),
        "command": ("command", "velocity_commands"),
        "joint_position_0": ("joint_pos_slot01",),
        "joint_position_1": ("joint_pos_slot23",),
        "joint_position_2": ("joint_pos_slot45",),
        "joint_velocity_0": ("joint_vel_slot01",),
        "joint_velocity_1": ("joint_vel_slot23",),
        "joint_velocity_2": ("joint_vel_slot45",),
        "action": ("actions", "last_action"),
    }
)
"""Terms of `asimov-78` in order, each with the names it goes by in `observation_names`; the first is the one we write.
Slots are places in a bus's polling order, as in `asimov_gym.robot.observation.CAN_GROUPS`."""

_THEIR_KEYS = {"default_joint_pos": "action_offset", "action_clip": "raw_action_clip", "target_limits": "action_clip"}
"""Their name of a field where it differs from ours, for error messages."""


def is_vendor_metadata(metadata: Mapping[str, str]) -> bool:
    """Whether a file speaks only the maker's schema."""
    return VERSION_KEY in metadata and "schema_version" not in metadata


def contract_from_vendor(metadata: Mapping[str, str]) -> PolicyContract:
    """Contract of a policy exported by the robot's maker.

    What their metadata leaves open is filled in: command ranges from their published training, target limits from the
    robot's joint ranges, which also narrow wider limits of theirs.

    Raises:
        ContractError: a key is missing or malformed, or the observation is not the one known.
    """
    version = metadata[VERSION_KEY]
    if version.strip('"') != VERSION:
        raise ContractError(VERSION_KEY, version, f"{VERSION}, the version this program reads")
    layout = observation_layout(LAYOUT)
    n = len(POLICY_JOINT_NAMES)
    _check_observation(metadata, layout.width)
    width = json_value(metadata, "action_dim")
    if width != n:
        raise ContractError("action_dim", width, f"{n}")
    names = json_value(metadata, "joint_names")
    verify_joint_names(names if isinstance(names, list) else ())
    model = metadata.get("robot_model_name")
    if model not in (None, ROBOT_MODEL):
        raise ContractError("robot_model_name", model, ROBOT_MODEL)
    affine = {key: _per_joint(metadata, key, n) for key in ("action_offset", "action_scale")}
    gains = {key: _per_joint(metadata, key, n) for key in ("joint_stiffness", "joint_damping")}
    rates = {key: json_value(metadata, key) for key in ("policy_rate_hz", "sim_dt", "decimation")}
    clip = json_value(metadata, "raw_action_clip", "null")
    limits = _target_limits(json_value(metadata, "action_clip", "null"))
    try:
        return PolicyContract(
            observation=ObservationSchema.of(layout),
            joint_names=POLICY_JOINT_NAMES,
            default_joint_pos=affine["action_offset"],
            action_scale=affine["action_scale"],
            action_clip=clip,
            target_limits=limits,
            gait_frequency_hz=None,
            **gains,
            **rates,
            standing_threshold=STANDING_THRESHOLD,
            command_ranges=COMMAND_RANGES,
            robot_revision=DEFAULT_REVISION if model == ROBOT_MODEL else None,
            model_sha256=None,
            trained_commit=metadata.get("trained_commit"),
        )
    except ContractError as error:
        own, bracket, index = error.field.partition("[")
        raise ContractError(_THEIR_KEYS.get(own, own) + bracket + index, error.value, error.allowed) from None


def file_metadata(contract: PolicyContract) -> dict[str, str]:
    """Metadata to write into a policy file: ours, and for `asimov-78` also the maker's keys."""
    metadata = contract.to_metadata()
    if contract.observation.layout != LAYOUT:
        return metadata
    theirs: dict[str, Any] = {
        VERSION_KEY: int(VERSION),
        "obs_dim": contract.observation.width,
        "action_dim": len(contract.joint_names),
        "action_offset": contract.default_joint_pos,
        "raw_action_clip": contract.action_clip,
        "action_clip": contract.target_limits,
        "observation_names": [names[0] for names in TERM_NAMES.values()],
        "robot_model_name": ROBOT_MODEL if contract.robot_revision == DEFAULT_REVISION else None,
    }
    return metadata | {
        key: value if isinstance(value, str) else json.dumps(value, allow_nan=False)
        for key, value in theirs.items()
        if value is not None or key == "raw_action_clip"
    }


def own_metadata(metadata: Mapping[str, str]) -> Mapping[str, str]:
    """Our view of a file that carries both schemas: `action_clip` is the bound of the network's outputs again."""
    if VERSION_KEY not in metadata:
        return metadata
    return dict(metadata) | {"action_clip": metadata.get("raw_action_clip", "null")}


def _check_observation(metadata: Mapping[str, str], width: int) -> None:
    stated = json_value(metadata, "obs_dim")
    if stated != width:
        raise ContractError(
            "obs_dim", stated, f"{width}: layout {LAYOUT} is the only observation of theirs whose scales are known"
        )
    names = json_value(metadata, "observation_names")
    known = list(TERM_NAMES.values())
    if not isinstance(names, list) or len(names) != len(known):
        raise ContractError("observation_names", names, f"the {len(known)} terms {[own[0] for own in known]} in order")
    for i, (name, aliases) in enumerate(zip(names, known, strict=True)):
        if name not in aliases:
            raise ContractError(
                f"observation_names[{i}]",
                name,
                f"{' or '.join(aliases)}; scale and joint order of other terms are not in the metadata",
            )


def _per_joint(metadata: Mapping[str, str], key: str, n: int) -> Any:
    value = json_value(metadata, key)
    return [value] * n if isinstance(value, int | float) else value


def _target_limits(clip: Any) -> Any:
    """The maker's limits of the targets within the joints' ranges, (n, 2)."""
    ranges = [(float(low), float(high)) for low, high in RANGE[POLICY_TO_JOINT]]
    if clip is None:
        return ranges
    if not isinstance(clip, list) or len(clip) != len(ranges):
        raise ContractError("action_clip", clip, f"null, or {len(ranges)} pairs [low, high] of joint targets")
    limits = []
    for i, (pair, (low, high)) in enumerate(zip(clip, ranges, strict=True)):
        sides = pair if isinstance(pair, list) else []
        if len(sides) != 2 or not all(side is None or _is_finite(side) for side in sides):
            raise ContractError(f"action_clip[{i}]", pair, "a pair [low, high], null for an open side")
        limits.append(
            (low if sides[0] is None else max(low, sides[0]), high if sides[1] is None else min(high, sides[1]))
        )
    return limits


def _is_finite(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
