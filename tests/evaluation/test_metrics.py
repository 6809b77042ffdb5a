"""Which figures a trial has, and that they come from the right part of its trace."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from asimov_gym.evaluation.effort import robot_mass
from asimov_gym.evaluation.metrics import JOINT_METRICS, METRICS, joint_metric, metric, trial_metrics
from asimov_gym.evaluation.rollout import DT, Trace
from asimov_gym.evaluation.rows import Command, Push
from asimov_gym.evaluation.scenario import Conditions, Scenario
from asimov_gym.robot.feet import SOLE_DEPTH
from asimov_gym.robot.joints import EFFORT, JOINT_NAMES, joint_index

SIZES = {
    "foot_position": (2, 3),
    "foot_velocity": (2, 3),
    "foot_force": (2, 3),
    "foot_height": (2,),
    "pelvis_height": (),
}
WIDTHS = {"joint_position": 25, "joint_velocity": 25, "joint_torque": 25, "action": 23, "quat": 4}


def scenario(vx: float = 0.0, vy: float = 0.0, wz: float = 0.0, seconds: float = 10.0, **other: object) -> Scenario:
    return Scenario("grid/made", "grid", seconds, (Command(0.0, vx, vy, wz),), **other)


def still(n: int, seconds: float = 10.0) -> Trace:
    """Robots that stand like statues, 160 N on each foot."""
    steps = round(seconds / DT)
    arrays = {name: np.zeros((steps, n, 3)) for name in ("command", "given", "velocity", "position", "gravity")}
    arrays |= {name: np.zeros((steps, n, *size)) for name, size in SIZES.items()}
    arrays |= {name: np.zeros((steps, n, width)) for name, width in WIDTHS.items()}
    arrays["phase"] = np.zeros((steps, n))
    arrays["gravity"][..., 2], arrays["position"][..., 2], arrays["quat"][..., 0] = -1.0, 0.7, 1.0
    arrays["foot_force"][..., 2], arrays["foot_height"][...] = 160.0, SOLE_DEPTH
    whole = np.full(n, steps)
    return Trace(DT, start=arrays["position"][0].copy(), steps=whole, fall_step=whole, errors=(None,) * n, **arrays)


def walker(vx: float, seconds: float = 10.0) -> Trace:
    """One robot that moves at vx along x and swings its feet 5 cm high in turn, 1.25 times a second."""
    trace = still(1, seconds)
    steps = len(trace.position)
    trace.position[:, 0, 0] = vx * DT * np.arange(1, steps + 1)
    trace.velocity[:, 0, 0] = vx
    for foot in range(2):
        for first in range(2 + 20 * foot, steps - 20, 40):
            trace.foot_force[first : first + 16, 0, foot, 2] = 0.0
            trace.foot_height[first + 8, 0, foot] = SOLE_DEPTH + 0.05
    trace.joint_position[:, 0, joint_index("left_knee_joint")] = np.sin(7.85 * DT * np.arange(steps))
    trace.joint_position[:, 0, joint_index("right_knee_joint")] = -np.sin(7.85 * DT * np.arange(steps))
    trace.joint_torque[:, 0, joint_index("left_knee_joint")] = 18.0
    trace.joint_velocity[:, 0, joint_index("left_knee_joint")] = 2.0
    return trace


def test_every_figure_is_described_and_survives_json() -> None:
    values = trial_metrics(walker(0.5), 0, scenario(0.5), 0.8)
    assert set(values) == set(METRICS) | {joint_metric(name, joint) for name in JOINT_METRICS for joint in JOINT_NAMES}
    assert json.loads(json.dumps(values, allow_nan=False)) == values
    assert metric("torque_peak_share/left_knee").description == "largest torque over the limit, left knee"
    with pytest.raises(KeyError):
        metric("sway_m/left_knee")


def test_a_walk_has_walking_figures() -> None:
    values = trial_metrics(walker(0.45), 0, scenario(0.5), 0.8)
    assert values["velocity_error_m_s"] == pytest.approx(0.05) and values["yaw_rate_error_rad_s"] == 0.0
    assert values["mean_vx_m_s"] == pytest.approx(0.45)
    assert values["drift_final_m"] == pytest.approx(0.5)  # 5 cm/s for 10 s
    assert values["gait_frequency_hz"] == pytest.approx(1.25)
    assert values["foot_clearance_m"] == pytest.approx(0.05)
    assert values["slip_m_s"] == 0.0 and values["slip_m_per_m"] == 0.0
    assert values["step_time_asymmetry"] == 0.0 and values["joint_range_asymmetry"] == pytest.approx(0.0)
    watts, way = 36.0, 4.5
    assert values["cost_of_transport"] == pytest.approx(watts * 10.0 / (robot_mass() * 9.81 * way), rel=0.01)
    assert values["torque_rms_share"] == values[joint_metric("torque_rms_share", "left_knee_joint")]
    assert values["torque_peak_share"] == pytest.approx(18.0 / EFFORT[joint_index("left_knee_joint")], rel=1e-4)
    for name in ("standing_drift_m", "standing_drift_settled_m", "sway_m", "standing_steps"):
        assert values[name] is None


def test_a_payload_is_carried_too() -> None:
    bare = trial_metrics(walker(0.5), 0, scenario(0.5), 0.8)["cost_of_transport"]
    loaded = trial_metrics(walker(0.5), 0, scenario(0.5, conditions=Conditions(payload_kg=5.0)), 0.8)
    assert loaded["cost_of_transport"] / bare == pytest.approx(robot_mass() / (robot_mass() + 5.0), rel=1e-3)


def test_standing_has_standing_figures() -> None:
    trace = still(1)
    trace.position[:50, 0, 0] = 0.02
    trace.foot_height[200:210, 0, 1] = 0.05
    values = trial_metrics(trace, 0, scenario(), 0.8)
    assert values["standing_drift_m"] == pytest.approx(0.02) and values["standing_drift_settled_m"] == 0.0
    assert values["standing_steps"] == 1
    for name in ("cost_of_transport", "gait_frequency_hz", "foot_clearance_m", "step_time_asymmetry", "slip_m_per_m"):
        assert values[name] is None


def test_symmetry_is_that_of_straight_steady_walks_without_pushes() -> None:
    push = Push(5.0, 0.15, 100.0, (1.0, 0.0, 0.0))
    for made in (scenario(0.5, 0.0, 0.3), scenario(0.0, 0.3), scenario(0.5, pushes=(push,))):
        assert trial_metrics(walker(0.5), 0, made, 0.8)["step_time_asymmetry"] is None
    opted = scenario(0.5, 0.0, 0.3, gait_symmetry=True)
    assert trial_metrics(walker(0.5), 0, opted, 0.8)["step_time_asymmetry"] == 0.0


def test_mean_velocity_needs_a_steady_command() -> None:
    changing = replace(scenario(0.5), commands=(Command(0.0, 0.5, 0.0, 0.0), Command(6.0, 0.2, 0.0, 0.0)))
    values = trial_metrics(walker(0.5), 0, changing, 0.8)
    assert values["mean_vx_m_s"] is None
    # 4 s of 8 judged are 0.3 too fast; around the change a cycle's mean holds a part of both
    assert values["velocity_error_m_s"] == pytest.approx(0.15, abs=0.01)


def test_heading_and_tilt() -> None:
    trace = still(1)
    trace.quat[-1, 0] = [math.cos(0.2), 0.0, 0.0, math.sin(0.2)]
    trace.gravity[250, 0] = [math.sin(0.3), 0.0, -math.cos(0.3)]
    values = trial_metrics(trace, 0, scenario(), 0.8)
    assert values["heading_error_final_rad"] == pytest.approx(0.4, rel=1e-4)
    assert values["tilt_max_rad"] == pytest.approx(0.3, rel=1e-4)


def test_the_stance_in_which_stand_takes_over_and_how_far_the_robot_then_tips() -> None:
    trace = still(1)
    turned = 0.5 * np.pi  # the robot faces +y: left is -x
    trace.quat[:, 0] = [np.cos(0.5 * turned), 0.0, 0.0, np.sin(0.5 * turned)]
    trace.foot_position[:, 0, :, :2] = [[-0.11, 0.03], [0.09, -0.01]]
    trace.gravity[100:200, 0] = [0.0, np.sin(0.5), -np.cos(0.5)]
    trace.gravity[400:, 0] = [np.sin(0.2), 0.0, -np.cos(0.2)]
    values = trial_metrics(trace, 0, scenario(stand_at_s=5.0), 0.667)
    assert values["stance_stagger_m"] == pytest.approx(0.04)
    assert values["stance_width_m"] == pytest.approx(0.2)
    assert values["stand_tilt_max_rad"] == pytest.approx(0.2)
    assert values["tilt_max_rad"] == pytest.approx(0.5)
    without = trial_metrics(trace, 0, scenario(), 0.667)
    assert without["stance_stagger_m"] is without["stance_width_m"] is without["stand_tilt_max_rad"] is None
    trace.fall_step[:] = 240  # before STAND
    assert trial_metrics(trace, 0, scenario(stand_at_s=5.0), 0.667)["stand_tilt_max_rad"] is None


def test_a_robot_that_fell_has_figures_of_its_body_before_the_fall_only() -> None:
    trace = replace(walker(0.5), fall_step=np.array([300]))
    trace.joint_torque[300:] = 1e6
    trace.gravity[300:] = [0.0, 0.0, 1.0]
    values = trial_metrics(trace, 0, scenario(0.5), 0.8)
    for name in ("velocity_error_m_s", "velocity_rmse_m_s", "drift_final_m", "mean_vx_m_s", "step_time_asymmetry"):
        assert values[name] is None
    assert values["torque_peak_share"] == pytest.approx(0.4) and values["tilt_max_rad"] == 0.0
    assert values["gait_frequency_hz"] == pytest.approx(1.25) and values["cost_of_transport"] is not None
    at_once = trial_metrics(replace(trace, fall_step=np.array([0])), 0, scenario(0.5), 0.8)
    assert set(at_once.values()) == {None}


def test_what_is_not_finite_is_none() -> None:
    trace = walker(0.5)
    trace.action[5] = np.nan
    assert trial_metrics(trace, 0, scenario(0.5), 0.8)["action_jerk"] is None


def test_robots_of_a_batch_do_not_mix() -> None:
    alone, pair = walker(0.5), still(2)
    arrays = {
        name: np.concatenate([getattr(pair, name), getattr(alone, name)], axis=1)
        for name in ("velocity", "position", "quat", "gravity", *SIZES, "joint_position", "joint_velocity")
    }
    arrays |= {
        name: np.concatenate([getattr(pair, name), getattr(alone, name)], axis=1) for name in ("joint_torque", "action")
    }
    whole = np.full(3, len(alone.position))
    three = replace(
        pair,
        **arrays,
        start=np.zeros((3, 3)),
        errors=(None,) * 3,
        steps=whole,
        fall_step=np.array([100, 500, 500]),
    )
    assert trial_metrics(three, 2, scenario(0.5), 0.8) == trial_metrics(alone, 0, scenario(0.5), 0.8)
