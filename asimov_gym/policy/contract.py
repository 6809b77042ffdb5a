"""What a policy was trained to be: everything a controller must agree on before it lets the network move the robot.

A policy file carries its contract as metadata, one JSON string per field at full precision. Environment, evaluation and
firmware read it and share the functions here that turn a network output into joint targets, so that they cannot differ.
Vectors per joint are in policy order (`asimov_gym.robot.joints.POLICY_JOINT_NAMES`).
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any

import numpy as np

from asimov_gym.policy.field_checks import ContractError, json_value, number, numbers, pairs, strings, whole
from asimov_gym.robot.array_library import namespace
from asimov_gym.robot.joints import KD, KP, POLICY_JOINT_NAMES, POLICY_TO_JOINT, RANGE, STAND_POSITION
from asimov_gym.robot.observation import POLICY_RATE_HZ, STANDING_THRESHOLD, ObservationLayout, observation_layout

SCHEMA_VERSION = 1
DEFAULT_REVISION = "shifted/rigid"
_COMMAND_AXES = ("vx", "vy", "wz")


@dataclass(frozen=True)
class ObservationTerm:
    """A block of the network's input."""

    name: str
    size: int
    scale: float
    """The raw quantity was multiplied by this."""
    joints: tuple[str, ...] = ()
    """Joint of each entry, for joint terms."""


@dataclass(frozen=True)
class ObservationSchema:
    """The network's input vector as the policy's file states it: a layout's name and its terms in order."""

    layout: str
    terms: tuple[ObservationTerm, ...]

    @classmethod
    def of(cls, layout: ObservationLayout) -> ObservationSchema:
        """Schema of one of the robot's layouts."""
        return cls(layout.name, tuple(ObservationTerm(t.name, t.size, t.scale, t.joints) for t in layout.terms))

    @property
    def width(self) -> int:
        """Length of the vector."""
        return sum(term.size for term in self.terms)

    @property
    def has_clock(self) -> bool:
        return any(term.name == "clock" for term in self.terms)


@dataclass(frozen=True)
class PolicyContract:
    """The terms on which a network may drive the robot. Sequences become tuples and numbers floats on construction.

    Raises:
        ContractError: a field has the wrong type, length or order, or is not finite. Whether this robot can honour a
            well-formed contract is for `asimov_gym.policy.verification` to say.
    """

    observation: ObservationSchema
    joint_names: tuple[str, ...]
    """Joint that each action drives, in the order of the actions; n of them."""
    default_joint_pos: tuple[float, ...]
    """Target of a zero action and origin of the observed joint positions, rad, (n,)."""
    action_scale: tuple[float, ...]
    """rad per unit of action, (n,)."""
    action_clip: float | None
    """Network outputs are clipped to plus and minus this; None: they are not clipped."""
    target_limits: tuple[tuple[float, float], ...]
    """Joint targets are clipped to these, rad, (n, 2)."""
    joint_stiffness: tuple[float, ...]
    """Position gains, N·m/rad at the joint, (n,)."""
    joint_damping: tuple[float, ...]
    """Damping gains, N·m·s/rad at the joint, (n,)."""
    policy_rate_hz: float
    sim_dt: float
    """Physics step of the training, s."""
    decimation: int
    """Physics steps per action in training."""
    gait_frequency_hz: float | None
    """Rate of the gait clock; None for layouts without one."""
    standing_threshold: float
    """A command whose norm is below this asks to stand."""
    command_ranges: tuple[tuple[float, float], ...]
    """Trained range of vx, vy (m/s) and yaw rate (rad/s), (3, 2). Zero lies within each: it means stand still."""
    robot_revision: str | None = DEFAULT_REVISION
    """Leg frames and foot of the model, such as `shifted/rigid`; None where the file does not say."""
    model_sha256: str | None = None
    """Hash of the model's figures; None where the file does not say."""
    trained_commit: str | None = None
    training: Mapping[str, Any] | None = field(default=None, hash=False)
    """A note on the training for readers, such as preset and samples; nothing depends on it."""
    schema_version: int = SCHEMA_VERSION

    def __post_init__(self) -> None:
        if self.schema_version != SCHEMA_VERSION:
            raise ContractError("schema_version", self.schema_version, f"{SCHEMA_VERSION}")
        if not self.observation.terms:
            raise ContractError("observation", self.observation, "at least one term")
        names = strings("joint_names", self.joint_names)
        if not names or len(set(names)) != len(names):
            raise ContractError("joint_names", names, "at least one name, none twice")
        n = len(names)
        limits = pairs("target_limits", self.target_limits, n)
        default = numbers("default_joint_pos", self.default_joint_pos, n)
        for i, (angle, (low, high)) in enumerate(zip(default, limits, strict=True)):
            if not low <= angle <= high:
                raise ContractError(f"default_joint_pos[{i}]", angle, f"within target_limits[{i}], [{low!r}, {high!r}]")
        clip = self.action_clip
        normalised = {
            "joint_names": names,
            "default_joint_pos": default,
            "action_scale": numbers("action_scale", self.action_scale, n, above=0.0),
            "action_clip": None if clip is None else number("action_clip", clip, above=0.0),
            "target_limits": limits,
            "joint_stiffness": numbers("joint_stiffness", self.joint_stiffness, n, low=0.0),
            "joint_damping": numbers("joint_damping", self.joint_damping, n, low=0.0),
            "policy_rate_hz": number("policy_rate_hz", self.policy_rate_hz, above=0.0),
            "sim_dt": number("sim_dt", self.sim_dt, above=0.0),
            "decimation": whole("decimation", self.decimation),
            "standing_threshold": number("standing_threshold", self.standing_threshold, low=0.0),
            "command_ranges": pairs("command_ranges", self.command_ranges, len(_COMMAND_AXES)),
        }
        for name, value in normalised.items():
            object.__setattr__(self, name, value)
        self._check_rates()
        for axis, (low, high) in zip(_COMMAND_AXES, self.command_ranges, strict=True):
            if not low <= 0.0 <= high:  # else clamping would turn "stand still" into a walk
                raise ContractError(f"command_ranges.{axis}", [low, high], "a range that contains 0")
        for name in ("robot_revision", "model_sha256", "trained_commit"):
            if not isinstance(getattr(self, name), str | None):
                raise ContractError(name, getattr(self, name), "a string or null")
        if not isinstance(self.training, Mapping | None):
            raise ContractError("training", self.training, "an object or null")

    def _check_rates(self) -> None:
        period = self.sim_dt * self.decimation
        if not math.isclose(period * self.policy_rate_hz, 1.0, rel_tol=1e-6):
            raise ContractError(
                "policy_rate_hz", self.policy_rate_hz, f"1 / (sim_dt × decimation) = {1.0 / period:g}, as they also say"
            )
        if not self.observation.has_clock:
            if self.gait_frequency_hz is not None:
                raise ContractError("gait_frequency_hz", self.gait_frequency_hz, "null, as no clock is observed")
            return
        frequency = number("gait_frequency_hz", self.gait_frequency_hz, above=0.0)
        if frequency >= self.policy_rate_hz / 2:
            raise ContractError(
                "gait_frequency_hz", frequency, f"below half the policy rate, {self.policy_rate_hz / 2:g}"
            )
        object.__setattr__(self, "gait_frequency_hz", frequency)

    @cached_property
    def _default_scale_limits(self) -> np.ndarray:
        """Rows of default position, scale, lower and upper limit as one array, (4, n): made once, used at 50 Hz."""
        return np.array([self.default_joint_pos, self.action_scale, *zip(*self.target_limits, strict=True)])

    @cached_property
    def _command_limits(self) -> np.ndarray:
        """Rows of lower and upper bounds of the command, (2, 3)."""
        return np.array(self.command_ranges).T

    def to_metadata(self) -> dict[str, str]:
        """The contract as metadata of a policy file: JSON by field name, numbers at full precision."""
        values = {entry.name: getattr(self, entry.name) for entry in fields(self)}
        terms = [
            {"name": t.name, "size": t.size, "scale": t.scale, "joints": list(t.joints)} for t in self.observation.terms
        ]
        values["observation"] = {"layout": self.observation.layout, "terms": terms}
        values["command_ranges"] = dict(zip(_COMMAND_AXES, self.command_ranges, strict=True))
        values["training"] = None if self.training is None else dict(self.training)
        return {name: json.dumps(value, allow_nan=False) for name, value in values.items()}

    @classmethod
    def from_metadata(cls, metadata: Mapping[str, str]) -> PolicyContract:
        """The contract in a file's metadata; other keys are ignored.

        Raises:
            ContractError: a key is missing or not JSON, or its value is not allowed.
        """
        version = json_value(metadata, "schema_version")
        if version != SCHEMA_VERSION:
            raise ContractError("schema_version", version, f"{SCHEMA_VERSION}, the version this program reads")
        optional = {"training": "null"}
        values = {f.name: json_value(metadata, f.name, optional.get(f.name)) for f in fields(cls)}
        values["observation"] = _observation(values["observation"])
        ranges = values["command_ranges"]
        if not isinstance(ranges, dict) or set(ranges) != set(_COMMAND_AXES):
            raise ContractError("command_ranges", ranges, "an object with the keys vx, vy and wz")
        values["command_ranges"] = [ranges[axis] for axis in _COMMAND_AXES]
        return cls(**values)


def clip_action(contract: PolicyContract, action: Any) -> Any:
    """Network output within its bounds, (..., n)."""
    if contract.action_clip is None:
        return action
    return namespace(action).clip(action, -contract.action_clip, contract.action_clip)


def targets(contract: PolicyContract, action: Any) -> Any:
    """Joint targets of a network output, rad, policy order, (..., n): clip, scale, offset, limits.

    Works on arrays of any array-API library; the result has the dtype of `action`.
    """
    xp = namespace(action)
    rows = xp.asarray(contract._default_scale_limits, dtype=action.dtype)
    return xp.clip(rows[0, ...] + rows[1, ...] * clip_action(contract, action), rows[2, ...], rows[3, ...])


def clip_command(contract: PolicyContract, command: Any) -> Any:
    """Velocity command (..., 3) within the range the policy was trained for."""
    xp = namespace(command)
    limits = xp.asarray(contract._command_limits, dtype=command.dtype)
    return xp.clip(command, limits[0, ...], limits[1, ...])


def default_contract(
    layout: str = "asimov-80",
    *,
    action_scale: float = 0.25,
    action_clip: float | None = 8.0,
    gait_frequency_hz: float = 1.5,
    standing_threshold: float = STANDING_THRESHOLD,
    command_ranges: Sequence[tuple[float, float]] = ((-0.6, 0.8), (-0.4, 0.4), (-0.8, 0.8)),
    robot_revision: str = DEFAULT_REVISION,
    model_sha256: str | None = None,
    trained_commit: str | None = None,
    training: Mapping[str, Any] | None = None,
) -> PolicyContract:
    """The contract of a policy trained on the walking task of this project: the robot's own pose, gains and limits.

    Args:
        layout: name of the observation layout.
        action_scale: rad per unit of action, for all joints.
        action_clip: bound of the network's outputs.
        gait_frequency_hz: rate of the gait clock; left out of the contract where the layout has no clock.
        standing_threshold: norm of the command below which the robot is to stand.
        command_ranges: trained ranges of vx, vy (m/s) and yaw rate (rad/s).
        robot_revision: leg frames and foot of the trained model.
        model_sha256: hash of the trained model; None for that of the present model of this revision.
        trained_commit: version of the code that trained it.
        training: a note for readers.

    Raises:
        ValueError: the layout or the revision is unknown.
        ContractError: a value is out of range.
    """
    known = observation_layout(layout)
    if model_sha256 is None:
        from asimov_gym.robot import model  # here, since it brings MuJoCo, which running a policy does not need

        revision = model.Revision.parse(robot_revision)
        model_sha256 = model.model_sha256(revision.leg_frames, revision.foot)
    n = len(POLICY_JOINT_NAMES)
    return PolicyContract(
        observation=ObservationSchema.of(known),
        joint_names=POLICY_JOINT_NAMES,
        default_joint_pos=tuple(STAND_POSITION[POLICY_TO_JOINT]),
        action_scale=(action_scale,) * n,
        action_clip=action_clip,
        target_limits=tuple((low, high) for low, high in RANGE[POLICY_TO_JOINT]),
        joint_stiffness=tuple(KP[POLICY_TO_JOINT]),
        joint_damping=tuple(KD[POLICY_TO_JOINT]),
        policy_rate_hz=POLICY_RATE_HZ,
        sim_dt=0.005,
        decimation=4,
        gait_frequency_hz=gait_frequency_hz if known.has_clock else None,
        standing_threshold=standing_threshold,
        command_ranges=tuple(command_ranges),
        robot_revision=robot_revision,
        model_sha256=model_sha256,
        trained_commit=trained_commit,
        training=training,
    )


def joint_gains(contract: PolicyContract) -> tuple[np.ndarray, np.ndarray]:
    """Position and damping gains of all joints under a policy, joint order, (25,) each; the neck keeps the robot's."""
    kp, kd = KP.copy(), KD.copy()
    kp[POLICY_TO_JOINT], kd[POLICY_TO_JOINT] = contract.joint_stiffness, contract.joint_damping
    return kp, kd


def _observation(value: Any) -> ObservationSchema:
    """The schema in the metadata's `observation`."""
    if not isinstance(value, dict) or set(value) != {"layout", "terms"} or not isinstance(value["layout"], str):
        raise ContractError("observation", value, "an object with `layout` (a string) and `terms` (a list)")
    if not isinstance(value["terms"], list):
        raise ContractError("observation.terms", value["terms"], "a list of objects")
    terms = tuple(_term(f"observation.terms[{i}]", term) for i, term in enumerate(value["terms"]))
    return ObservationSchema(value["layout"], terms)


def _term(place: str, term: Any) -> ObservationTerm:
    keys = {"name", "size", "scale", "joints"}
    if not isinstance(term, dict) or set(term) != keys or not isinstance(term["name"], str):
        raise ContractError(place, term, "an object with name (a string), size, scale and joints")
    return ObservationTerm(
        term["name"],
        whole(f"{place}.size", term["size"]),
        number(f"{place}.scale", term["scale"]),
        strings(f"{place}.joints", term["joints"]),
    )
