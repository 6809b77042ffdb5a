"""Inference that is late, missing or broken, on a step clock where only injected delays count."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from asimov_gym.firmware import AlertId, InferenceConfig, Stand, State, Velocity
from asimov_gym.robot.joints import joint_index

ELBOW = joint_index("left_elbow_joint")
LATENESS = {AlertId.POLICY_LATE, AlertId.POLICY_DEADLINE_MISS}


@pytest.fixture
def walker(held):
    """A robot on the rope that walks in the air."""
    held.firmware.command(Stand())
    held.run(2.2)
    held.firmware.command(Velocity(0.3, 0.0, 0.0))
    held.run(0.1)
    return held


def found(bench) -> set[AlertId]:
    return {alert.id for alert in bench.firmware.snapshot.alerts}


def test_a_delay_within_the_period_is_no_fault_but_acts_late(walker, policy) -> None:
    walker.firmware.faults.delay_policy(15.0)
    walker.run(0.04)
    asked = len(policy.seen)
    policy.action[list(policy.contract.joint_names).index("left_elbow_joint")] = 4.0
    speeds = []
    while len(policy.seen) == asked:
        walker.run(0.005)
    for _ in range(4):
        speeds.append(abs(walker.firmware.snapshot.joint_velocity[ELBOW]))
        walker.run(0.005)
    # Asked in the first of these steps, answered 15 ms later: in the fourth.
    assert max(speeds[:3]) < 0.3 < abs(walker.firmware.snapshot.joint_velocity[ELBOW])
    walker.run(0.5)
    assert found(walker) == set()
    assert walker.firmware.snapshot.inference.max_ms >= 15.0


def test_a_late_network_warns_and_is_asked_less_often(walker, policy) -> None:
    walker.firmware.faults.delay_policy(30.0)
    before = len(policy.seen)
    walker.run(1.0)
    assert found(walker) == LATENESS
    alert = walker.firmware.snapshot.alerts[0]
    assert (alert.value, alert.threshold) == (300, 200)
    assert len(policy.seen) - before == 25  # every other step
    assert (walker.firmware.state, walker.firmware.snapshot.error_flags) == (State.POLICY, 0)
    walker.firmware.faults.clear()
    walker.run(2.6)
    assert found(walker) == set()


def test_the_previous_target_is_held_meanwhile(walker, policy) -> None:
    index = list(policy.contract.joint_names).index("left_elbow_joint")
    policy.action[index] = 1.0
    walker.run(1.0)
    reached = walker.firmware.snapshot.joint_position[ELBOW]
    walker.firmware.faults.delay_policy(400.0)
    policy.action[index] = -1.0
    walker.run(0.35)
    assert walker.firmware.snapshot.joint_position[ELBOW] == pytest.approx(reached, abs=0.02)
    walker.run(0.6)
    assert walker.firmware.snapshot.joint_position[ELBOW] == pytest.approx(reached - 0.5, abs=0.1)
    assert found(walker) == LATENESS | {AlertId.POLICY_INFERENCE_TIMEOUT}
    assert not walker.firmware.snapshot.latched


def test_a_network_without_an_answer_fails_after_half_a_second(walker) -> None:
    walker.firmware.faults.delay_policy(60_000.0)
    walker.run(0.5)
    assert (walker.firmware.state, walker.firmware.snapshot.error_flags) == (State.POLICY, 0)
    walker.run(0.04)
    assert (walker.firmware.state, walker.firmware.snapshot.error_flags) == (State.DAMP, 1 | 1 << 15)
    alert = next(a for a in walker.firmware.snapshot.alerts if a.id is AlertId.INFERENCE_FAILURE)
    assert (alert.value, alert.threshold) == (5000, 5000)


def test_a_network_that_is_slow_from_the_start_leaves_the_robot_where_it_stood(held) -> None:
    held.firmware.command(Stand())
    held.run(2.2)
    before = held.firmware.snapshot.joint_position
    held.firmware.faults.delay_policy(60_000.0)
    held.firmware.command(Velocity(0.3, 0.0, 0.0))
    assert held.run(0.3).joint_position == pytest.approx(before, abs=0.06)
    held.firmware.command(Stand())
    held.run(1.0)
    assert held.firmware.snapshot.error_flags == 0  # leaving MOVE drops the question


def test_a_failing_network_latches_only_where_it_is_asked(held) -> None:
    held.firmware.faults.fail_policy()
    held.firmware.command(Stand())
    assert held.run(2.2).error_flags == 0
    held.firmware.command(Velocity(0.0, 0.0, 0.0))
    snapshot = held.run(0.005)
    assert (snapshot.state, snapshot.error_flags) == (State.DAMP, 1 | 1 << 15)
    assert snapshot.alerts[0].value == 0


def test_limits_are_the_configurations(make_bench: Callable, policy) -> None:
    bench = make_bench("hold", inference=InferenceConfig(action_limit=2.0, timeout_s=0.05, failure_s=0.1))
    bench.firmware.command(Stand())
    bench.firmware.command(Velocity(0.0, 0.0, 0.0))
    policy.action[0] = np.float32(-2.5)
    snapshot = bench.run(0.005)
    assert [(a.id, a.value, a.threshold) for a in snapshot.alerts] == [(AlertId.POLICY_SPAZ, 2500, 2000)]
    with pytest.raises(ValueError, match="inference failure_s must be above 0 and at most 60, got 0"):
        InferenceConfig(failure_s=0.0)
