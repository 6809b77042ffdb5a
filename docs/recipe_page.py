"""Makes the tables of `recipe.md` from the recipes and presets; the words around them are written by hand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any

from markers import Table, filled

from asimov_gym.assets import asset_path
from asimov_gym.policy import load_policy
from asimov_gym.tasks.walk.rewards import TERMS
from train.config import PpoConfig
from train.recipe import Recipe, load_recipe, recipe_names

PAGE = Path(__file__).resolve().parent / "recipe.md"
SHOWN = "walk"
"""Recipe whose settings are on the page."""
SPEED = (5_000, 10_000)
"""Samples per second that two cores train with, at least (shoves, more passes, a slow machine) and at most."""


@dataclass(frozen=True)
class Row:
    """A setting on the page."""

    path: str
    """Its place in `PpoConfig`."""
    label: str
    between: str = " to "
    """What stands between the numbers of a pair."""


def _reward(name: str) -> Row:
    note = " ".join((TERMS[name].__doc__ or "").split())
    return Row(f"walk.rewards.{name}", f"`{name}`: {note[:1].lower()}{note[1:].rstrip('.')}")


def _rewards(*names: str) -> tuple[Row, ...]:
    return tuple(map(_reward, names))


BLOCKS: Mapping[str, tuple[Row, ...]] = {
    "commands": (
        Row("walk.command.vx", "forward, m/s"),
        Row("walk.command.vy", "left, m/s"),
        Row("walk.command.wz", "turning, rad/s"),
        Row("walk.command.interval_s", "a new command every, s"),
        Row("walk.command.single_axis_share", "share of commands with one velocity only"),
        Row("walk.command.corner_share", "share of commands from the corners of the range"),
        Row("walk.episode_s", "length of an episode, s"),
        Row("walk.terrain", "ground"),
        *_rewards(
            "track_velocity",
            "track_yaw_rate",
            "track_velocity_closely",
            "track_yaw_rate_closely",
            "track_mean_velocity",
            "track_mean_yaw_rate",
            "track_mean_velocity_exactly",
            "track_mean_yaw_rate_exactly",
        ),
        Row("walk.mean_velocity_s", "time constant of that average, s"),
        *_rewards("alive", "tilt", "pose"),
    ),
    "randomisation": (
        Row("walk.randomisation.foot_friction", "foot friction"),
        Row("walk.randomisation.kp_scale", "stiffness, factor"),
        Row("walk.randomisation.kd_scale", "damping, factor"),
        Row("walk.randomisation.torso_mass", "mass added to the torso, kg"),
        Row("walk.randomisation.torso_com_x", "torso's centre of mass forward, m"),
        Row("walk.randomisation.torso_com_z", "torso's centre of mass up, m"),
        Row("walk.randomisation.action_delay_ms", "delay of the joint targets, ms"),
        Row("walk.randomisation.redraw_share", "share of restarts with a new body"),
        Row("walk.noise.joint_zero", "encoder zero, ± rad, with the body"),
        Row("walk.noise.joint_position", "joint position noise, ± rad"),
        Row("walk.noise.joint_velocity", "joint speed noise, ± rad/s"),
        Row("walk.noise.gyro", "gyro noise, ± rad/s"),
        Row("walk.noise.gravity", "noise of the direction of gravity, ±"),
        Row("walk.noise.can_slot_delay", "joint readings as old as the motor bus makes them"),
    ),
    "curriculum": (
        Row("walk.curriculum.start", "penalties begin at this share"),
        Row("walk.curriculum.penalty_growth", "and grow per policy step by"),
        Row("walk.curriculum.kick_growth", "level of kicks and shoves grows per policy step by"),
        Row("walk.curriculum.long_episode_steps", "while episodes last so many policy steps"),
        Row("learner.entropy", "entropy bonus", " → "),
        Row("learner.entropy_samples", "which falls between these samples of the stage"),
    ),
    "symmetry": (Row("learner.symmetry", "left and right are alike by"),),
    "gait": (
        Row("walk.gait_frequency_hz", "steps of each foot per second, Hz"),
        *_rewards("foot_contact"),
        Row("walk.command.standing_share", "share of commands to stand"),
        Row("walk.standing_threshold", "commands below this norm mean to stand"),
        *_rewards("rest", "rest_pose", "rest_stance", "rest_drift"),
    ),
    "feet": (
        Row("walk.step_height", "height of a step, m"),
        *_rewards("foot_height", "flat_foot", "slip", "feet_apart"),
    ),
    "smoothness": (
        *_rewards("action_rate", "action_jerk", "tilt_rate", "vertical_speed"),
        Row("walk.action_scale", "joint target per unit of action, rad"),
        Row("walk.action_clip", "largest action"),
    ),
    "torque": _rewards("effort", "joint_limit", "joint_speed"),
    "pushes": (
        Row("walk.kick.interval_s", "a kick every, s"),
        Row("walk.kick.speed", "largest horizontal change of velocity, m/s", " → "),
        Row("walk.kick.vertical", "vertical, m/s"),
        Row("walk.kick.tilt_rate", "of roll and pitch rate, rad/s"),
        Row("walk.kick.turn_rate", "of yaw rate, rad/s"),
        Row("walk.shove.horizontal", "largest horizontal shove by body, N"),
        Row("walk.shove.downward", "largest downward shove by body, N"),
        Row("walk.shove.first", "share of these forces at the start of the curriculum"),
        Row("walk.shove.mildest", "the weakest shove, as a share of the strongest"),
        Row("walk.shove.duration_s", "a shove lasts, s"),
        Row("walk.shove.interval_s", "from one shove to the next, s"),
        Row("walk.shove.pace_at_rest", "at rest that time passes so many times as fast"),
        Row("walk.calm_share", "share of episodes without a kick or shove; their advantages are scaled by themselves"),
        Row("walk.thrown_speed", "a standing robot faster than this may step, m/s"),
        *_rewards("capture"),
    ),
    "learner": (
        Row("walk.layout", "observation"),
        Row("learner.hidden", "hidden layers of actor and critic, ELU", " × "),
        Row("copies", "robots"),
        Row("learner.steps", "policy steps of each per round"),
        Row("learner.epochs", "passes over a round"),
        Row("learner.minibatches", "minibatches of a pass"),
        Row("learner.gamma", "discount"),
        Row("learner.lam", "λ of the advantages"),
        Row("learner.learning_rate", "first learning rate"),
        Row("learner.critic_rate", "rate of the critic, where it has its own"),
        Row("learner.desired_kl", "KL divergence that it adapts to"),
        Row("learner.clip", "clip of the likelihood ratio"),
        Row("learner.initial_std", "exploration of a new network"),
        Row("learner.averaged_rounds", "rounds whose weights are averaged for the file"),
        Row("learner.warm_std", "bounds of exploration after a warm start"),
    ),
}
"""Tables of settings on the page, by the name in their marker; what none of them names goes to one called `others`."""
ABOUT_THE_RUN = {
    *("library", "physics", "samples", "threads", "device", "checkpoint_s", "keep_checkpoints"),
    "learner.critic_rounds",  # of runs that begin with a policy file, as no stage of a recipe does
}
"""Settings that are not on the page: what is learned does not follow from them, or they are in the table of recipes."""


def page(table: Table) -> str:
    """The page with its tables as they are now.

    Raises:
        ValueError: a marker on the page has no table, or a table no marker.
    """
    recipe = load_recipe(SHOWN)
    names = [stage.name for stage in recipe.stages]
    blocks = {**BLOCKS, "others": _others(recipe.configs)}
    made = {name: _settings(table, rows, names, recipe.configs) for name, rows in blocks.items()}
    made["recipes"] = _recipes(table)
    return filled(PAGE, made)


def _others(configs: Sequence[PpoConfig]) -> tuple[Row, ...]:
    """Settings that no block names, such as a new one."""
    named = {row.path for rows in BLOCKS.values() for row in rows} | ABOUT_THE_RUN
    paths = dict.fromkeys(path for config in configs for path in setting_paths(config))
    left = [path for path in paths if path not in named]
    return tuple(_reward(path.split(".")[-1]) if ".rewards." in path else Row(path, f"`{path}`") for path in left)


def _recipes(table: Table) -> str:
    """Every recipe's stages, samples and time."""
    rows, training = [], shipped_training()
    for name in recipe_names():
        recipe = load_recipe(name)
        took = seconds_taken(recipe, training)
        for place, (stage, config) in enumerate(zip(recipe.stages, recipe.configs, strict=True)):
            first = f"`{recipe.name}`" if stage is recipe.stages[0] else ""
            rows.append(
                [
                    first,
                    stage.name,
                    f"`{stage.preset}`",
                    millions(stage.samples),
                    config.copies,
                    time_on_two_cores(config) if took is None else f"{took[place] / 60.0:.0f} min",
                ]
            )
        if recipe.averaged_stages > 1:
            rows.append(["", f"the mean of the last {recipe.averaged_stages} networks", "", "", "", "seconds"])
        if recipe.calibrated:
            rows.append(["", "commands calibrated", "", "", "", "minutes"])
        whole = time_on_two_cores(*recipe.configs) if took is None else f"{sum(took) / 3600.0:.1f} h, measured"
        rows.append(["", "**together**", "", millions(recipe.samples), "", whole])
    return table(["recipe", "stage", "preset", "samples", "robots", "two cores"], rows)


def shipped_training() -> Mapping[str, Any]:
    """What the shipped policy says of its own training."""
    return load_policy(asset_path("policies", "asimov_walk.onnx")).contract.training or {}


def seconds_taken(recipe: Recipe, training: Mapping[str, Any]) -> list[float] | None:
    """How long each stage of a recipe took when a policy was made; None where the policy was not made by it."""
    stages = [*(training.get("after") or ()), training]
    if recipe.gpu or [stage.get("preset") for stage in stages] != [stage.preset for stage in recipe.stages]:
        return None
    for stage, config in zip(stages, recipe.configs, strict=True):
        if not 0 <= stage["samples"] - config.samples < config.copies * config.learner.steps:  # whole rounds
            return None
    return [float(stage["seconds"]) for stage in stages]


def time_on_two_cores(*configs: PpoConfig) -> str:
    """How long trainings take, one after the other, in words."""
    if any(config.physics != "c" for config in configs):
        return "for a GPU; not measured"
    hours = [sum(config.samples for config in configs) / speed / 3600.0 for speed in reversed(SPEED)]
    if hours[-1] < 1.0 / 60.0:
        return "seconds"
    if hours[-1] < 2.0:
        return f"{60.0 * hours[0]:.0f} to {60.0 * hours[1]:.0f} min"
    return f"{hours[0]:.1f} to {hours[1]:.1f} h"


def _settings(table: Table, rows: Sequence[Row], names: Sequence[str], configs: Sequence[PpoConfig]) -> str:
    """A column for each stage, or one where all stages are alike; what differs from the stage before is bold."""
    lines = [[_words(row, value_at(config, row.path)) for config in configs] for row in rows]
    if all(len(set(line)) == 1 for line in lines):
        return table(["", "all stages"], [[row.label, line[0]] for row, line in zip(rows, lines, strict=True)])
    bold = [
        [cell if cell == before else f"**{cell}**" for before, cell in zip([line[0], *line], line, strict=False)]
        for line in lines
    ]
    return table(["", *names], [[row.label, *line] for row, line in zip(rows, bold, strict=True)])


def value_at(config: Any, path: str) -> Any:
    """The value at a dotted path; None for a reward term without a weight."""
    for name in path.split("."):
        config = config.get(name) if isinstance(config, Mapping) else getattr(config, name)
    return config


def setting_paths(config: Any, where: str = "") -> list[str]:
    """Dotted paths of all settings of a dataclass; weights one by one, maps of bodies as a whole."""
    if is_dataclass(config):
        below = {f.name: getattr(config, f.name) for f in fields(config)}
    elif where.endswith("rewards."):
        below = config
    else:
        return [where.rstrip(".")]
    return [path for name, value in below.items() for path in setting_paths(value, f"{where}{name}.")]


def _words(row: Row, value: Any) -> str:
    if value is None:
        return "—"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, Mapping):
        return ", ".join(f"{name.removesuffix('_link')} {force:g}" for name, force in value.items()) or "none"
    if isinstance(value, tuple):
        return row.between.join(map(_number, value))
    return value if isinstance(value, str) else _number(value)


def _number(value: float) -> str:
    return millions(value) if abs(value) >= 1e5 else f"{value:g}"


def millions(samples: float) -> str:
    """A number of samples, in short."""
    return f"{samples / 1e6:.3g}M" if samples >= 1e5 else f"{samples:,g}"
