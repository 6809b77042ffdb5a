"""The rope: holds in DAMP, lowers in STAND, is nothing in MOVE, catches a fall."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from asimov_gym.firmware import Damp, GantryConfig, Stand, State, Trajectory, Velocity
from asimov_gym.robot.joints import STAND_POSITION


def upright(bench) -> bool:
    return float(bench.physics.read().gravity[0, 2]) < -0.95


def test_damped_robot_hangs_upright_and_still(bench) -> None:
    snapshot = bench.run(4.0)
    reading = bench.physics.read()
    weight = 9.81 * float(bench.physics.model.body_subtreemass[0])
    assert snapshot.gantry_force == pytest.approx(weight, rel=0.05)
    assert upright(bench)
    assert bench.pelvis_height() == pytest.approx(0.6745, abs=0.02)
    assert np.abs(reading.base_velocity).max() < 0.05


def test_the_round_through_all_modes_never_falls(bench) -> None:
    heights = []
    for command, seconds in ((Stand(), 2.0), (Velocity(0.3, 0.0, 0.0), 3.0), (Stand(), 2.0), (Damp(), 3.0)):
        bench.firmware.command(command)
        for _ in range(round(seconds / 0.05)):
            snapshot = bench.run(0.05)
            heights.append(bench.pelvis_height())
            assert upright(bench)
    assert min(heights) > 0.55
    assert snapshot.error_flags == 0
    assert snapshot.gantry_force > 250.0


def test_feet_carry_the_robot_at_the_end_of_the_stand_ramp(bench) -> None:
    bench.run(1.0)
    bench.firmware.command(Stand())
    bench.run(2.0)
    forces = []
    for _ in range(100):
        forces.append(bench.run(0.005).gantry_force)
    weight = 9.81 * float(bench.physics.model.body_subtreemass[0])
    assert forces == [0.0] * 100
    assert bench.physics.read().foot_force[0, :, 2].sum() == pytest.approx(weight, rel=0.1)


def test_force_is_exactly_zero_in_move(bench) -> None:
    bench.firmware.command(Stand())
    bench.run(2.5)
    bench.firmware.command(Velocity(0.0, 0.0, 0.0))
    assert [bench.run(0.005).gantry_force for _ in range(400)] == [0.0] * 400


def test_move_right_after_boot_survives(bench) -> None:
    bench.firmware.command(Stand())
    bench.run(0.005)
    bench.firmware.command(Velocity(0.0, 0.0, 0.0))
    snapshot = bench.run(4.0)
    assert snapshot.error_flags == 0
    assert snapshot.gantry_force == 0.0
    assert bench.pelvis_height() == pytest.approx(0.608, abs=0.02)


def topple(bench) -> None:
    bench.firmware.command(Stand())
    bench.run(2.5)
    bench.firmware.command(Velocity(0.0, 0.0, 0.0))
    bench.run(1.0)
    bench.physics.kick(np.array([[1.5, 0.0, 0.0, 0.0, 0.0, 0.0]]))


def test_short_rope_catches_a_toppling_robot_before_it_counts_as_a_fall(make_bench: Callable) -> None:
    bench = make_bench(gantry_config=GantryConfig(move_slack=0.3))
    topple(bench)
    snapshot = bench.run(3.0)
    assert (snapshot.state, snapshot.error_flags) == (State.POLICY, 0)
    assert snapshot.gantry_force > 100.0
    assert bench.pelvis_height() > 0.25
    bench.firmware.command(Damp())
    bench.run(5.0)
    assert upright(bench)
    bench.firmware.command(Stand())
    assert bench.run(4.0).gantry_force == 0.0
    assert bench.pelvis_height() == pytest.approx(0.608, abs=0.02)


def test_a_topple_is_a_fall_and_the_robot_is_hoisted(bench) -> None:
    topple(bench)
    snapshot = bench.run(3.0)
    assert (snapshot.state, snapshot.error_flags) == (State.DAMP, 0x101)
    bench.run(5.0)
    assert upright(bench)


def test_fallen_robot_is_hoisted_and_stands_after_a_restart(bench) -> None:
    bench.firmware.command(Stand())
    bench.run(2.5)
    bench.firmware.command(Velocity(0.0, 0.0, 0.0))
    bench.run(1.0)
    bench.physics.kick(np.array([[0.0, 0.0, 0.0, 0.0, 12.0, 0.0]]))
    assert bench.run(2.0).state is State.DAMP
    snapshot = bench.run(6.0)
    assert snapshot.latched
    assert upright(bench)
    assert bench.pelvis_height() > 0.62
    bench.firmware.restart()
    bench.firmware.command(Stand())
    snapshot = bench.run(4.0)
    assert (snapshot.state, snapshot.error_flags, snapshot.gantry_force) == (State.STAND, 0, 0.0)
    assert bench.pelvis_height() == pytest.approx(0.608, abs=0.02)


def test_drifting_robot_comes_to_rest_on_the_rope(bench) -> None:
    bench.run(1.0)
    bench.physics.kick(np.array([[0.7, 0.3, 0.0, 0.0, 0.0, 2.0]]))
    bench.run(4.0)
    reading = bench.physics.read()
    assert np.abs(reading.base_velocity[0]).max() < 0.1
    assert np.abs(reading.gyro[0]).max() < 0.2


def test_held_robot_never_touches_the_floor_with_its_weight(held) -> None:
    held.firmware.command(Stand())
    held.run(3.0)
    held.firmware.command(Velocity(0.3, 0.0, 0.0))
    assert held.run(2.0).gantry_force == pytest.approx(316.0, rel=0.05)
    assert held.pelvis_height() > 0.65


def test_without_a_rope_there_is_no_force(make_bench: Callable) -> None:
    bench = make_bench("off")
    assert bench.pelvis_height() == pytest.approx(0.6145)
    assert [bench.run(0.005).gantry_force for _ in range(100)] == [0.0] * 100


# -- by hand ---------------------------------------------------------------------------------------


def enter(bench, state: State) -> None:
    if state in (State.STAND, State.POLICY):
        bench.firmware.command(Stand())
        bench.run(2.2)
    if state is State.POLICY:
        bench.firmware.command(Velocity(0.0, 0.0, 0.0))
    if state is State.TRAJECTORY:
        bench.firmware.command(Trajectory(STAND_POSITION, timeout_s=60.0))
    assert bench.run(0.5).state is state


@pytest.mark.parametrize("state", State)
def test_hoisted_by_hand_in_every_state(bench, state: State) -> None:
    enter(bench, state)
    bench.firmware.gantry.by_hand("hoist")
    snapshot = bench.run(3.0)
    weight = 9.81 * float(bench.physics.model.body_subtreemass[0])
    assert snapshot.state is state
    assert snapshot.gantry_force == pytest.approx(weight, rel=0.05)
    assert bench.physics.read().foot_force[0, :, 2].sum() == pytest.approx(0.0, abs=1.0)


@pytest.mark.parametrize("state", [State.DAMP, State.STAND, State.TRAJECTORY])
def test_untied_by_hand_there_is_no_force(bench, state: State) -> None:
    enter(bench, state)
    bench.firmware.gantry.by_hand("off")
    assert [bench.run(0.005).gantry_force for _ in range(100)] == [0.0] * 100


def test_lowered_by_hand_at_the_speed_of_the_winch(bench) -> None:
    enter(bench, State.TRAJECTORY)
    bench.firmware.command(Trajectory(STAND_POSITION, timeout_s=60.0))
    bench.firmware.gantry.by_hand("hoist")
    bench.run(2.0)
    taut = bench.firmware.gantry.taut_height
    bench.firmware.gantry.by_hand("lower")
    bench.run(0.3)
    assert taut - bench.firmware.gantry.taut_height == pytest.approx(0.3 * 0.15, abs=1e-6)
    snapshot = bench.run(1.5)
    assert snapshot.gantry_force == 0.0
    assert bench.pelvis_height() == pytest.approx(0.608, abs=0.02)
    assert upright(bench)


def test_a_limp_robot_on_a_slack_rope_sinks_until_it_catches(bench) -> None:
    bench.run(1.0)
    bench.firmware.gantry.by_hand("slack")
    snapshot = bench.run(6.0)
    assert bench.pelvis_height() < 0.45
    assert (snapshot.state, snapshot.error_flags) == (State.DAMP, 0)
    bench.firmware.gantry.by_hand("auto")
    bench.run(6.0)
    assert upright(bench)
    assert bench.pelvis_height() > 0.62


def test_a_robot_tied_again_on_the_floor_is_lifted_without_a_jerk(make_bench: Callable) -> None:
    bench = make_bench("off")
    bench.run(2.0)
    assert bench.pelvis_height() < 0.45
    bench.firmware.gantry.by_hand("hoist")
    weight = 9.81 * float(bench.physics.model.body_subtreemass[0])
    forces = [bench.run(0.005).gantry_force for _ in range(1600)]
    assert max(forces) < 1.6 * weight
    assert forces[-1] == pytest.approx(weight, rel=0.05)
    assert upright(bench)


def test_auto_by_hand_obeys_the_machine_again(held) -> None:
    held.firmware.gantry.by_hand("auto")
    held.firmware.command(Stand())
    assert held.run(3.0).gantry_force == 0.0


def test_an_unknown_setting_is_refused(bench) -> None:
    with pytest.raises(ValueError, match="gantry by hand must be one of hoist, lower, slack, off, auto, got 'up'"):
        bench.firmware.gantry.by_hand("up")
