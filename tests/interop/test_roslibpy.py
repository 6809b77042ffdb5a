"""The genuine roslibpy against the rosbridge lane, beside the robot's own interface."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

pytest.importorskip("websockets", reason="needs websockets: pip install 'asimov-gym[rosbridge]'")

from asimov_gym.edge import SimulatedRobot, connect
from asimov_gym.edge.motion_modes import MotionMode
from asimov_gym.edge.motion_modes_messages import SET_INPUT, McInputAction, McInputSource, SetMcInputSourceRequest
from asimov_gym.edge.motion_modes_service import CLIENT, MotionModes
from asimov_gym.edge.transports.rosbridge import RosbridgeLane
from asimov_gym.firmware import Stand, State, Velocity, WallClock
from tests.edge.conftest import StandInPolicy

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("roslibpy") is None, reason="needs roslibpy, of the extra `test`"
)
SCRIPT = Path(__file__).with_name("roslibpy_client.py")


class Bench:
    """A robot in real time with a rosbridge lane."""

    def __init__(self) -> None:
        self.robot = SimulatedRobot(StandInPolicy(), WallClock())
        self.modes = MotionModes(self.robot.edge)
        self.lane = RosbridgeLane(self.robot.edge, self.modes, port=0)

    def client(self, what: str) -> subprocess.Popen[str]:
        command = [sys.executable, str(SCRIPT), str(self.lane.port), what]
        return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

    def run(self, what: str) -> str:
        with self.client(what) as process:
            out, err = process.communicate(timeout=60)
        assert process.returncode == 0, out + err
        return out

    def stand(self) -> None:
        """Bring the robot to balance without waiting for it."""
        with self.robot.edge.lock:
            self.robot.firmware.command(Stand())
            self.robot.firmware.command(Velocity(0.0, 0.0, 0.0))
        assert self.modes.mode is MotionMode.STAND


@pytest.fixture
def bench() -> Iterator[Bench]:
    bench = Bench()
    with bench.modes, bench.lane, bench.robot:
        yield bench


def until(condition: Callable[[], bool], seconds: float = 10.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not come about"
        time.sleep(0.01)


@pytest.mark.slow
def test_through_the_modes(bench: Bench) -> None:
    slowest = float(bench.run("calls").split()[-1])
    assert slowest < 0.25
    assert bench.modes.mode is MotionMode.DAMPING


def test_killed_as_it_walks_and_taken_over(bench: Bench) -> None:
    request = SetMcInputSourceRequest(action=McInputAction(1001), input_source=McInputSource("node", 40, 500))
    assert bench.modes.call(SET_INPUT, request).response.header.code == 0
    bench.stand()
    edge, firmware = bench.robot.edge, bench.robot.firmware
    with bench.client("walk") as walker, connect(bench.robot, "operator") as operator:
        until(lambda: bench.modes.mode is MotionMode.LOCOMOTION)
        assert edge.control.holder == CLIENT

        # The robot's own interface takes over, motion modes go on publishing in vain.
        operator.velocity(0.0, 0.0, 0.2)
        until(lambda: firmware.velocity[2] > 0.1)
        dropped = edge.tally.dropped.total()
        until(lambda: edge.tally.dropped.total() > dropped + 5)
        assert firmware.velocity.tolist() == pytest.approx([0.0, 0.0, 0.2])
        assert edge.control.holder is not None and edge.control.holder.name == "operator"

        # It leaves, and they walk on.
        operator.close()
        until(lambda: edge.control.holder == CLIENT and firmware.velocity[0] > 0.2)

        # Killed: no close frame, no farewell. The robot stops when its source has been silent too long.
        walker.kill()
        until(lambda: not firmware.velocity.any())
        until(lambda: bench.lane.clients == 0)
        assert firmware.state is State.POLICY and bench.modes.mode is MotionMode.STAND

    # Whoever is in control: going limp is everybody's, over the foreign interface too.
    with connect(bench.robot, "operator") as operator:
        operator.velocity(0.1, 0.0, 0.0)
        until(lambda: firmware.velocity[0] > 0.05)
        bench.run("DAMPING_DEFAULT")
        assert firmware.state is State.DAMP and edge.control.holder.name == "operator"
