"""Half an hour of robot time in lockstep, with 1,000 commands a second from clients that come and go.

Rough stretches, in which the robot hangs, everybody may command and the bench operator breaks things, alternate with
walks, in which one client of higher rank walks the robot while the others go on talking. Afterwards nothing is missing
in the recording, and nothing has grown.
"""

from __future__ import annotations

import logging
import random
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from asimov_gym.assets import asset_path
from asimov_gym.edge import DropReason, SimulatedRobot, Source, connect
from asimov_gym.firmware import State
from asimov_gym.recording import COMMANDS, STATE, Recorder
from asimov_gym.robot.alerts import AlertId
from asimov_gym.robot.joints import MOTOR_NAMES
from tests.edge.crowd import Crowd
from tests.edge.witness import Witness, check_recording
from tests.footprint import Footprint, eventually, held_bytes

STEP_S = 0.005
PER_STEP = 5
"""Commands in each control step: 1,000 a second."""
WALK_S = 5.0
"""Of which the first three are for hanging still and standing up."""


class Soak:
    """A robot under load, and who watches it.

    Args:
        path: of the recording.
        seed: of everything that is left to chance.
    """

    def __init__(self, path: Path, seed: int) -> None:
        self.dice = random.Random(seed)
        self.robot = SimulatedRobot(asset_path("policies", "asimov_walk.onnx"), seed=seed)
        self.crowd = Crowd(self.robot, self.dice)
        self.recorder = Recorder(path, self.robot.edge, robot_state=True)
        self.witness = Witness()
        self.spoken = 0
        self.walked: list[float] = []
        """Metres, by walk."""
        self._operator = self._operations()

    @contextmanager
    def witnessed(self) -> Iterator[None]:
        """Let the witness hear everything, until the recording is finished."""
        log = logging.getLogger("asimov_gym")
        log.addHandler(self.witness)
        self.robot.edge.attach(self.witness)
        try:
            with self.recorder:
                yield
        finally:
            self.robot.edge.detach(self.witness)
            log.removeHandler(self.witness)

    def rough(self, seconds: float) -> None:
        """Hang, with everybody in command, and something broken every half second."""
        self.robot.firmware.gantry.by_hand("hoist")
        for step in range(round(seconds / STEP_S)):
            if step % 100 == 0:
                with self.robot.edge.lock:
                    self.dice.choice(self._operator)()
            self._step(may_damp=True)

    def walk(self) -> None:
        """Walk by the network, in the hands of a client that outranks the crowd."""
        robot = self.robot
        with robot.edge.lock:
            self._mend()
            robot.firmware.gantry.by_hand("auto")
            robot.firmware.hang()
            robot.restart()
        with connect(robot, "driver", Source.CONSOLE) as driver:
            for step in range(round(WALK_S / STEP_S)):
                if step == 0:
                    driver.stand()
                elif step % 100 == 0:
                    if step * STEP_S < 3.0:
                        driver.stand()
                    else:
                        driver.velocity(0.4)
                if step * STEP_S == 3.0:
                    start = self._place()
                self._step(may_damp=False)
            state = robot.firmware.snapshot
            assert state.state is State.POLICY, f"{state.state.value}, alerts {state.alerts}"
            assert state.imu_gravity[2] < -0.9, "the robot does not stand upright any more"
            self.walked.append(self._place() - start)

    def settle(self) -> None:
        """Send everybody away, and wait until the recorder has written what it heard."""
        self.crowd.leave()
        told = self.witness.heard.count
        eventually(lambda: self.recorder.written == told, "the recorder has caught up", timeout=60.0)

    @property
    def bytes_held(self) -> int:
        """By robot, firmware and edge; the recorder's own, which grow with the file's index, left out."""
        return held_bytes(self.robot, without=(self.recorder, self.witness))

    def _step(self, may_damp: bool) -> None:
        self.crowd.speak(PER_STEP, may_damp)
        self.spoken += PER_STEP
        self.robot.advance(STEP_S)

    def _place(self) -> float:
        return float(self.robot.physics.read().base_position[0, 0])

    def _mend(self) -> None:
        robot = self.robot
        robot.edge.e_stop(False)
        robot.firmware.faults.clear()
        robot.firmware.faults.battery(100.0)
        for motor in MOTOR_NAMES:
            robot.firmware.faults.heat(motor, 30.0)

    def _operations(self) -> list[Callable[[], object]]:
        robot, dice, faults = self.robot, self.dice, self.robot.firmware.faults

        def motor() -> str:
            return dice.choice(MOTOR_NAMES)

        def restart() -> None:
            self._mend()
            robot.restart()

        return [
            *[restart] * 6,  # often, for a fault that has latched is the end of all commands but DAMP
            lambda: robot.edge.e_stop(True),
            lambda: robot.edge.e_stop(False),
            lambda: faults.push([dice.uniform(-80, 80), dice.uniform(-80, 80), 0.0], 0.1),
            lambda: faults.heat(motor(), dice.choice((65.0, 90.0))),
            lambda: faults.drop_bus(dice.randrange(5), dice.choice((0.02, 0.2))),
            lambda: faults.drop_motor(motor(), 0.3),
            lambda: faults.encoder(motor(), 0.1),
            lambda: faults.overcurrent(motor(), 100.0, 0.2),
            lambda: faults.imu(dice.choice((0.05, 0.3))),
            lambda: faults.delay_policy(dice.choice((15.0, 100.0)), 0.4),
            lambda: faults.fail_policy(0.2),
            lambda: faults.battery(dice.choice((0.0, 5.0, 80.0))),
            lambda: faults.raise_alert(dice.choice(list(AlertId))),
            faults.clear,
        ]


def soak(path: Path, cycles: int, rough_s: float, warm_up: int = 1) -> tuple[Soak, float]:
    """Run `cycles` of a rough stretch and a walk. Gives the run, and the growth in MiB since the warm-up's cycles."""
    before = Footprint.now()
    run = Soak(path, seed=4)
    held, memory = 0, 0.0
    began = time.monotonic()
    with run.witnessed():
        listeners = run.robot.edge._listeners.all
        for cycle in range(cycles):
            run.rough(rough_s)
            run.walk()
            run.settle()
            assert run.robot.edge._listeners.all == listeners
            assert not run.robot.edge._order._clients
            if cycle < warm_up:
                held, memory = run.bytes_held, Footprint.now().memory_mib
            else:
                # Alerts, faults and counters differ between two moments; what grows shows after a few cycles.
                assert run.bytes_held < held + 50_000, f"grown in cycle {cycle}"
    took = time.monotonic() - began
    after = Footprint.now()
    tally = run.robot.edge.tally
    print(
        f"\n{run.robot.clock.now_us() / 1e6:.0f} s of robot time in {took:.0f} s; {tally.packets:,} commands of "
        f"{run.crowd.came} clients; recording {path.stat().st_size / 2**20:.0f} MiB; memory {before.memory_mib:.0f}, "
        f"{memory:.0f}, {after.memory_mib:.0f} MiB; held {held:,}, {run.bytes_held:,} bytes; walked "
        f"{min(run.walked):.2f} to {max(run.walked):.2f} m; {dict(run.witness.heard.count)}"
    )
    assert (after.threads, after.files) == (before.threads, before.files)
    check_load(run, cycles * (rough_s + WALK_S))
    check_recording(path, run.witness.heard)
    return run, after.memory_mib - memory


def check_load(run: Soak, seconds: float) -> None:
    """Assert that the load was what it should be, and that the robot took part."""
    tally, heard = run.robot.edge.tally, run.witness.heard.count
    assert run.spoken == 1000 * seconds
    assert heard[COMMANDS] == tally.packets >= run.spoken
    assert heard[STATE] == 10 * seconds
    assert min(run.walked) > 0.3
    assert all(tally.accepted[kind] > seconds for kind in ("velocity", "mode", "trajectory"))
    assert len(tally.dropped) >= 12
    assert {DropReason.NOT_IN_CONTROL, DropReason.FAULT_LATCHED, DropReason.STALE} < tally.dropped.keys()


def test_some_seconds_of_a_thousand_commands_a_second(tmp_path: Path) -> None:
    soak(tmp_path / "soak.mcap", cycles=2, rough_s=2.5)


def test_commands_do_not_pile_up_while_time_stands_still() -> None:
    robot = SimulatedRobot()
    with connect(robot, "hasty") as session:
        robot.advance(0.1)

        def after_stands(count: int) -> int:
            for _ in range(count):
                session.stand()
            return held_bytes(robot)

        assert after_stands(2000) < after_stands(10) + 1000


@pytest.mark.slow
def test_half_an_hour_of_a_thousand_commands_a_second(tmp_path: Path) -> None:
    path = tmp_path / "soak.mcap"
    _, growth_mib = soak(path, cycles=72, rough_s=20.0, warm_up=6)
    assert growth_mib < 32.0
    path.unlink()  # it is large
