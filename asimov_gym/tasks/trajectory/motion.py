"""Reference motions: joint angles over time, from keyframes in YAML or from samples.

A YAML file has the keys `keyframes`, a list of `{time: seconds, joints: {name: rad}}` that begins at time 0 and ends
in the pose it began with, and optionally `symmetric: true`, by which left joints also set their mirrored right ones.
Joints that a keyframe does not name stand; names may leave out `_joint`. Between keyframes each joint follows the
smoothest polynomial that rests at both ends (minimum jerk), so motions start and stop gently, and they repeat without a
jump.

An NPZ file, as `save_motion` writes it, has the arrays `frames` (T, 25), rad in joint order, and `dt`, s.
"""

from __future__ import annotations

import itertools
import math
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from asimov_gym.assets import asset_path
from asimov_gym.robot.joints import JOINT_NAMES, RANGE, STAND_POSITION, VELOCITY_LIMIT, joint_index
from asimov_gym.robot.mirror import mirror_joints

_KEYS = ("keyframes", "symmetric")
_KEYFRAME_KEYS = ("time", "joints")


class MotionError(ValueError):
    """A motion is malformed or beyond the robot; names the place, the value and what is allowed."""


@dataclass(frozen=True)
class Motion:
    """A repeating motion, sampled at a fixed rate."""

    name: str
    frames: np.ndarray
    """Joint angles in joint order, rad, (T, 25), read-only; after the last frame comes the first."""
    dt: float
    """Time between frames, s."""

    def __post_init__(self) -> None:
        frames = np.array(self.frames, dtype=np.float64)
        if frames.ndim != 2 or frames.shape[1] != len(JOINT_NAMES) or len(frames) < 2:
            raise MotionError(f"{self.name}: frames must have shape (T >= 2, {len(JOINT_NAMES)}), got {frames.shape}")
        for values, low, high, what in (
            (frames, RANGE[:, 0], RANGE[:, 1], "rad"),
            (_velocity(frames, self.dt), -VELOCITY_LIMIT, VELOCITY_LIMIT, "rad/s"),
        ):
            bad = np.argwhere(~((values >= low) & (values <= high)))
            if len(bad):
                frame, joint = (int(i) for i in bad[0])
                raise MotionError(
                    f"{self.name}: {JOINT_NAMES[joint]} at {frame * self.dt:.2f} s must lie in "
                    f"[{low[joint]:g}, {high[joint]:g}] {what}, got {values[frame, joint]:g}"
                )
        frames.setflags(write=False)
        object.__setattr__(self, "frames", frames)

    @property
    def velocities(self) -> np.ndarray:
        """Joint velocities at the frames, rad/s, (T, 25)."""
        return _velocity(self.frames, self.dt)

    @property
    def duration(self) -> float:
        """Length of a cycle, s."""
        return len(self.frames) * self.dt


def load_motion(name: str, dt: float) -> Motion:
    """A shipped motion by name, or one from a YAML or NPZ file.

    Args:
        name: such as `squat`, or a path that ends in `.yaml` or `.npz`.
        dt: time between frames, s.

    Raises:
        FileNotFoundError: there is no such file.
        MotionError: the name is unknown, or the file is not a motion of this robot.
    """
    if name.endswith(".npz"):
        return _load_samples(Path(name), dt)
    if name.endswith((".yaml", ".yml")):
        path = Path(name)
    elif name in motion_names():
        path = asset_path("motions", f"{name}.yaml")
    else:
        raise MotionError(
            f"motion must be one of {', '.join(motion_names())} or a path to a .yaml file or .npz file, got {name!r}"
        )
    try:
        data = yaml.safe_load(path.read_text(encoding="utf-8"))
    except yaml.YAMLError as error:
        raise MotionError(f"{path} is not valid YAML: {error}") from error
    return motion_from_keyframes(str(path) if path.parent != asset_path("motions") else name, data, dt)


def save_motion(path: str | Path, motion: Motion) -> None:
    """Write a motion to an NPZ file, which `load_motion` reads.

    Raises:
        ValueError: the path does not end in `.npz`, by which it is recognised.
    """
    if Path(path).suffix != ".npz":
        raise ValueError(f"a motion's file must end in .npz, got {path}")
    np.savez_compressed(path, frames=motion.frames, dt=motion.dt)


def _load_samples(path: Path, dt: float) -> Motion:
    try:
        with np.load(path, allow_pickle=False) as arrays:
            frames, own_dt = arrays["frames"], float(arrays["dt"])
    except FileNotFoundError:
        raise
    except (OSError, KeyError, ValueError, TypeError, zipfile.BadZipFile) as error:
        raise MotionError(f"{path} is no motion with the arrays frames and dt: {error}") from error
    if abs(own_dt - dt) > 1e-9:
        raise MotionError(f"{path}: dt must be {dt:g} s here, got {own_dt:g}")
    return Motion(str(path), frames, dt)


def motion_names() -> tuple[str, ...]:
    """Names of the shipped motions."""
    return tuple(sorted(path.stem for path in asset_path("motions").glob("*.yaml")))


def motion_from_keyframes(name: str, data: Any, dt: float) -> Motion:
    """A motion from the contents of its file.

    Args:
        name: for messages.
        data: mapping as described at the top of this module.
        dt: time between frames, s.

    Raises:
        MotionError: names the key, its value and what is allowed.
    """
    _check_keys(name, data, _KEYS)
    keyframes = data.get("keyframes")
    if not isinstance(keyframes, list) or len(keyframes) < 2:
        raise MotionError(f"{name}: keyframes must be a list of at least two, got {keyframes!r}")
    symmetric = data.get("symmetric", False)
    if not isinstance(symmetric, bool):
        raise MotionError(f"{name}: symmetric must be true or false, got {symmetric!r}")
    times, poses = [], []
    for i, keyframe in enumerate(keyframes):
        place = f"{name}: keyframes[{i}]"
        _check_keys(place, keyframe, _KEYFRAME_KEYS)
        times.append(_number(f"{place}.time", keyframe.get("time")))
        poses.append(_pose(place, keyframe.get("joints"), symmetric))
    if times[0] != 0.0 or any(later - earlier < dt for earlier, later in itertools.pairwise(times)):
        raise MotionError(f"{name}: keyframe times must begin at 0 and grow by at least {dt:g} s, got {times}")
    if not np.array_equal(poses[0], poses[-1]):
        raise MotionError(f"{name}: the last keyframe must have the pose of the first, since the motion repeats")
    return Motion(name, _interpolate(np.array(times), np.array(poses), dt), dt)


def _interpolate(times: np.ndarray, poses: np.ndarray, dt: float) -> np.ndarray:
    """Frames (T, 25) between keyframes at times (K,) with poses (K, 25)."""
    at = dt * np.arange(round(times[-1] / dt))
    segment = np.clip(np.searchsorted(times, at, side="right") - 1, 0, len(times) - 2)
    u = (at - times[segment]) / (times[segment + 1] - times[segment])
    blend = u**3 * (10.0 - 15.0 * u + 6.0 * u * u)  # Flash and Hogan 1985
    return poses[segment] + blend[:, None] * (poses[segment + 1] - poses[segment])


def _velocity(frames: np.ndarray, dt: float) -> np.ndarray:
    """Central differences over the repeating frames."""
    return (np.roll(frames, -1, axis=0) - np.roll(frames, 1, axis=0)) / (2.0 * dt)


def _pose(place: str, joints: Any, symmetric: bool) -> np.ndarray:
    if not isinstance(joints, Mapping):
        raise MotionError(f"{place}.joints must be a mapping of joint names to rad, got {joints!r}")
    pose = STAND_POSITION.copy()
    for key, value in joints.items():
        try:
            index = joint_index(f"{str(key).removesuffix('_joint')}_joint")
        except ValueError as error:
            raise MotionError(f"{place}.joints: {error}") from None
        if symmetric and not str(key).startswith("left_"):
            raise MotionError(f"{place}.joints: a symmetric motion names left joints only, got {key!r}")
        pose[index] = _number(f"{place}.joints.{key}", value)
    if symmetric:
        mirrored = mirror_joints(pose)
        right = np.array([joint.startswith("right_") for joint in JOINT_NAMES])
        pose = np.where(right, mirrored, pose)
    return pose


def _check_keys(place: str, data: Any, known: tuple[str, ...]) -> None:
    if not isinstance(data, Mapping):
        raise MotionError(f"{place} must be a mapping with the keys {', '.join(known)}, got {data!r}")
    unknown = sorted(set(map(str, data)) - set(known))
    if unknown:
        raise MotionError(f"{place} has unknown keys {unknown}; known keys: {', '.join(known)}")


def _number(place: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise MotionError(f"{place} must be a finite number, got {value!r}")
    return float(value)
