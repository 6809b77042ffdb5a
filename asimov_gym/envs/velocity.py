"""`Asimov-Velocity-v0`: steer the walking robot through waypoints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, TypedDict, Unpack

import gymnasium as gym

from asimov_gym.envs.env import RobotEnv
from asimov_gym.envs.vector_env import RobotVectorEnv, check_c_physics, check_copies, check_engine
from asimov_gym.envs.velocity_batch import Policy, VelocityBatch
from asimov_gym.physics import PhysicsProfile
from asimov_gym.presets import from_mapping
from asimov_gym.tasks.velocity import VelocityConfig

_RATE_HZ = 10


class VelocityArguments(TypedDict, total=False):
    """Constructor arguments of the waypoint environments; explained at `VelocityEnv`."""

    policy: str | Path | Policy | None
    waypoints: int | None
    episode_s: float | None
    config: VelocityConfig | Mapping[str, Any] | None
    profile: str | PhysicsProfile
    threads: int | None
    physics: str


class VelocityEnv(RobotEnv):
    """Steer the robot through waypoints with velocity commands, while a walking policy moves its joints.

    This is the robot's MOVE/POLICY mode as a learning task: an action is a `VelocityCommand`, 10 times a second, and
    the exported network walks by it at 50 Hz.

    ## Action
    `Box([-2, -1, -2], [2, 1, 2], (3,), float32)`: vx forward and vy left in m/s, and the turning rate in rad/s,
    counter-clockwise. Finite entries out of bounds are clipped and counted in `info["clipped"]`; a wrong shape or an
    entry that is not finite raises ValueError. The policy clamps the command once more, to the range that it was
    trained for: `info["applied_command"]`.

    ## Observation
    `Box(-b, b, (61,), float32)` with finite b; values are clipped to it.

    | entries | quantity | scale |
    |---|---|---|
    | 0-2 | angular velocity, body frame, rad/s | 0.25 |
    | 3-5 | direction of gravity, body frame | 1 |
    | 6-30 | joint positions less standing pose, rad, joint order (`asimov_gym.robot.joints.JOINT_NAMES`) | 1 |
    | 31-55 | joint velocities, rad/s, joint order | 0.1 |
    | 56-57 | next waypoint from the pelvis in the heading frame (x forward, y left), m: simulated localisation | 1 |
    | 58-60 | the last command, within the action's bounds | 1 |

    ## Reward
    The sum over `config.rewards` of weight × term, the terms being the functions of
    `asimov_gym.tasks.velocity.rewards`:

    | term | weight | per |
    |---|---|---|
    | `progress` | 1 | metre closer to the next waypoint |
    | `reached` | 2 | waypoint |
    | `fall` | -5 | fall |
    | `time` | -0.01 | step |
    | `command_rate` | -0.02 | squared change of the command, summed over vx, vy, wz |

    ## Episode
    The robot stands at the origin with a random heading. `config.waypoints` (4) points lie ahead, each 1 to 2.5 m from
    the last and up to 1.2 rad to either side; they follow from the seed and are visited in order, each counting as
    reached within 0.25 m of the pelvis. The episode terminates when all are reached (`info["success"]`), or when the
    pelvis tilts beyond 60 degrees or sinks below 0.35 m (or the simulation diverges), and is truncated after
    `config.episode_s` (60 s).

    `info`: `waypoints_reached`, `distance` (to the next one, m), and after a step `applied_command`, `reward_terms`,
    `clipped`, `success`, `diverged`.

    Args:
        policy: the walking network: path to an ONNX file, or a policy from `asimov_gym.policy.load_policy` (but
            Gymnasium can only remake an environment from its `spec` if it was made with a path). None: the shipped one.
        waypoints: how many; None for the configuration's.
        episode_s: length of an episode in s; None for the configuration's.
        config: a `VelocityConfig`, or a mapping with those of its fields that differ from the default; unknown keys are
            refused.
        profile: physics: `evaluation` (full collisions) or `training` (fast: simple contacts of the feet only).
        threads: size of the physics thread pool; None for one for each core, at most one for each copy.
        physics: `c`; with `gym.make_vec` also `mjx` or `warp`, see `vector_env`.
        render_mode, camera, width, height: see `asimov_gym.envs.env.RobotEnv`; waypoints to come are shown as balls.

    Raises:
        FileNotFoundError: the policy file is missing; says how to get one.
        ValueError: an argument is unknown or out of range, or the robot cannot walk by the policy; names it and what is
            allowed.
    """

    metadata: dict[str, Any] = {"render_modes": ["human", "rgb_array"], "render_fps": _RATE_HZ}  # noqa: RUF012

    def __init__(
        self,
        render_mode: str | None = None,
        camera: str = "third_person",
        width: int = 640,
        height: int = 480,
        **arguments: Unpack[VelocityArguments],
    ) -> None:
        super().__init__(_batch(1, **arguments), render_mode, camera, width, height)


class VelocityVectorEnv(RobotVectorEnv):
    """`num_envs` copies of `VelocityEnv`."""

    metadata: dict[str, Any] = RobotVectorEnv.metadata | {"render_fps": _RATE_HZ}

    def __init__(
        self,
        num_envs: int = 1,
        render_mode: str | None = None,
        camera: str = "third_person",
        width: int = 640,
        height: int = 480,
        **arguments: Unpack[VelocityArguments],
    ) -> None:
        super().__init__(_batch(check_copies(num_envs), **arguments), render_mode, camera, width, height)


def vector_env(
    num_envs: int = 1, physics: str = "c", arrays: str = "numpy", **arguments: Any
) -> gym.vector.VectorEnv[Any, Any, Any]:
    """What `gym.make_vec("Asimov-Velocity-v0", num_envs)` makes: arguments as of `VelocityEnv` and
    `asimov_gym.envs.walk.vector_env`. On MJX the profile is `training`, and the policy is a file, whose network becomes
    a part of the compiled step, or an `asimov_gym.envs.functional.velocity.Network`."""
    if check_engine(physics, arrays, arguments) == "c":
        return VelocityVectorEnv(num_envs, **arguments)
    from asimov_gym.envs.functional.vector_env import FunctionalVectorEnv
    from asimov_gym.envs.functional.velocity import FunctionalVelocity

    settings = _settings(*(arguments.pop(name, None) for name in ("config", "waypoints", "episode_s")))
    env = FunctionalVelocity(settings, arguments.pop("policy", None), physics, **arguments)
    return FunctionalVectorEnv(env, check_copies(num_envs), arrays)


def _batch(
    copies: int,
    *,
    policy: str | Path | Policy | None = None,
    waypoints: int | None = None,
    episode_s: float | None = None,
    config: VelocityConfig | Mapping[str, Any] | None = None,
    profile: str | PhysicsProfile = "evaluation",
    threads: int | None = None,
    physics: str = "c",
) -> VelocityBatch:
    check_c_physics(physics)
    return VelocityBatch(copies, _settings(config, waypoints, episode_s), policy, profile, threads)


def _settings(
    config: VelocityConfig | Mapping[str, Any] | None, waypoints: int | None, episode_s: float | None
) -> VelocityConfig:
    """The configuration that the arguments ask for."""
    settings = config if isinstance(config, VelocityConfig) else from_mapping(VelocityConfig, config or {}, "config")
    given = {"waypoints": waypoints, "episode_s": episode_s}
    return replace(settings, **{name: value for name, value in given.items() if value is not None})
