"""What a recording says of its own run: versions, settings, and what it takes to run it again."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import mujoco
import numpy as np
import onnxruntime
import yaml

from asimov_gym import __version__, presets
from asimov_gym.edge import Edge
from asimov_gym.firmware import FirmwareConfig, StepClock
from asimov_gym.policy import Policy, PolicyRunner
from asimov_gym.recording.reader import read_notes

LOCKSTEP, REAL_TIME = "lockstep", "real time"
NO_POLICY = "none"


def edge_notes(edge: Edge) -> dict[str, str]:
    """Notes that the recorder takes of the robot by itself."""
    firmware = edge.firmware
    return {
        "edge_clock": "microseconds since 1970",
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
        **_versions(),
        "time": LOCKSTEP if isinstance(edge.clock, StepClock) else REAL_TIME,
        "robot_age_us": str(edge.clock.now_us()),
        "seed": str(firmware.seed),
        "ankle": firmware.config.ankle,
        "firmware_config": yaml.safe_dump(presets.to_mapping(firmware.config), sort_keys=False),
        **_policy_notes(None if firmware.policy is None else firmware.policy.policy),
    }


def _policy_notes(policy: Policy | None) -> dict[str, str]:
    if policy is None:
        return {"policy": NO_POLICY}
    trained_on = {"policy_trained_on": policy.contract.robot_revision or "unknown"}
    if isinstance(policy, PolicyRunner) and policy.sha256:
        return {"policy": policy.name, "policy_sha256": policy.sha256, **trained_on}
    return {"policy": type(policy).__name__, **trained_on}  # a stand-in that came from no file


def _versions() -> dict[str, str]:
    return {
        "asimov_gym": __version__,
        "mujoco": mujoco.__version__,
        "numpy": np.__version__,
        "onnxruntime": onnxruntime.__version__,
        "python": platform.python_version(),
    }


@dataclass(frozen=True)
class RunSettings:
    """The part of the notes that a second run of the same robot needs. None for what the file does not say."""

    lockstep: bool | None
    seed: int | None
    config: FirmwareConfig | None
    policy: str | None
    """Name of the policy's file; `none` for a robot without one, the type's name for a stand-in without a file."""
    policy_sha256: str | None
    versions: Mapping[str, str]
    """Of the programs that a run depends on, by name."""

    def other_versions(self) -> list[tuple[str, str, str]]:
        """Programs of which another version runs now: name, version then, version now."""
        now = _versions()
        return [(name, was, now[name]) for name, was in self.versions.items() if was != now[name]]


def read_settings(path: str | Path) -> RunSettings:
    """The settings in a recording's notes.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: it is not a recording, or a setting makes no sense to this version; names the entry.
    """
    notes = read_notes(path)
    time, seed, text = notes.get("time"), notes.get("seed"), notes.get("firmware_config")
    try:
        number = None if seed is None else int(seed)
    except ValueError:
        raise ValueError(f"{path}: note `seed` must be a whole number, got {seed!r}") from None
    config = None
    if text is not None:
        try:
            config = presets.from_mapping(FirmwareConfig, yaml.safe_load(text))
        except (ValueError, yaml.YAMLError) as error:
            raise ValueError(f"{path}: note `firmware_config` does not fit this version: {error}") from error
    return RunSettings(
        lockstep=None if time is None else time == LOCKSTEP,
        seed=number,
        config=config,
        policy=notes.get("policy"),
        policy_sha256=notes.get("policy_sha256"),
        versions={name: notes[name] for name in _versions() if name in notes},
    )
