"""Pushes: their impulse, in the schedule and on a free body, and what came of them."""

from __future__ import annotations

import numpy as np
import pytest

from asimov_gym.evaluation.pushes import PushSchedule, push_outcomes
from asimov_gym.evaluation.rollout import roll_out
from asimov_gym.evaluation.rows import Push
from asimov_gym.physics import CPhysics, JointTarget, compile_model
from asimov_gym.robot.joints import STAND_POSITION
from tests.evaluation.standins import Statue, trials


@pytest.mark.parametrize("begin", [0.4, 0.413])
def test_impulse_is_force_times_duration(begin: float) -> None:
    """Also of a push that begins within a policy step."""
    push = Push(begin, 0.15, 450.0, (0.0, -1.0, 0.0), "waist_yaw_link", torque=(0.0, 0.0, 10.0))
    schedule = PushSchedule(trials(1.0, pushes=(push,)))
    total, steps = np.zeros(6), []
    for step in range(50):
        wrench = schedule.wrench(step, np.array([0]))
        if wrench is not None:
            assert list(wrench) == ["waist_yaw_link"]
            total += 0.02 * wrench["waist_yaw_link"][0]
            steps.append(step)
    np.testing.assert_allclose(total, [0, -450 * 0.15, 0, 0, 0, 10 * 0.15], atol=1e-9)
    assert steps == list(range(20, 29 if begin > 0.41 else 28))


def test_a_free_body_gains_the_impulse() -> None:
    """The momentum of a robot without gravity and ground changes by force times 0.15 s."""
    model = compile_model("evaluation", visuals=False)
    model.opt.gravity[:] = 0.0
    physics = CPhysics(1, "evaluation", 1, model=model)
    qpos, qvel = physics.standing()
    qpos[2] += 2.0
    physics.reset(qpos, qvel)
    schedule = PushSchedule(trials(0.3, pushes=(Push(0.04, 0.15, 100.0, (1.0, 0.0, 0.0), "left_shoulder_pitch_link"),)))
    for step in range(15):
        physics.step(JointTarget(STAND_POSITION[None]), 4, schedule.wrench(step, np.array([0])))
    import mujoco

    data = mujoco.MjData(model)
    state = physics.state()
    data.qpos[:], data.qvel[:] = state.qpos[0], state.qvel[0]
    mujoco.mj_forward(model, data)
    mujoco.mj_subtreeVel(model, data)
    momentum = data.subtree_linvel[1] * model.body_subtreemass[1]
    # Within 1 %: the body turns while it is pushed, and the integrator is of first order.
    np.testing.assert_allclose(momentum, [15.0, 0.0, 0.0], atol=0.15)


def test_only_the_robot_that_is_meant_is_pushed() -> None:
    pushed = trials(1.0, pushes=(Push(0.1, 0.1, 50.0, (0.0, 0.0, 1.0)),), repeats=2)
    schedule = PushSchedule([*trials(1.0), *pushed])
    wrench = schedule.wrench(6, np.array([0, 2]))
    np.testing.assert_array_equal(wrench["pelvis_link"][:, 2], [0.0, 50.0])
    assert schedule.wrench(6, np.array([0])) is None and schedule.wrench(4, np.arange(3)) is None


def test_a_strong_push_fells_a_statue_and_a_feather_does_not() -> None:
    hard = trials(3.0, pushes=(Push(0.5, 0.15, 450.0, (-1.0, 0.0, 0.0)),), name="push/hard")
    soft = trials(3.0, pushes=(Push(0.5, 0.15, 1.0, (-1.0, 0.0, 0.0)),), name="push/soft")
    trace = roll_out(Statue(), [*hard, *soft])
    assert trace.survived.tolist() == [False, True]
    fell = trace.end_s(0)
    assert fell is not None and 0.5 < fell < 3.0 and trace.end_s(1) is None


def test_outcomes() -> None:
    pushes = tuple(Push(t, 0.15, 100.0, (1.0, 0.0, 0.0)) for t in (2.0, 8.0, 14.0))

    def outcomes(end: float | None) -> list[str]:
        return [event.outcome for event in push_outcomes(pushes, end)]

    assert outcomes(None) == ["passed"] * 3
    assert outcomes(1.0) == ["skipped"] * 3
    assert outcomes(3.0) == ["failed", "skipped", "skipped"]
    assert outcomes(7.9) == ["failed", "skipped", "skipped"]  # up to the next push, a fall is the last one's
    assert outcomes(8.5) == ["passed", "failed", "skipped"]
    assert outcomes(19.0) == ["passed", "passed", "failed"]
    assert push_outcomes(pushes[:1], None)[0].label == "pelvis_link 100 N"
