"""`Asimov-Walk-v0`: follow a velocity command."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any, TypedDict, Unpack

import gymnasium as gym
import numpy as np

from asimov_gym.envs.batch import BatchStep, Info, check_flag
from asimov_gym.envs.env import RobotEnv
from asimov_gym.envs.spaces import walk_spaces
from asimov_gym.envs.vector_env import RobotVectorEnv, check_c_physics, check_copies, check_engine
from asimov_gym.envs.walk_batch import WalkBatch
from asimov_gym.physics import PhysicsProfile
from asimov_gym.presets import from_mapping
from asimov_gym.tasks.walk import WalkConfig

_LIMITS = (("vx", 2.0), ("vy", 1.0), ("wz", 2.0))
"""Largest commands that the robot's interface takes."""


NORMALISED_ACTIONS: Mapping[str, float] = MappingProxyType({"action_clip": 1.0, "action_scale": 0.5})
"""What the environments change in the default `WalkConfig`: actions in [-1, 1], which most learners expect, that reach
0.5 rad to either side. The trainer's own policies have an open range (clip 8) in finer units (0.25 rad)."""


class WalkArguments(TypedDict, total=False):
    """Constructor arguments of the walking environments; explained at `WalkEnv`."""

    layout: str | None
    profile: str | PhysicsProfile
    command: Sequence[float] | np.ndarray | None
    config: WalkConfig | Mapping[str, Any] | None
    randomise: bool
    noise: bool
    kicks: bool
    episode_s: float | None
    threads: int | None
    physics: str


class WalkEnvBatch:
    """N walking robots behind the protocol of `asimov_gym.envs.batch`; arguments as of `WalkEnv`."""

    option_names = ("command",)

    def __init__(
        self,
        copies: int,
        *,
        layout: str | None = None,
        profile: str | PhysicsProfile = "training",
        command: Sequence[float] | np.ndarray | None = None,
        config: WalkConfig | Mapping[str, Any] | None = None,
        randomise: bool = False,
        noise: bool = False,
        kicks: bool = False,
        episode_s: float | None = None,
        threads: int | None = None,
        physics: str = "c",
    ) -> None:
        check_c_physics(physics)
        settings = _settings(config, layout, episode_s)
        self._command = None if command is None else check_command("command", command, copies)
        self._batch = WalkBatch(
            settings,
            copies,
            profile,
            threads,
            randomise=check_flag("randomise", randomise),
            noise=check_flag("noise", noise),
            kicks=check_flag("kicks", kicks),
            autoreset=False,
        )
        self.copies = copies
        self.physics = self._batch.physics
        self.observation_space, self.action_space = walk_spaces(self._batch.task)

    def seed(self, seeds: Sequence[int]) -> None:
        self._batch.seed_copies(seeds)

    def restart(self, which: np.ndarray, options: Mapping[str, Any]) -> tuple[np.ndarray, Info]:
        command = self._command
        if options.get("command") is not None:
            command = check_command("options['command']", options["command"], self.copies)
        observation, privileged = self._batch.restart(which, command)
        return observation, {"privileged": privileged, "command": self._batch.state.command.copy()}

    def step(self, action: np.ndarray) -> BatchStep:
        s = self._batch.step(action)
        info = {
            "privileged": s.privileged,
            "command": self._batch.state.command.copy(),
            "reward_terms": {name: np.array(share, dtype=np.float32) for name, share in s.shares.items()},
            "clipped": (np.abs(action) > self._batch.config.action_clip).sum(axis=1),
            "diverged": self.physics.diverged.copy(),
        }
        return BatchStep(s.observation, s.reward, s.terminated, s.truncated, info)

    def markers(self, copy: int) -> np.ndarray:
        return np.empty((0, 3))

    def close(self) -> None:
        self._batch.close()


class WalkEnv(RobotEnv):
    """Follow a velocity command without falling, on flat ground or on `config.terrain`.

    ## Action
    `Box(-c, c, (23,), float32)` with c = `config.action_clip` (1): offsets from the standing pose in units of
    `config.action_scale` (0.5 rad), in policy order (`asimov_gym.robot.joints.POLICY_JOINT_NAMES`: legs, waist, right
    arm, left arm). They are the targets of the drives' position loops for one policy step of 20 ms; the neck is held.
    Finite entries out of bounds are clipped and counted in `info["clipped"]`; a wrong shape or an entry that is not
    finite raises ValueError.

    | entries | joints | target |
    |---|---|---|
    | 0-5, 6-11 | left, right leg: hip pitch, roll, yaw, knee, ankle pitch, roll | standing angle + scale × action, |
    | 12 | waist yaw | kept within the joint's range |
    | 13-17, 18-22 | right, left arm: shoulder pitch, roll, yaw, elbow, wrist yaw | |

    ## Observation
    `Box(-b, b, (80,), float32)`, what the robot's telemetry carries, scaled; b is finite and the values are clipped to
    it. Joints come in three groups by their age on the motor bus (`asimov_gym.robot.observation.CAN_GROUPS`).

    | entries | quantity | scale |
    |---|---|---|
    | 0-2 | angular velocity, body frame, rad/s | 0.25 |
    | 3-5 | direction of gravity, body frame | 1 |
    | 6-8 | command: vx, vy (m/s), yaw rate (rad/s) | 1 |
    | 9-17, 18-25, 26-31 | joint positions less standing pose, rad, groups of 9, 8, 6 | 1 |
    | 32-40, 41-48, 49-54 | joint velocities, rad/s, the same groups | 0.1 |
    | 55-77 | the last action after clipping, policy order | 1 |
    | 78-79 | gait clock: cos and sin of the left foot's phase, (0, 0) while asked to stand | 1 |

    Layout `asimov-78` is the same without the clock.

    ## Reward
    The sum over `config.rewards` of weight × term, penalties included, floored at 0, times 0.02 s. The terms are the
    functions of `asimov_gym.tasks.walk.rewards`: tracking of the commanded velocity and yaw rate (at once and on
    average), staying up, foot height and contact by the gait clock, and penalties on tilt, strange poses, jerky
    actions, slipping, effort and joint limits. `info["reward_terms"]` has each one's weighted value per second.

    ## Episode
    It starts in a disturbed standing pose with a random heading, on terrain also at a random place. It terminates when
    the pelvis tilts beyond 60 degrees or sinks below 0.35 m over the ground (or the simulation diverges), and is
    truncated after `config.episode_s` (20 s).

    `info`: `privileged` (observation for a critic, (96,) float32: the clean observation with clock, pelvis velocity and
    height, feet, contact forces, body figures), `command` (3,), and after a step `reward_terms`, `clipped`, `diverged`.
    `reset(options={"command": (vx, vy, wz)})` keeps that command for the episode.

    Args:
        layout: `asimov-80` or `asimov-78`; None for the configuration's.
        profile: physics: `training` (fast: simple contacts of the feet only) or `evaluation` (full collisions).
        command: a velocity command for all episodes, vx in ±2 m/s, vy in ±1 m/s, yaw rate in ±2 rad/s. None: commands
            are drawn at random, anew every few seconds, as `config.command` says.
        config: a `WalkConfig`, taken as it is; or a mapping with those of its fields that differ from the
            environment's default, which is `WalkConfig()` with the normalised actions above; unknown keys are refused.
            To drive a policy file, give `action_scale` and `action_clip` the values of its contract.
        randomise: give each episode another body (friction, gains, mass) and action delay. Off: nominal figures.
        noise: add sensor noise to the observation. Off by default.
        kicks: kick the pelvis every few seconds. Off by default.
        episode_s: length of an episode in s; None for the configuration's.
        threads: size of the physics thread pool; None for one for each core, at most one for each copy.
        physics: `c`; with `gym.make_vec` also `mjx` or `warp`, see `vector_env`.
        render_mode, camera, width, height: see `asimov_gym.envs.env.RobotEnv`.

    Raises:
        ValueError: an argument is unknown or out of range; names it and what is allowed.
    """

    def __init__(
        self,
        render_mode: str | None = None,
        camera: str = "third_person",
        width: int = 640,
        height: int = 480,
        **arguments: Unpack[WalkArguments],
    ) -> None:
        super().__init__(WalkEnvBatch(1, **arguments), render_mode, camera, width, height)


class WalkVectorEnv(RobotVectorEnv):
    """`num_envs` copies of `WalkEnv`; `command` may also be (num_envs, 3)."""

    def __init__(
        self,
        num_envs: int = 1,
        render_mode: str | None = None,
        camera: str = "third_person",
        width: int = 640,
        height: int = 480,
        **arguments: Unpack[WalkArguments],
    ) -> None:
        super().__init__(WalkEnvBatch(check_copies(num_envs), **arguments), render_mode, camera, width, height)


def vector_env(
    num_envs: int = 1, physics: str = "c", arrays: str = "numpy", **arguments: Any
) -> gym.vector.VectorEnv[Any, Any, Any]:
    """What `gym.make_vec("Asimov-Walk-v0", num_envs)` makes.

    Args:
        num_envs: number of copies.
        physics: `c` (C MuJoCo on a thread pool), `mjx` (MJX on its jax backend: CPU, GPU or TPU) or `warp` (MJX on its
            warp backend, NVIDIA). The last two need `pip install 'asimov-gym[mjx]'`, run the profile `training` only,
            and do not render.
        arrays: `numpy`, or with `mjx` and `warp` also `device`: JAX arrays where they are, also in `info`.
        arguments: as of `WalkEnv`.

    Raises:
        ValueError: an argument is unknown or out of range; names it and what is allowed.
        ModuleNotFoundError: what the engine needs is not installed.
    """
    if check_engine(physics, arrays, arguments) == "c":
        return WalkVectorEnv(num_envs, **arguments)
    from asimov_gym.envs.functional.vector_env import FunctionalVectorEnv
    from asimov_gym.envs.functional.walk import FunctionalWalk

    copies = check_copies(num_envs)
    settings = _settings(*(arguments.pop(name, None) for name in ("config", "layout", "episode_s")))
    command = arguments.pop("command", None)
    flags = {name: check_flag(name, arguments.pop(name, False)) for name in ("randomise", "noise", "kicks")}
    command = None if command is None else check_command("command", command, copies)
    env = FunctionalWalk(settings, physics, command=command, **flags, **arguments)
    checks = {"command": lambda value: check_command("options['command']", value, copies)}
    return FunctionalVectorEnv(env, copies, arrays, checks)


def _settings(config: WalkConfig | Mapping[str, Any] | None, layout: str | None, episode_s: float | None) -> WalkConfig:
    """The configuration that the arguments ask for."""
    settings = config if isinstance(config, WalkConfig) else _overridden(config)
    given = {"layout": layout, "episode_s": episode_s}
    return replace(settings, **{name: value for name, value in given.items() if value is not None})


def _overridden(config: Mapping[str, Any] | None) -> WalkConfig:
    """The environments' default configuration with overrides.

    Raises:
        ValueError: `config` is not a mapping, has an unknown key or a wrong value.
    """
    if config is not None and not isinstance(config, Mapping):
        raise ValueError(f"config must be a WalkConfig, a mapping of overrides or None, got {config!r}")
    return from_mapping(WalkConfig, {**NORMALISED_ACTIONS, **(config or {})}, "config")


def check_command(name: str, command: Any, copies: int) -> np.ndarray:
    """Velocity commands as float32 (copies, 3).

    Raises:
        ValueError: a wrong shape, or an entry out of the interface's range; names the entry.
    """
    array = np.asarray(command, dtype=np.float32)
    if array.shape not in ((3,), (copies, 3)):
        raise ValueError(f"{name} must be (vx, vy, wz) or have shape {(copies, 3)}, got shape {array.shape}")
    array = np.broadcast_to(array, (copies, 3)).copy()
    for axis, (label, limit) in enumerate(_LIMITS):
        bad = ~(np.abs(array[:, axis]) <= limit)
        if bad.any():
            raise ValueError(f"{name} {label} must lie in [{-limit:g}, {limit:g}], got {array[bad, axis][0]}")
    return array
