"""Runs of joint commands in the firmware: what begins and ends them, and the 1 kHz loop under them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from asimov_gym.firmware import (
    AlertId,
    Damp,
    Firmware,
    Freeze,
    JointCommand,
    JointControlConfig,
    JointGains,
    Outcome,
    Refusal,
    RunEnd,
    Stand,
    State,
    Stream,
    Trajectory,
    Velocity,
)
from asimov_gym.robot.frames import projected_gravity
from asimov_gym.robot.joints import EFFORT, KD, KP, STAND_POSITION, joint_index

ELBOW = joint_index("left_elbow_joint")
GAINS = JointGains(KP.copy(), KD.copy())
ZERO = np.zeros(25)


class Rig:
    """Firmware at either rate on the clock of a bench."""

    def __init__(self, bench: Any) -> None:
        self.firmware: Firmware = bench.firmware
        self.clock = bench.clock

    def step(self) -> int:
        length = self.firmware.step_us
        self.clock.advance(length)
        self.firmware.tick()
        return length

    def run(self, seconds: float) -> None:
        left = round(seconds * 1e6)
        while left > 0:
            left -= self.step()

    def send(self, angle: float = 0.4, ahead_s: float = 0.05, first: bool = True, **fields: Any) -> Refusal | None:
        position = STAND_POSITION.copy()
        position[ELBOW] = angle
        given: dict[str, Any] = {"position": position, "velocity": ZERO, "load": ZERO}
        if first:
            given["gains"] = GAINS
        now = self.clock.now_us()
        command = JointCommand(**(given | fields), end_us=now + round(ahead_s * 1e6))
        return self.firmware.joints.take(command, now, self.clock.realtime_us())


@pytest.fixture
def rig(held: Any) -> Rig:
    held.firmware.fast = True
    return Rig(held)


# -- beginning and ending --------------------------------------------------------------------------


@pytest.mark.parametrize("before", [None, Stand(), Velocity(0.0, 0.0, 0.0), Trajectory(STAND_POSITION)])
def test_a_run_begins_from_every_mode(rig: Rig, before: Any) -> None:
    if isinstance(before, Velocity):
        rig.firmware.command(Stand())
    if before is not None:
        rig.firmware.command(before)
    rig.run(0.05)
    assert rig.send() is None
    assert rig.firmware.command(Stream()).outcome is Outcome.TAKEN
    assert (rig.firmware.state, rig.firmware.joints.running) == (State.TRAJECTORY, True)


def test_commands_move_nothing_before_the_run_and_are_kept_for_it(rig: Rig) -> None:
    rig.send(1.5, ahead_s=0.3)
    rig.run(0.1)
    assert rig.firmware.state is State.DAMP
    rig.firmware.command(Stream())
    rig.run(0.15)
    assert rig.firmware.joints.received == 1
    # On its way to 1.5 rad, with the gains that came before the run.
    assert rig.firmware.snapshot.joint_position[ELBOW] > 1.0


def test_a_run_without_a_command_holds_the_pose_and_gives_up(rig: Rig) -> None:
    rig.firmware.command(Stream())
    rig.run(1.95)
    assert rig.firmware.state is State.TRAJECTORY
    assert rig.firmware.snapshot.joint_position[ELBOW] == pytest.approx(STAND_POSITION[ELBOW], abs=0.02)
    rig.run(0.1)
    assert (rig.firmware.state, rig.firmware.joints.ended) == (State.DAMP, RunEnd.SILENT)


def test_a_command_runs_out_into_damp_within_a_millisecond(rig: Rig) -> None:
    rig.firmware.command(Stream())
    rig.send(ahead_s=0.033)
    rig.run(0.032)
    assert rig.firmware.state is State.TRAJECTORY
    rig.step()
    assert (rig.firmware.state, rig.firmware.joints.ended) == (State.DAMP, RunEnd.EXPIRED)
    assert AlertId.MODE_CHANGE in {alert.id for alert in rig.firmware.alerts.active}
    assert not rig.firmware.alerts.latched


def test_the_firmwares_own_silence_ends_a_run_where_it_is_asked_for(make_bench: Callable[..., Any]) -> None:
    rig = Rig(make_bench("hold", joint_control=JointControlConfig(silence_s=0.2)))
    rig.firmware.command(Stream())
    rig.send(ahead_s=5.0)
    rig.run(0.19)
    assert rig.firmware.joints.running
    rig.run(0.02)
    assert (rig.firmware.state, rig.firmware.joints.ended) == (State.DAMP, RunEnd.SILENT)


@pytest.mark.parametrize(
    ("command", "state"),
    [
        (Damp(), State.DAMP),
        (Stand(), State.STAND),
        (Velocity(0.1, 0.0, 0.0), State.POLICY),
        (Trajectory(STAND_POSITION), State.TRAJECTORY),
    ],
)
def test_any_other_command_ends_a_run(rig: Rig, command: Any, state: State) -> None:
    rig.firmware.command(Stream())
    rig.send(ahead_s=5.0)
    rig.run(0.02)
    rig.firmware.command(command)
    rig.run(0.02)
    assert (rig.firmware.state, rig.firmware.joints.running) == (state, False)
    assert rig.firmware.joints.ended is RunEnd.OVERRIDDEN
    assert not rig.firmware.joints.drives


def test_a_latched_fault_and_the_e_stop_end_a_run_and_refuse_the_next(rig: Rig) -> None:
    rig.firmware.command(Stream())
    rig.firmware.e_stop(True)
    assert (rig.firmware.state, rig.firmware.joints.ended) == (State.DAMP, RunEnd.STOPPED)
    assert rig.firmware.command(Stream()).outcome is Outcome.E_STOPPED
    rig.firmware.e_stop(False)
    assert rig.firmware.command(Stream()).outcome is Outcome.TAKEN
    rig.firmware.inject(AlertId.FALL_DETECTED)
    assert (rig.firmware.state, rig.firmware.joints.ended) == (State.DAMP, RunEnd.STOPPED)
    assert rig.firmware.command(Stream()).outcome is Outcome.LATCHED
    rig.firmware.restart()
    assert rig.firmware.command(Stream()).outcome is Outcome.TAKEN


def test_freeze_holds_the_pose_until_another_command(rig: Rig) -> None:
    rig.firmware.command(Stream())
    rig.send(1.2, ahead_s=5.0)
    rig.run(0.6)
    rig.firmware.command(Freeze())
    frozen = rig.firmware.snapshot.joint_position.copy()
    rig.run(3.0)
    assert rig.firmware.state is State.TRAJECTORY
    assert rig.firmware.joints.ended is RunEnd.OVERRIDDEN
    assert rig.firmware.snapshot.joint_position == pytest.approx(frozen, abs=0.05)
    rig.firmware.command(Damp())
    assert (rig.firmware.state, rig.firmware.joints.drives) == (State.DAMP, False)


# -- single commands -------------------------------------------------------------------------------


def test_commands_are_refused_by_their_times_and_gains(rig: Rig) -> None:
    assert rig.send(first=False) is Refusal.NO_GAINS
    assert rig.send(ahead_s=0.0) is Refusal.EXPIRED
    assert rig.send(ahead_s=-1.0) is Refusal.EXPIRED
    assert rig.send(ahead_s=10.001) is Refusal.TOO_DISTANT
    assert rig.send(ahead_s=10.0) is None
    assert rig.firmware.joints.received == 1


def test_gains_are_remembered_within_a_run_and_forgotten_after_it(rig: Rig) -> None:
    rig.firmware.command(Stream())
    assert rig.send() is None
    assert rig.send(first=False) is None
    rig.run(0.1)
    assert rig.firmware.joints.ended is RunEnd.EXPIRED
    assert rig.send(first=False) is Refusal.NO_GAINS


def test_a_refused_command_leaves_the_one_before_in_force(rig: Rig) -> None:
    rig.firmware.command(Stream())
    rig.send(0.4, ahead_s=0.1, key=7)
    assert rig.send(1.5, ahead_s=99.0, key=8) is Refusal.TOO_DISTANT
    rig.run(0.09)
    assert rig.firmware.joints.echo.key == 7
    assert rig.firmware.snapshot.joint_position[ELBOW] == pytest.approx(0.4, abs=0.02)


def test_an_absurd_velocity_of_one_joint_leaves_the_others_alone(rig: Rig) -> None:
    rig.firmware.command(Stream())
    velocity = ZERO.copy()
    velocity[ELBOW] = 1e30
    rig.send(ahead_s=5.0, velocity=velocity)
    rig.run(0.3)
    joints = rig.firmware.snapshot.joint_position
    assert joints[ELBOW] > 2.0, "it is driven to the end of its range"
    others = np.arange(25) != ELBOW
    assert joints[others] == pytest.approx(STAND_POSITION[others], abs=0.15)


def test_the_torque_is_that_of_the_law(rig: Rig) -> None:
    """Each sample's load is the law at the state of the sample before: nothing else drives the joint."""
    rig.firmware.command(Stream())
    load, velocity = ZERO.copy(), ZERO.copy()
    load[ELBOW], velocity[ELBOW] = 0.7, 0.3
    rig.send(0.45, ahead_s=5.0, load=load, velocity=velocity)
    rig.run(0.2)
    for _ in range(5):
        before = rig.firmware.joint_sample()
        rig.step()
        after = rig.firmware.joint_sample()
        wanted = 40.0 * (0.45 - before.position[ELBOW]) + 2.0 * (0.3 - before.velocity[ELBOW]) + 0.7
        assert abs(wanted) < EFFORT[ELBOW]
        assert after.load[ELBOW] == pytest.approx(wanted, abs=1e-9)


# -- the velocity limit ----------------------------------------------------------------------------


def test_a_joint_too_fast_is_a_fault_of_this_interface_only(rig: Rig) -> None:
    rig.firmware.command(Stream())
    rig.send(2.0, ahead_s=5.0, velocity_limit=1.0)
    rig.run(0.5)
    fault = rig.firmware.joints.fault
    assert rig.firmware.joints.ended is RunEnd.FAULT
    assert fault is not None
    assert (fault.number, fault.joint, fault.limit) == (1, "left_elbow_joint", 1.0)
    assert 1.0 < fault.speed < 1.5
    assert rig.firmware.state is State.DAMP
    assert (rig.firmware.alerts.latched, rig.firmware.alerts.error_flags) == (False, 0)
    assert rig.firmware.command(Stream()).outcome is Outcome.JOINT_FAULT
    assert rig.firmware.command(Stand()).outcome is Outcome.TAKEN, "the robot's own commands go on"
    assert rig.firmware.state is State.STAND
    assert not rig.firmware.joints.clear_fault(99)
    assert rig.firmware.joints.clear_fault(1)
    assert rig.firmware.command(Stream()).outcome is Outcome.TAKEN


def test_the_limit_holds_for_its_own_command_only(rig: Rig) -> None:
    rig.firmware.command(Stream())
    rig.send(0.41, ahead_s=5.0, velocity_limit=1.0)
    rig.run(0.01)
    rig.send(2.0, ahead_s=5.0)
    rig.run(0.3)
    assert rig.firmware.joints.fault is None
    assert rig.firmware.joints.running


def test_a_restart_clears_the_fault(rig: Rig) -> None:
    rig.firmware.command(Stream())
    rig.send(2.0, ahead_s=5.0, velocity_limit=0.5)
    rig.run(0.3)
    assert rig.firmware.joints.fault is not None
    rig.firmware.restart()
    assert rig.firmware.joints.fault is None


# -- 1 kHz -----------------------------------------------------------------------------------------


def test_five_fast_steps_are_one_control_step(held: Any) -> None:
    rig = Rig(held)
    rig.firmware.fast = True
    first = rig.firmware.ticks
    lengths = [rig.step() for _ in range(10)]
    assert lengths == [1000] * 10
    assert rig.firmware.ticks - first == 2
    assert rig.firmware.snapshot.timestamp_us == 10_000


def test_rates_change_between_control_steps_only(held: Any) -> None:
    rig = Rig(held)
    rig.firmware.fast = True
    rig.step()
    rig.firmware.fast = False
    assert [rig.step() for _ in range(4)] == [1000] * 4
    assert rig.step() == 5000
    assert rig.firmware.physics.model.opt.timestep == rig.firmware.physics.timestep == 0.005


def test_the_network_stays_at_50_hz(bench: Any, policy: Any) -> None:
    rig = Rig(bench)
    rig.firmware.command(Stand())
    rig.run(2.5)
    rig.firmware.command(Velocity(0.0, 0.0, 0.0))
    rig.run(0.1)
    rig.firmware.fast = True
    seen = len(policy.seen)
    rig.run(0.4)
    assert len(policy.seen) - seen == 20


@pytest.mark.parametrize("fast", [False, True])
def test_the_stand_ramp_keeps_its_time(held: Any, fast: bool) -> None:
    rig = Rig(held)
    rig.firmware.fast = fast
    rig.firmware.command(Stand())
    rig.run(1.0)
    assert rig.firmware.rising
    rig.run(1.0)
    assert not rig.firmware.rising


def test_a_robot_hanging_at_rest_feels_gravity_and_touches_nothing(rig: Rig) -> None:
    rig.run(1.0)
    sample = rig.firmware.joint_sample()
    down = projected_gravity(sample.base_quat)
    assert sample.specific_force == pytest.approx(-9.81 * down, abs=0.05)
    assert down[2] == pytest.approx(-1.0, abs=0.01)
    assert sample.contacts == (False, False)
    assert sample.time_us == rig.clock.realtime_us()


def test_a_stopped_imu_gives_no_acceleration(rig: Rig) -> None:
    rig.run(0.05)
    rig.firmware.faults.imu(1.0)
    rig.run(0.01)
    assert rig.firmware.joint_sample().specific_force is None


def test_figures_are_checked() -> None:
    with pytest.raises(ValueError, match=r"joint_control horizon_s must be between 0\.005 and 3600, got 0"):
        JointControlConfig(horizon_s=0)
    with pytest.raises(ValueError, match=r"joint_control kd_limit must be between 0 and 5, got 6"):
        replace(JointControlConfig(), kd_limit=6.0)
