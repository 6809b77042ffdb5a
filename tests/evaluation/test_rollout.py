"""Rollouts: what a robot does depends on its trial alone, and every condition does what it says."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from asimov_gym.assets import asset_path
from asimov_gym.evaluation.robots import body_parameters
from asimov_gym.evaluation.rollout import Trace, roll_out
from asimov_gym.evaluation.rows import Command, Push
from asimov_gym.evaluation.scenario import Conditions, Trial
from asimov_gym.evaluation.variants import VARIANTS, build_model
from asimov_gym.policy import PolicyRunner, default_contract, joint_gains, load_policy
from asimov_gym.robot.joints import JOINT_NAMES, KP, POLICY_JOINT_NAMES, STAND_POSITION
from tests.evaluation.standins import FIXED, Spy, Statue, trials


@pytest.fixture(scope="module")
def walker() -> PolicyRunner:
    return load_policy(asset_path("policies", "asimov_walk.onnx"))


def _same(one: Trace, other: Trace) -> None:
    for name in ("position", "quat", "joint_torque", "foot_force", "action", "given"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)


def test_a_trial_is_the_same_alone_and_among_others(walker: PolicyRunner) -> None:
    """Bit for bit: beside others, with other threads, and when the others fall and are left out."""
    hard = Push(0.3, 0.15, 2000.0, (0.0, 1.0, 0.0))
    varied = Conditions(noise=1.0, payload_kg=2.0, foot_friction=0.4, hold_heading=True)
    walking = trials(2.0, (0.5, 0.0, 0.3), conditions=varied, repeats=3, name="test/walk")
    falling = trials(2.5, (0.5, 0.0, 0.0), pushes=(hard,), repeats=5, name="test/fall")
    crowd = roll_out(walker, [*falling, *walking], threads=2)
    assert not crowd.survived[:5].any() and crowd.survived[5:].all()
    for i, trial in enumerate([*falling, *walking]):
        if i in (2, 5, 7):
            _same(crowd.robot(i), roll_out(walker, [trial], threads=1).robot(0))


def test_repeats_differ_and_the_shipped_policy_walks(walker: PolicyRunner) -> None:
    trace = roll_out(walker, trials(3.0, (0.5, 0.0, 0.0), conditions=Conditions(), repeats=2))
    assert trace.survived.all() and np.abs(trace.position[:, 0] - trace.position[:, 1]).max() > 1e-4
    assert trace.velocity[100:, :, 0].mean() == pytest.approx(0.5, abs=0.05)
    # What is recorded fits together: the feet carry the robot, the clock turns at its rate.
    weight = 9.81 * build_model(VARIANTS["evaluation"]).body_subtreemass[1]
    assert trace.foot_force[50:, :, :, 2].sum(axis=2).mean() == pytest.approx(weight, rel=0.05)
    turned = np.unwrap(trace.phase[:, 0])[-1] - trace.phase[0, 0]
    assert turned == pytest.approx(2 * np.pi * walker.contract.gait_frequency_hz * 149 * 0.02, rel=1e-3)


def test_a_delay_is_in_physics_steps() -> None:
    """A policy that jumps to a new target at the first step acts that much later."""

    class Kick(Statue):
        def infer(self, observation: np.ndarray) -> np.ndarray:
            action = super().infer(observation)
            action[:, 3] = 4.0
            return action

    delays = [0.0, 5.0, 10.0, 15.0, 20.0, 25.0, 40.0]
    asked = [trials(0.1, conditions=replace(FIXED, delay=d), name=f"test/d{d:g}")[0] for d in delays]
    torque = np.abs(roll_out(Kick(), asked).joint_torque[:, :, 3])
    # The torque read after a step is that of its last 5 ms: after 20 ms the first four delays show, the others later.
    assert (torque > 20.0).argmax(axis=0).tolist() == [0, 0, 0, 0, 1, 1, 2]


def test_stand_takes_over_from_the_policy() -> None:
    """Its ramp is the firmware's, from where the joints are; what the network says no longer matters."""

    class Bend(Statue):
        steps = 0

        def infer(self, observation: np.ndarray) -> np.ndarray:
            self.steps += 1
            action = super().infer(observation)
            action[:, POLICY_JOINT_NAMES.index("left_elbow_joint")] = 2.0  # 0.5 rad
            return action if self.steps <= 50 else np.full_like(action, np.nan)

    (trial,) = trials(4.0)
    handed = replace(trial, scenario=replace(trial.scenario, stand_at_s=1.0))
    trace = roll_out(Bend(), [handed])
    assert trace.survived.all() and trace.errors == (None,)
    elbow = JOINT_NAMES.index("left_elbow_joint")
    bent, half, straight = (trace.joint_position[k, 0, elbow] - STAND_POSITION[elbow] for k in (49, 99, 170))
    assert bent == pytest.approx(0.5, abs=0.05)
    assert half == pytest.approx(0.5 * bent, abs=0.05)
    assert straight == pytest.approx(0.0, abs=0.05)
    assert roll_out(Bend(), [trial]).errors == ("the network's output is not finite after 1.00 s",)


def test_a_robot_at_rest_in_the_standing_pose_can_be_left_to_stand() -> None:
    (trial,) = trials(8.0)
    handed = replace(trial, scenario=replace(trial.scenario, stand_at_s=0.5))
    trace = roll_out(Statue(), [handed])
    assert trace.survived.all() and -trace.gravity[:, 0, 2].max() > np.cos(np.radians(10.0))


def test_the_shipped_policy_rests_so_that_stand_can_take_over(walker: PolicyRunner) -> None:
    stop = Command(2.5, 0.0, 0.0, 0.0)
    walks = [(0.5, 0.0, 0.0), (0.8, 0.0, 0.0), (0.0, 0.3, 0.0), (0.0, 0.0, 0.8)]
    asked = []
    for i, command in enumerate(walks):
        (trial,) = trials(9.0, command, name=f"test/walk{i}")
        scenario = replace(trial.scenario, commands=(*trial.scenario.commands, stop), stand_at_s=5.0)
        asked.append(replace(trial, scenario=scenario))
    trace = roll_out(walker, asked)
    assert trace.survived.all()
    assert (-trace.gravity[250:, :, 2]).min() > np.cos(np.radians(15.0))


def test_commands_beyond_the_trained_range_are_clamped_unless_the_scenario_says_otherwise() -> None:
    spy = Spy()
    (fast,) = trials(0.1, (1.5, 0.0, 0.0))
    trace = roll_out(spy, [fast])
    high = spy.contract.command_ranges[0][1]
    np.testing.assert_allclose(trace.given[:, 0, 0], high, rtol=1e-6)
    np.testing.assert_allclose(trace.command[:, 0, 0], 1.5)
    wide = replace(fast, scenario=replace(fast.scenario, limits=(("vx", (-1.0, 1.0)),)))
    np.testing.assert_allclose(roll_out(spy, [wide]).given[:, 0, 0], 1.0)
    assert spy.contract.command_ranges[0][1] == high


def test_heading_is_held_by_the_command(walker: PolicyRunner) -> None:
    """Pushed round, the robot comes back to the heading that its commands add up to; open loop it does not."""
    twist = Push(1.0, 0.3, 1.0, (1.0, 0.0, 0.0), torque=(0.0, 0.0, 23.0))
    held = replace(FIXED, hold_heading=True)
    open_loop = trials(8.0, (0.4, 0.0, 0.0), pushes=(twist,), name="test/open")
    closed = trials(8.0, (0.4, 0.0, 0.0), pushes=(twist,), conditions=held, name="test/held")
    trace = roll_out(walker, [*open_loop, *closed])
    assert trace.survived.all()
    w, z = trace.quat[-50:, :, 0].astype(float), trace.quat[-50:, :, 3].astype(float)
    off, on = np.abs(2.0 * np.arctan2(z, w)).mean(axis=0)
    assert off > 0.4 and on < 0.05
    # A robot that is to stand still is not told to turn.
    still = roll_out(Statue(), trials(0.5, conditions=held))
    np.testing.assert_array_equal(still.given, 0.0)


def test_noise_reaches_the_policy_and_only_the_policy() -> None:
    spy = Spy()
    noisy, clean = replace(FIXED, noise=2.0), FIXED
    pair = [trials(0.2, conditions=noisy, name="test/a")[0], trials(0.2, conditions=clean, name="test/a")[0]]
    trace = roll_out(spy, pair)
    np.testing.assert_array_equal(trace.position[:, 0], trace.position[:, 1])  # a statue does not look
    seen = np.stack(spy.seen)
    difference = seen[:, 0] - seen[:, 1]
    layout = spy.contract.observation
    widths = {"gyro": 0.05, "gravity": 0.03}
    at = 0
    for term in layout.terms:
        part = difference[:, at : at + term.size]
        at += term.size
        if term.name in widths:
            assert 0.5 * 2 * widths[term.name] * term.scale < np.abs(part).max() <= 2 * widths[term.name] * term.scale
        elif term.name == "command":
            np.testing.assert_array_equal(part, 0.0)


def test_friction_is_the_friction_of_the_contact() -> None:
    """A robot on ice slides under a pull that it withstands on its own soles."""
    pull = Push(0.1, 0.8, 40.0, (1.0, 0.0, 0.0))
    icy, usual = replace(FIXED, foot_friction=0.02), FIXED
    pair = [trials(1.0, pushes=(pull,), conditions=c, name=f"test/f{i}")[0] for i, c in enumerate((icy, usual))]
    feet = roll_out(Statue(), pair).foot_position[:, :, :, 0]
    slid = (feet[-1] - feet[4]).mean(axis=1)
    assert slid[0] > 0.3 and abs(slid[1]) < 0.05


def test_a_friction_that_would_do_nothing_is_an_error() -> None:
    model = build_model(VARIANTS["evaluation"])
    model.geom_priority[model.geom("floor").id] = 2
    with pytest.raises(ValueError, match="foot_friction would do nothing"):
        body_parameters(default_contract(), [Conditions(foot_friction=0.3)], model)


@pytest.mark.parametrize("physics", ["evaluation", pytest.param("mjx", marks=pytest.mark.slow)])
def test_stand_has_the_gains_of_the_robot(physics: str) -> None:
    """Under a soft policy the robot sags; in STAND it stands as any."""
    soft = replace(default_contract(), joint_stiffness=tuple(0.5 * k for k in default_contract().joint_stiffness))
    asked = []
    for name, stand_at in (("never", None), ("early", 0.1), ("late", 1.5)):
        (trial,) = trials(6.0, name=f"test/{name}")
        conditions = replace(trial.scenario.conditions, physics=physics)
        asked.append(replace(trial, scenario=replace(trial.scenario, stand_at_s=stand_at, conditions=conditions)))
    sag, usual = (
        np.abs(roll_out(Statue(c), asked).joint_position - STAND_POSITION).max(axis=2)
        for c in (soft, default_contract())
    )
    last = len(sag) - 1
    assert sag[last, 0] > 1.3 * usual[last, 0]
    np.testing.assert_allclose(sag[last, 1:], usual[last, 1:], atol=0.1 * usual[last, 0])
    assert sag[70, 2] > 1.3 * usual[70, 2]  # not before


@pytest.mark.parametrize("terrain", ["flat", "rough:0.03", "steps", "obstacles", "rough_tiles", "slope:6"])
def test_friction_counts_on_every_ground(terrain: str) -> None:
    body = body_parameters(
        default_contract(), [Conditions(foot_friction=0.3)], build_model(VARIANTS["evaluation"], terrain)
    )
    np.testing.assert_array_equal(body.foot_friction, [0.3])


def test_each_policy_has_its_own_gains() -> None:
    soft = replace(default_contract(), joint_stiffness=tuple(0.5 * k for k in default_contract().joint_stiffness))
    model = build_model(VARIANTS["evaluation"])
    assert body_parameters(default_contract(), [Conditions()] * 2, model) is None
    body = body_parameters(soft, [Conditions()] * 2, model)
    np.testing.assert_allclose(body.kp_scale[1] * KP, joint_gains(soft)[0])
    asked = trials(0.5)
    position = [roll_out(Statue(c), asked).joint_position[-1, 0] for c in (default_contract(), soft)]
    sag = [np.abs(p - STAND_POSITION).max() for p in position]
    assert sag[1] > 1.3 * sag[0]


def test_payload_weighs_and_weak_motors_saturate() -> None:
    heavy = replace(FIXED, payload_kg=5.0)
    force = [
        roll_out(Statue(), trials(1.0, conditions=c)).foot_force[-10:, 0, :, 2].sum(axis=1).mean()
        for c in (FIXED, heavy)
    ]
    assert force[1] - force[0] == pytest.approx(5.0 * 9.81, rel=0.05)
    knee = JOINT_NAMES.index("left_knee_joint")
    weak = replace(FIXED, motor_strength=0.05, weak_joints=("left_knee_joint",))
    trace = roll_out(Statue(), trials(0.5, conditions=weak))
    model = build_model(VARIANTS["evaluation"])
    limit = model.jnt_actfrcrange[model.joint("left_knee_joint").id, 1]
    torque = np.abs(trace.joint_torque[:, 0])
    assert torque[:, knee].max() == pytest.approx(0.05 * limit, rel=1e-3)
    assert np.delete(torque, knee, axis=1).max() > 0.06 * limit


def test_a_fall_is_measured_from_the_ground_below_and_by_the_rule_that_was_asked() -> None:
    up = replace(FIXED, terrain="slope:10")
    trace = roll_out(Statue(), trials(0.5, conditions=up))
    assert trace.survived.all()
    flat = roll_out(Statue(), trials(0.5))
    # On a slope the soles' highest corner carries at first; that is a few centimetres on 10 degrees.
    assert trace.pelvis_height[0, 0] == pytest.approx(flat.pelvis_height[0, 0], abs=0.05)
    knock = (Push(0.1, 0.15, 450.0, (-1.0, 0.0, 0.0)),)
    rules = [
        trials(3.0, pushes=knock, conditions=replace(FIXED, fall=f), name="test/x")[0] for f in ("firmware", "vendor")
    ]
    ends = roll_out(Statue(), rules).fall_step
    assert 10 < ends[0] < ends[1] < 150  # 60 degrees come before 78.5


def test_an_output_that_is_not_finite_ends_one_trial_with_a_reason() -> None:
    class Broken(Statue):
        def infer(self, observation: np.ndarray) -> np.ndarray:
            action = super().infer(observation)
            command = self.contract.observation.terms
            at = sum(term.size for term in command[: [t.name for t in command].index("command")])
            action[observation[:, at] > 0.1] = np.nan
            return action

    bad, good = trials(0.5, (0.5, 0.0, 0.0), name="test/bad"), trials(0.5, name="test/good")
    trace = roll_out(Broken(), [*bad, *good])
    assert trace.errors == ("the network's output is not finite after 0.00 s", None)
    assert trace.survived.tolist() == [False, True] and np.isfinite(trace.position).all()


def test_a_simulation_that_diverges_ends_one_trial_with_a_reason() -> None:
    blast = (Push(0.1, 0.1, 9999.0, (0.0, 0.0, 1.0), "left_wrist_yaw_link", torque=(0.0, 0.0, 1e6)),)
    trace = roll_out(Statue(), [*trials(0.5, pushes=blast, name="test/blast"), *trials(0.5, name="test/good")])
    assert "the simulation diverged after 0.1" in trace.errors[0] and trace.errors[1] is None
    assert trace.survived.tolist() == [False, True]


@pytest.mark.parametrize("physics", ["half_step", "cg", "feet_only", "training"])
def test_variants_of_the_physics_stand(physics: str) -> None:
    trace = roll_out(Statue(), trials(0.5, conditions=replace(FIXED, physics=physics)))
    usual = roll_out(Statue(), trials(0.5))
    assert trace.survived.all()
    assert np.abs(trace.joint_position[-1] - usual.joint_position[-1]).max() > 1e-9  # it is another physics
    assert trace.pelvis_height[-1, 0] == pytest.approx(usual.pelvis_height[-1, 0], abs=0.01)


def test_delay_of_the_half_step_is_the_same_time() -> None:
    """A push of a joint 10 ms late moves it as much at half the step."""

    class Kick(Statue):
        def infer(self, observation: np.ndarray) -> np.ndarray:
            action = super().infer(observation)
            action[:, 3] = 1.0
            return action

    moved = [
        roll_out(Kick(), trials(0.02, conditions=Conditions(delay=d, physics=p))).joint_velocity[0, 0]
        for d, p in ((10.0, "evaluation"), (10.0, "half_step"), (0.0, "half_step"))
    ]
    joint = int(np.abs(moved[0]).argmax())
    assert moved[1][joint] == pytest.approx(moved[0][joint], rel=0.1)
    assert abs(moved[2][joint]) > 1.15 * abs(moved[1][joint])


def test_trials_that_cannot_share_a_model_are_refused() -> None:
    mixed = [*trials(0.1), *trials(0.1, conditions=replace(FIXED, terrain="rough"))]
    with pytest.raises(ValueError, match="must share physics, terrain"):
        roll_out(Statue(), mixed)
    with pytest.raises(ValueError, match="at least one trial"):
        roll_out(Statue(), [])


def test_a_saved_trace_holds_one_robot(tmp_path: Path) -> None:
    short: list[Trial] = trials(0.2, name="test/short")
    trace = roll_out(Statue(), [*short, *trials(0.5, name="test/long")])
    trace.save(tmp_path / "t.npz", 0)
    with np.load(tmp_path / "t.npz") as data:
        assert data["time"].tolist() == pytest.approx([0.02 * (k + 1) for k in range(10)])
        np.testing.assert_array_equal(data["joint_position"], trace.joint_position[:10, 0])
        assert data["foot_force"].shape == (10, 2, 3) and data["action"].shape == (10, 23)


@pytest.mark.slow
def test_mjx_agrees_with_c_of_the_same_settings(walker: PolicyRunner) -> None:
    pytest.importorskip("jax", reason="MJX needs JAX: pip install 'asimov-gym[mjx]'")
    pytest.importorskip("mujoco.mjx", reason="MJX is not installed: pip install 'asimov-gym[mjx]'")
    both = [
        roll_out(
            walker, trials(3.0, (0.5, 0.0, 0.0), conditions=replace(FIXED, physics=physics, delay=10.0), repeats=2)
        )
        for physics in ("feet_only", "mjx")
    ]
    assert both[0].survived.all() and both[1].survived.all()
    # Float32 and other collision code: the same walk, not the same bits.
    np.testing.assert_allclose(both[1].position[10], both[0].position[10], atol=2e-3)
    speeds = [trace.velocity[100:, :, 0].mean() for trace in both]
    assert speeds[1] == pytest.approx(speeds[0], abs=0.03)
