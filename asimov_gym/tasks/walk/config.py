"""Settings of the walking task. Every field is checked on construction; a preset is YAML of the same shape."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from asimov_gym.presets import check_interval, check_range, check_weights
from asimov_gym.robot.joints import BODY_NAMES
from asimov_gym.robot.observation import LAYOUTS, STANDING_THRESHOLD
from asimov_gym.robot.terrain import terrain_named


@dataclass(frozen=True)
class CommandConfig:
    """Velocity commands: how they are drawn, and how often."""

    vx: tuple[float, float] = (-0.6, 0.8)
    """Forward, m/s."""
    vy: tuple[float, float] = (-0.4, 0.4)
    """Left, m/s."""
    wz: tuple[float, float] = (-0.8, 0.8)
    """Turning, rad/s."""
    standing_share: float = 0.15
    """Share of draws that ask to stand."""
    single_axis_share: float = 0.3
    """Share of draws with only one of the three velocities."""
    corner_share: float = 0.0
    """Share of draws of which each velocity is the least, none or the largest of its range, with the same chance."""
    interval_s: tuple[float, float] = (3.0, 7.0)
    """Time until the next draw."""

    def __post_init__(self) -> None:
        check_interval("command.vx", self.vx, -2.0, 2.0)
        check_interval("command.vy", self.vy, -1.0, 1.0)
        check_interval("command.wz", self.wz, -2.0, 2.0)
        check_range("command.standing_share", self.standing_share, 0.0, 1.0)
        check_range("command.single_axis_share", self.single_axis_share, 0.0, 1.0 - self.standing_share)
        rest = 1.0 - self.standing_share - self.single_axis_share
        check_range("command.corner_share", self.corner_share, 0.0, round(rest, 9))
        check_interval("command.interval_s", self.interval_s, 0.02, 1e6)


@dataclass(frozen=True)
class NoiseConfig:
    """Half-widths of uniform sensor noise, drawn anew every step, and the encoder zero, drawn at reset."""

    gyro: float = 0.05
    """rad/s."""
    gravity: float = 0.03
    joint_position: float = 0.01
    """rad."""
    joint_velocity: float = 0.5
    """rad/s."""
    joint_zero: float = 0.01
    """Encoder offset, rad."""
    can_slot_delay: bool = False
    """Joint readings are as old as their turn on the motor bus makes them: see `asimov_gym.tasks.walk.bus_age`."""

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if name == "can_slot_delay":
                if not isinstance(value, bool):
                    raise ValueError(f"noise.can_slot_delay must be true or false, got {value!r}")
            else:
                check_range(f"noise.{name}", value, 0.0, 10.0)


@dataclass(frozen=True)
class RandomisationConfig:
    """What differs from copy to copy, drawn at reset."""

    foot_friction: tuple[float, float] = (0.4, 1.2)
    kp_scale: tuple[float, float] = (0.85, 1.15)
    kd_scale: tuple[float, float] = (0.85, 1.15)
    torso_mass: tuple[float, float] = (-0.5, 2.0)
    """kg added to the torso."""
    torso_com_x: tuple[float, float] = (-0.02, 0.04)
    """Shift of the torso's centre of mass, m."""
    torso_com_z: tuple[float, float] = (-0.02, 0.05)
    action_delay_ms: tuple[float, float] = (0.0, 25.0)
    """Delay of targets; counted in whole physics steps of 5 ms."""
    redraw_share: float = 0.25
    """Share of resets that draw new body figures (the others keep theirs): writing figures costs time."""

    def __post_init__(self) -> None:
        check_interval("randomisation.foot_friction", self.foot_friction, 0.01, 3.0)
        check_interval("randomisation.kp_scale", self.kp_scale, 0.1, 3.0)
        check_interval("randomisation.kd_scale", self.kd_scale, 0.1, 3.0)
        check_interval("randomisation.torso_mass", self.torso_mass, -5.0, 15.0)
        check_interval("randomisation.torso_com_x", self.torso_com_x, -0.2, 0.2)
        check_interval("randomisation.torso_com_z", self.torso_com_z, -0.2, 0.2)
        check_interval("randomisation.action_delay_ms", self.action_delay_ms, 0.0, 40.0)
        check_range("randomisation.redraw_share", self.redraw_share, 0.0, 1.0)


@dataclass(frozen=True)
class KickConfig:
    """Sudden changes of the pelvis velocity in a random direction, which teach recovery from pushes."""

    interval_s: tuple[float, float] = (2.0, 6.0)
    speed: tuple[float, float] = (0.5, 1.2)
    """Largest horizontal change, m/s: at the start and at the end of the curriculum."""
    vertical: float = 0.2
    """Largest vertical change, m/s."""
    tilt_rate: float = 0.5
    """Largest change of roll and pitch rate, rad/s."""
    turn_rate: float = 0.6
    """Largest change of yaw rate, rad/s."""

    def __post_init__(self) -> None:
        check_interval("kick.interval_s", self.interval_s, 0.02, 1e6)
        check_interval("kick.speed", self.speed, 0.0, 5.0)
        for name in ("vertical", "tilt_rate", "turn_rate"):
            check_range(f"kick.{name}", getattr(self, name), 0.0, 5.0)


@dataclass(frozen=True)
class ShoveConfig:
    """Forces on single bodies for a short time; none by default. See `asimov_gym.tasks.walk.shove`."""

    interval_s: tuple[float, float] = (3.0, 8.0)
    """Time from the end of one to the start of the next, while the robot is asked to walk."""
    pace_at_rest: int = 1
    """How many times as fast that time passes while it is asked to stand."""
    duration_s: tuple[float, float] = (0.1, 0.2)
    horizontal: Mapping[str, float] = field(default_factory=dict)
    """Largest force by body, in any horizontal direction, N: at the end of the curriculum."""
    downward: Mapping[str, float] = field(default_factory=dict)
    """Largest force by body, downwards, N."""
    first: float = 0.4
    """Share of these forces at the start of the curriculum; it grows with the level of the kicks."""
    mildest: float = 0.3
    """The weakest shove, as a share of the strongest of its time; forces are drawn evenly between the two."""

    def __post_init__(self) -> None:
        check_interval("shove.interval_s", self.interval_s, 0.02, 1e6)
        check_interval("shove.duration_s", self.duration_s, 0.02, 5.0)
        check_range("shove.pace_at_rest", self.pace_at_rest, 1, 100)
        check_range("shove.first", self.first, 0.0, 1.0)
        check_range("shove.mildest", self.mildest, 0.0, 1.0)
        for name in ("horizontal", "downward"):
            for body, force in getattr(self, name).items():
                if body not in BODY_NAMES:
                    raise ValueError(f"shove.{name} names the unknown body {body!r}; known: {', '.join(BODY_NAMES)}")
                check_range(f"shove.{name}.{body}", force, 0.0, 5000.0)

    @property
    def bodies(self) -> tuple[str, ...]:
        """Bodies that are shoved."""
        return tuple(dict.fromkeys((*self.horizontal, *self.downward)))


@dataclass(frozen=True)
class CurriculumConfig:
    """Penalties, kicks and shoves start small and grow while episodes last."""

    start: float = 0.1
    """First level of the penalties; the last is 1."""
    long_episode_steps: float = 500.0
    """Mean episode length, in policy steps, above which the levels grow."""
    penalty_growth: float = 0.002
    """Growth of the penalty level per call, relative."""
    kick_growth: float = 0.0005
    """Growth of the level of kicks and shoves per call; it runs from 0 to 1."""

    def __post_init__(self) -> None:
        check_range("curriculum.start", self.start, 0.0, 1.0)
        check_range("curriculum.long_episode_steps", self.long_episode_steps, 0.0, 1e6)
        check_range("curriculum.penalty_growth", self.penalty_growth, 0.0, 1.0)
        check_range("curriculum.kick_growth", self.kick_growth, 0.0, 1.0)


DEFAULT_REWARDS: Mapping[str, float] = {
    "track_velocity": 2.0,
    "track_yaw_rate": 2.0,
    "track_mean_velocity": 1.5,
    "track_mean_yaw_rate": 1.0,
    "alive": 0.5,
    "foot_height": 4.0,
    "foot_contact": 1.0,
    "tilt": -5.0,
    "pose": -0.3,
    "tilt_rate": -0.15,
    "vertical_speed": -0.5,
    "action_rate": -0.015,
    "action_jerk": -0.005,
    "slip": -0.3,
    "flat_foot": -1.0,
    "joint_limit": -2.0,
    "feet_apart": -2.0,
    "rest": -0.5,
    "effort": -0.1,
}
"""Weights per second. Negative terms are penalties, scaled by the curriculum."""


@dataclass(frozen=True)
class WalkConfig:
    """The walking task: follow a velocity command at 50 Hz without falling."""

    layout: str = "asimov-80"
    """Observation layout of the actor."""
    terrain: str = "flat"
    """The ground: a name as `asimov_gym.robot.terrain.terrain_named` takes it, such as `rough:0.03` or `slope:6`."""
    episode_s: float = 20.0
    gait_frequency_hz: float = 1.5
    standing_threshold: float = STANDING_THRESHOLD
    action_scale: float = 0.25
    """rad per unit of action."""
    action_clip: float = 8.0
    """Actions are clipped to plus and minus this."""
    step_height: float = 0.08
    """Peak height of the swinging foot above the ground, m."""
    mean_velocity_s: float = 0.4
    """Time constant of the averaged velocity in the mean tracking terms, s."""
    thrown_speed: float = 100.0
    """A robot that is asked to stand and moves faster than this, m/s, was thrown off: until it is slower it may step,
    and no term for standing counts. By default none ever is."""
    calm_share: float = 0.0
    """Share of the episodes in which nothing disturbs the robot, neither kick nor shove. What such an episode says of
    exact walking is not drowned by what a shove costs: see `train.advantages`."""
    command: CommandConfig = field(default_factory=CommandConfig)
    noise: NoiseConfig = field(default_factory=NoiseConfig)
    randomisation: RandomisationConfig = field(default_factory=RandomisationConfig)
    kick: KickConfig = field(default_factory=KickConfig)
    shove: ShoveConfig = field(default_factory=ShoveConfig)
    curriculum: CurriculumConfig = field(default_factory=CurriculumConfig)
    rewards: Mapping[str, float] = field(default_factory=lambda: dict(DEFAULT_REWARDS))
    """Weight of each reward term; a term without a weight is not computed."""

    def __post_init__(self) -> None:
        if self.layout not in LAYOUTS:
            raise ValueError(f"layout must be one of {', '.join(LAYOUTS)}, got {self.layout!r}")
        terrain_named(self.terrain)
        check_range("episode_s", self.episode_s, 0.02, 1e6)
        check_range("gait_frequency_hz", self.gait_frequency_hz, 0.5, 4.0)
        check_range("standing_threshold", self.standing_threshold, 0.0, 0.5)
        check_range("action_scale", self.action_scale, 0.01, 2.0)
        check_range("action_clip", self.action_clip, 0.1, 100.0)
        check_range("step_height", self.step_height, 0.0, 0.3)
        check_range("mean_velocity_s", self.mean_velocity_s, 0.02, 10.0)
        check_range("calm_share", self.calm_share, 0.0, 1.0)
        check_range("thrown_speed", self.thrown_speed, 0.0, 100.0)
        from asimov_gym.tasks.walk.rewards import TERMS

        check_weights("rewards", self.rewards, TERMS)
