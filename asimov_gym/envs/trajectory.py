"""`Asimov-Trajectory-v0`: follow a reference motion with direct joint targets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, TypedDict, Unpack

import gymnasium as gym

from asimov_gym.envs.batch import check_flag
from asimov_gym.envs.env import RobotEnv
from asimov_gym.envs.trajectory_batch import TrajectoryBatch
from asimov_gym.envs.vector_env import RobotVectorEnv, check_c_physics, check_copies, check_engine
from asimov_gym.physics import PhysicsProfile
from asimov_gym.presets import from_mapping
from asimov_gym.tasks.trajectory import TrajectoryConfig


class TrajectoryArguments(TypedDict, total=False):
    """Constructor arguments of the trajectory environments; explained at `TrajectoryEnv`."""

    motion: str | None
    gains: bool | None
    ankle: str | None
    episode_s: float | None
    config: TrajectoryConfig | Mapping[str, Any] | None
    profile: str | PhysicsProfile
    threads: int | None
    physics: str


class TrajectoryEnv(RobotEnv):
    """Follow a reference motion, such as a squat, by commanding every joint at 50 Hz, and stay up.

    This is the robot's MOVE/TRAJECTORY mode as a learning task: no network below, each action is an instantaneous
    target of the drives' position loops. Sending `observation["reference"][1]` back as the action follows the motion
    open loop.

    ## Action
    `Box(low, high, (25,), float32)`: target angles in rad in the order of the robot's interface
    (`asimov_gym.robot.joints.MOTOR_NAMES`); `low` and `high` are the motors' ranges. With `gains=True` the box is
    (75,): targets, then position gains in 0...500, then damping gains in 0...5.

    | entries | motors |
    |---|---|
    | 0-5, 6-11 | left, right leg: hip pitch, roll, yaw, knee, ankle A, ankle B |
    | 12-16, 17-21 | left, right arm: shoulder pitch, roll, yaw, elbow, wrist yaw |
    | 22, 23, 24 | waist yaw, neck pitch, neck yaw |

    The ankle entries 4, 5, 10, 11 are the linkage's motors A and B, in targets and gains (`asimov_gym.robot.ankle`).
    Targets beyond a joint's range and gains beyond theirs are clipped and counted in `info["clipped"]`; a wrong shape
    or an entry that is not finite raises ValueError. Without gains the robot's own hold.

    ## Observation
    A Dict: the fixed-shape numeric fields of the robot's telemetry message under their names, and the goal. All bounds
    are finite; values are clipped to them. Motor entries are in the action's order.

    | key | space | meaning |
    |---|---|---|
    | `joint_pos`, `joint_vel` | Box (25,) | motor angles, rad, and speeds, rad/s |
    | `joint_current`, `joint_temp` | Box (25,) | motor currents, A, and temperatures, degrees Celsius |
    | `imu_quat` | Box (4,) | orientation w, x, y, z, body to world |
    | `imu_gyro`, `imu_gravity` | Box (3,) | angular velocity, rad/s, and direction of gravity, body frame |
    | `fw_mode` | Discrete(3) | 2: MOVE |
    | `error_flags`, `alert_count` | Box (1,), int64 | bit 0 DAMP latched, bit 1 + n critical alert n; active alerts |
    | `reference` | Box (K, 25) | motor angles of the motion `config.ahead` = 0, 1, 5, 10, 25 steps from now, rad |
    | `phase` | Box (2,) | cos and sin of the place in the motion's cycle |

    ## Reward
    The sum over `config.rewards` of weight × term, floored at 0, times 0.02 s. The terms are the functions of
    `asimov_gym.tasks.trajectory.rewards`: tracking of positions and velocities, staying upright and alive, and
    penalties on jumping targets and effort. `info["reward_terms"]` has each one's weighted value per second.

    ## Episode
    It starts in the motion's first pose, a little disturbed, with a random heading and cold motors. It terminates when
    the pelvis tilts beyond 60 degrees or sinks below 0.35 m, or a motor reaches 80 degrees Celsius (or the simulation
    diverges), and is truncated after `config.episode_s` (12 s, three squats).

    `info`: `timestamp_us` and `fw_timestamp_us` (simulated time), `sequence`, `fw_age_ms`, `active_alerts` (pairs of id
    and source), and after a step `reward_terms`, `clipped`, `diverged`.

    Args:
        motion: `squat`, `arm_wiggle`, or a path to a YAML or NPZ file (formats: `asimov_gym.tasks.trajectory.motion`;
            `asimov replay FILE --motion OUT.npz` makes one of a recording); None for the configuration's.
        gains: whether actions carry gains; None for the configuration's (no).
        ankle: form of the ankle linkage, `linear` or `exact`; None for the configuration's (linear).
        episode_s: length of an episode in s; None for the configuration's.
        config: a `TrajectoryConfig`, or a mapping with those of its fields that differ from the default; unknown keys
            are refused.
        profile: physics: `evaluation` (full collisions) or `training` (fast: simple contacts of the feet only).
        threads: size of the physics thread pool; None for one for each core, at most one for each copy.
        physics: `c`; with `gym.make_vec` also `mjx` or `warp`, see `vector_env`.
        render_mode, camera, width, height: see `asimov_gym.envs.env.RobotEnv`.

    Raises:
        ValueError: an argument is unknown or out of range; names it and what is allowed.
        FileNotFoundError: `motion` is a file that does not exist.
    """

    def __init__(
        self,
        render_mode: str | None = None,
        camera: str = "third_person",
        width: int = 640,
        height: int = 480,
        **arguments: Unpack[TrajectoryArguments],
    ) -> None:
        super().__init__(_batch(1, **arguments), render_mode, camera, width, height)


class TrajectoryVectorEnv(RobotVectorEnv):
    """`num_envs` copies of `TrajectoryEnv`."""

    def __init__(
        self,
        num_envs: int = 1,
        render_mode: str | None = None,
        camera: str = "third_person",
        width: int = 640,
        height: int = 480,
        **arguments: Unpack[TrajectoryArguments],
    ) -> None:
        super().__init__(_batch(check_copies(num_envs), **arguments), render_mode, camera, width, height)


def vector_env(
    num_envs: int = 1, physics: str = "c", arrays: str = "numpy", **arguments: Any
) -> gym.vector.VectorEnv[Any, Any, Any]:
    """What `gym.make_vec("Asimov-Trajectory-v0", num_envs)` makes: arguments as of `TrajectoryEnv` and
    `asimov_gym.envs.walk.vector_env`. On MJX the profile is `training`, and `info` has no alerts and timestamps but
    `sequence`."""
    if check_engine(physics, arrays, arguments) == "c":
        return TrajectoryVectorEnv(num_envs, **arguments)
    from asimov_gym.envs.functional.trajectory import FunctionalTrajectory
    from asimov_gym.envs.functional.vector_env import FunctionalVectorEnv

    settings = _settings(*(arguments.pop(name, None) for name in ("config", "motion", "gains", "ankle", "episode_s")))
    return FunctionalVectorEnv(FunctionalTrajectory(settings, physics, **arguments), check_copies(num_envs), arrays)


def _batch(
    copies: int,
    *,
    motion: str | None = None,
    gains: bool | None = None,
    ankle: str | None = None,
    episode_s: float | None = None,
    config: TrajectoryConfig | Mapping[str, Any] | None = None,
    profile: str | PhysicsProfile = "evaluation",
    threads: int | None = None,
    physics: str = "c",
) -> TrajectoryBatch:
    check_c_physics(physics)
    return TrajectoryBatch(copies, _settings(config, motion, gains, ankle, episode_s), profile, threads)


def _settings(
    config: TrajectoryConfig | Mapping[str, Any] | None,
    motion: str | None,
    gains: bool | None,
    ankle: str | None,
    episode_s: float | None,
) -> TrajectoryConfig:
    """The configuration that the arguments ask for."""
    settings = (
        config if isinstance(config, TrajectoryConfig) else from_mapping(TrajectoryConfig, config or {}, "config")
    )
    given = {"motion": motion, "ankle": ankle, "episode_s": episode_s}
    if gains is not None:
        given["gains"] = check_flag("gains", gains)
    return replace(settings, **{name: value for name, value in given.items() if value is not None})
