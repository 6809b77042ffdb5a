"""All figures of one trial: which there are, in which units, and when each has a meaning.

A figure is None where it has no meaning: steps while standing of a robot that walks, a cost of transport without a way.
A robot that fell has figures of what its body did (torques, steps, slip), over the time before the fall; figures of how
well it did its task (errors, drift) are None for it, since half a walk is no better for being short. Survival is
counted apart.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

import numpy as np

from asimov_gym.evaluation import effort, gait, standing, tracking
from asimov_gym.evaluation.rollout import Trace
from asimov_gym.evaluation.scenario import Scenario
from asimov_gym.firmware.safety import tilt
from asimov_gym.robot.feet import SOLE_DEPTH
from asimov_gym.robot.frames import heading, to_heading
from asimov_gym.robot.joints import JOINT_NAMES

Better = Literal["lower", "higher"]
DIGITS = 5
"""Significant digits of a figure in a result."""


@dataclass(frozen=True)
class Metric:
    """What a figure says."""

    unit: str
    """Empty for plain numbers and shares."""
    better: Better | None
    """Which way is better; None where neither is."""
    description: str


METRICS: Mapping[str, Metric] = MappingProxyType(
    {
        "velocity_error_m_s": Metric("m/s", "lower", "planar velocity error averaged over a gait cycle, after 2 s"),
        "yaw_rate_error_rad_s": Metric("rad/s", "lower", "yaw rate error averaged over a gait cycle, after 2 s"),
        "velocity_rmse_m_s": Metric("m/s", "lower", "RMS of the planar velocity error at each instant, after 2 s"),
        "yaw_rate_rmse_rad_s": Metric("rad/s", "lower", "RMS of the yaw rate error at each instant, after 2 s"),
        "mean_vx_m_s": Metric("m/s", None, "mean forward velocity after 2 s, under a constant command"),
        "mean_vy_m_s": Metric("m/s", None, "mean velocity to the left after 2 s, under a constant command"),
        "mean_yaw_rate_rad_s": Metric("rad/s", None, "mean yaw rate after 2 s, under a constant command"),
        "drift_final_m": Metric("m", "lower", "distance from the end of the commands' dead-reckoned path"),
        "heading_error_final_rad": Metric("rad", "lower", "last heading against that of the dead-reckoned path"),
        "standing_drift_m": Metric("m", "lower", "largest distance of the pelvis from its start, standing"),
        "standing_drift_settled_m": Metric("m", "lower", "largest distance from its place at 2 s, standing"),
        "sway_m": Metric("m", "lower", "RMS distance of the pelvis from its mean after 2 s, standing"),
        "standing_steps": Metric("", "lower", "times a foot left the ground, standing"),
        "tilt_max_rad": Metric("rad", "lower", "largest tilt of the pelvis"),
        "stand_tilt_max_rad": Metric("rad", "lower", "largest tilt of the pelvis after STAND took over"),
        "stance_stagger_m": Metric("m", "lower", "how far one foot was before the other as STAND took over"),
        "stance_width_m": Metric("m", None, "how far the feet were apart sideways as STAND took over"),
        "gait_frequency_hz": Metric("Hz", None, "gait cycles per second"),
        "foot_clearance_m": Metric("m", "higher", "mean over all steps of the sole's highest point above the ground"),
        "slip_m_s": Metric("m/s", "lower", "mean horizontal speed of carrying feet"),
        "slip_m_per_m": Metric("m/m", "lower", "way that carrying feet slid, per metre walked"),
        "step_time_asymmetry": Metric("", "lower", "left-right difference of the swing's duration, share of the mean"),
        "foot_lift_asymmetry": Metric("", "lower", "left-right difference of the swing's height, share of the mean"),
        "joint_range_asymmetry": Metric(
            "", "lower", "left-right difference of the legs' angles used, share of the mean"
        ),
        "cost_of_transport": Metric("", "lower", "work of all drives over weight times way"),
        "torque_rms_share": Metric("", "lower", "RMS torque over the limit, worst joint"),
        "torque_peak_share": Metric("", "lower", "largest torque over the limit, worst joint"),
        "rated_torque_share": Metric("", "lower", "RMS torque over the continuous rating, worst motor"),
        "speed_share": Metric("", "lower", "largest speed over the velocity limit, worst joint"),
        "no_load_speed_share": Metric("", "lower", "largest speed over the no-load speed, worst motor"),
        "action_jerk": Metric("action²", "lower", "mean squared second difference of the actions"),
    }
)
"""The figures by name. Three more for each joint: see `joint_metric`."""

JOINT_METRICS = ("torque_rms_share", "torque_peak_share", "speed_share")


def joint_metric(name: str, joint: str) -> str:
    """Key of a joint's own figure, such as `torque_peak_share/left_knee`.

    Args:
        name: one of `JOINT_METRICS`.
        joint: name in joint order, such as `left_knee_joint`.
    """
    return f"{name}/{joint.removesuffix('_joint')}"


def metric(name: str) -> Metric:
    """What a figure says, by the name that it has in a result.

    Raises:
        KeyError: there is no such figure.
    """
    base, _, joint = name.partition("/")
    if joint and base in JOINT_METRICS:
        return Metric("", "lower", METRICS[base].description.replace("worst joint", joint.replace("_", " ")))
    return METRICS[name]


def trial_metrics(trace: Trace, i: int, scenario: Scenario, period_s: float) -> dict[str, float | None]:
    """Every figure of one robot of a rollout.

    Args:
        trace: what the robots did.
        i: the robot.
        scenario: what it was asked to do.
        period_s: of the policy's gait cycle.

    Returns:
        The figures of `METRICS` and those of each joint, finite or None. Shares of limits are those of the nominal
        robot also where the scenario weakens its motors.
    """
    end = int(trace.fall_step[i])
    values: dict[str, float | None] = dict.fromkeys(METRICS)
    if end < 1:
        return values
    dt, survived = trace.dt, bool(trace.survived[i])
    asked = scenario.command_rows()[:end]
    position = np.asarray(trace.position[:end, i], dtype=np.float64)
    stands = scenario.stands
    values["tilt_max_rad"] = tilt(float(trace.gravity[:end, i, 2].max()))
    if survived:
        turned = heading(np.asarray(trace.quat[:end, i], dtype=np.float64))
        velocity = np.asarray(trace.velocity[:end, i], dtype=np.float64)
        path = tracking.dead_reckoned_path(asked, dt, trace.start[i])
        values |= _task(velocity, asked, dt, period_s) | _where(position, turned, *path)
    if scenario.stand_step < end:
        values |= _hand_over(trace, i, scenario.stand_step, end)
    contact = gait.contacts(trace.foot_force[:end, i, :, 2])
    sole = trace.foot_height[:end, i] - SOLE_DEPTH
    if survived and stands:
        values["standing_drift_m"] = standing.drift(position, trace.start[i])
        values["standing_drift_settled_m"] = standing.settled_drift(position, dt)
        values["sway_m"] = standing.sway(position, dt)
        values["standing_steps"] = standing.steps_taken(sole, contact, dt)
    torque, speed = trace.joint_torque[:end, i], trace.joint_velocity[:end, i]
    foot_velocity = trace.foot_velocity[:end, i]
    values["slip_m_s"] = gait.slip_speed(foot_velocity, contact)
    if not stands:
        way = tracking.path_length(position, dt, period_s)
        mass = effort.robot_mass() + scenario.conditions.payload_kg
        values["cost_of_transport"] = effort.cost_of_transport(torque, speed, dt, mass, way)
        if way >= effort.LEAST_DISTANCE:
            values["slip_m_per_m"] = gait.slip_distance(foot_velocity, contact, dt) / way
        values |= _steps(gait.swings(contact, sole, dt), dt)
        if survived and not scenario.pushes and (scenario.gait_symmetry or _walks_straight(asked, dt)):
            settled = round(tracking.SETTLE_S / dt)
            values |= _asymmetry(contact[settled:], sole[settled:], trace.joint_position[settled:end, i], dt)
    values |= _drives(torque, speed)
    values["action_jerk"] = effort.action_jerk(trace.action[:end, i])
    return {name: _finite(value) for name, value in values.items()}


def _task(velocity: np.ndarray, asked: np.ndarray, dt: float, period_s: float) -> dict[str, float | None]:
    """How well a robot that did not fall kept the velocity asked."""
    error = tracking.cycle_error(velocity, asked, dt, period_s) or (None, None)
    rmse = tracking.instantaneous_rmse(velocity, asked, dt) or (None, None)
    mean = tracking.mean_velocity(velocity, dt) if _is_steady(asked, dt) else None
    reached = (None, None, None) if mean is None else mean.tolist()
    return {
        "velocity_error_m_s": error[0],
        "yaw_rate_error_rad_s": error[1],
        "velocity_rmse_m_s": rmse[0],
        "yaw_rate_rmse_rad_s": rmse[1],
        "mean_vx_m_s": reached[0],
        "mean_vy_m_s": reached[1],
        "mean_yaw_rate_rad_s": reached[2],
    }


def _where(
    position: np.ndarray, turned: np.ndarray, path: np.ndarray, path_heading: np.ndarray
) -> dict[str, float | None]:
    """How far from where it was sent a robot ended."""
    return {
        "drift_final_m": tracking.final_drift(position, path),
        "heading_error_final_rad": tracking.final_heading_error(turned, path_heading),
    }


def _hand_over(trace: Trace, i: int, step: int, end: int) -> dict[str, float | None]:
    """The stance in which STAND took over at a step, and how it went on."""
    turned = heading(np.asarray(trace.quat[step - 1, i], dtype=np.float64))
    left, right = to_heading(turned, np.asarray(trace.foot_position[step - 1, i], dtype=np.float64))
    return {
        "stance_stagger_m": abs(float(left[0] - right[0])),
        "stance_width_m": float(left[1] - right[1]),
        "stand_tilt_max_rad": tilt(float(trace.gravity[step:end, i, 2].max())),
    }


def _steps(steps: list[gait.Swing], dt: float) -> dict[str, float | None]:
    return {"gait_frequency_hz": gait.frequency(steps, dt), "foot_clearance_m": gait.clearance(steps)}


def _asymmetry(contact: np.ndarray, sole: np.ndarray, joint_position: np.ndarray, dt: float) -> dict[str, float | None]:
    steps = gait.swings(contact, sole, dt)
    return {
        "step_time_asymmetry": gait.step_time_asymmetry(steps),
        "foot_lift_asymmetry": gait.foot_lift_asymmetry(steps),
        "joint_range_asymmetry": gait.joint_range_asymmetry(joint_position),
    }


def _drives(torque: np.ndarray, speed: np.ndarray) -> dict[str, float | None]:
    """Torques and speeds against their limits."""
    shares = {
        "torque_rms_share": effort.torque_rms_shares(torque),
        "torque_peak_share": effort.torque_peak_shares(torque),
        "speed_share": effort.speed_peak_shares(speed),
    }
    values: dict[str, float | None] = {name: float(of_joint.max()) for name, of_joint in shares.items()}
    values["rated_torque_share"] = float(effort.rated_torque_shares(torque).max())
    values["no_load_speed_share"] = float(effort.no_load_shares(speed).max())
    for name, of_joint in shares.items():
        values |= {joint_metric(name, joint): float(of_joint[k]) for k, joint in enumerate(JOINT_NAMES)}
    return values


def _is_steady(asked: np.ndarray, dt: float) -> bool:
    """Whether the command stays the same after the first two seconds."""
    settled = asked[round(tracking.SETTLE_S / dt) :]
    return len(settled) > 0 and bool((settled == settled[0]).all())


def _walks_straight(asked: np.ndarray, dt: float) -> bool:
    """Whether the command asks for one speed forwards or backwards, and nothing else, after the first two seconds."""
    return _is_steady(asked, dt) and asked[-1, 0] != 0.0 and not asked[-1, 1:].any()


def _finite(value: float | None) -> float | None:
    """The figure to `DIGITS` digits; None where it is not finite."""
    if value is None or not math.isfinite(value):
        return None
    return float(f"{value:.{DIGITS}g}")
