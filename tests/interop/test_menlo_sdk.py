"""The robot's public Python client, `menlo-sdk` 0.1.0, unmodified and in a process of its own, against our UDP lane.

The tests marked slow are the checklist for a served robot, point by point. They run in real time and wait for what they
expect: a slow machine makes them longer, not wrong.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from asimov_gym.edge import Client, SimulatedRobot
from asimov_gym.edge.listener import EdgeListener
from asimov_gym.edge.transports.facts_server import FactsServer
from asimov_gym.edge.transports.udp import UdpLane
from asimov_gym.edge.verdict import DropReason, Verdict
from asimov_gym.edge.wire import io_pb2
from asimov_gym.firmware import State, WallClock
from tests.interop import sdk_environment

POLICY = Path(__file__).parents[2] / "assets" / "policies" / "asimov_walk.onnx"
DRIVER = Path(__file__).with_name("sdk_driver.py")
FALL_FLAGS = 0x101


class Sdk:
    """The client's process: one call at a time."""

    def __init__(self) -> None:
        # The client reads saved robots and limits from MENLO_ variables: those of whoever runs the tests stay out.
        environment = {name: value for name, value in os.environ.items() if not name.startswith("MENLO_")}
        self.process = subprocess.Popen(
            [sdk_environment.python(), DRIVER],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=environment,
        )

    def begin(self, call: str, **arguments: Any) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps({"call": call, "arguments": arguments}) + "\n")
        self.process.stdin.flush()

    def finish(self) -> dict[str, Any]:
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        assert line, "the client's process has died"
        return json.loads(line)

    def outcome(self, call: str, **arguments: Any) -> dict[str, Any]:
        """The reply, be it a result or an error."""
        self.begin(call, **arguments)
        return self.finish()

    def __call__(self, call: str, **arguments: Any) -> Any:
        """The result; an error fails the test."""
        reply = self.outcome(call, **arguments)
        assert "error" not in reply, f"{call}: {reply['error']}: {reply['message']}"
        return reply["result"]

    def kill(self) -> None:
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()

    def end(self) -> None:
        with contextlib.suppress(OSError):
            self.process.stdin.close()
        try:
            self.process.wait(5.0)
        except subprocess.TimeoutExpired:
            self.kill()
        self.process.stdout.close()


class Witness(EdgeListener):
    """What passes the robot's edge."""

    def __init__(self) -> None:
        self.commands: list[tuple[float, io_pb2.RobotCommand, Verdict]] = []

    def on_command(self, received_us: int, client: Client, packet: bytes, verdict: Verdict) -> None:
        with contextlib.suppress(Exception):
            self.commands.append((time.monotonic(), io_pb2.RobotCommand.FromString(packet), verdict))


class Bench:
    """A simulated robot in real time, served over UDP on ports of its own."""

    def __init__(self) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as reserved:
            reserved.bind(("127.0.0.1", 0))
            state_port = reserved.getsockname()[1]
        self.robot = SimulatedRobot(POLICY, clock=WallClock())
        self.lane = UdpLane(self.robot.edge, control_port=0, state_port=state_port)
        self.facts = FactsServer(port=0)
        self.witness = Witness()
        self.robot.edge.attach(self.witness)

    @property
    def ports(self) -> dict[str, Any]:
        return {
            "host": "127.0.0.1",
            "command_port": self.lane.control_port,
            "state_port": self.lane.state_port,
            "version_port": self.facts.port,
        }

    @property
    def state(self) -> State:
        return self.robot.firmware.state

    def since(self, moment: float) -> list[tuple[float, io_pb2.RobotCommand, Verdict]]:
        """Commands that came in after a moment of `time.monotonic`."""
        return [one for one in list(self.witness.commands) if one[0] >= moment]

    def until(self, condition: Callable[[], Any], timeout: float = 10.0) -> float:
        """Wait for something; the seconds it took."""
        began = time.monotonic()
        while not condition():
            assert time.monotonic() - began < timeout, f"not within {timeout} s; the robot is in {self.state.value}"
            time.sleep(0.005)
        return time.monotonic() - began

    def __enter__(self) -> Bench:
        self.robot.start()
        self.lane.start()
        self.facts.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self.facts.stop()
        self.lane.stop()
        self.robot.stop()


@contextlib.contextmanager
def served() -> Iterator[tuple[Bench, Sdk]]:
    with Bench() as bench:
        sdk = Sdk()
        try:
            yield bench, sdk
        finally:
            sdk.end()


@pytest.fixture(scope="module")
def environment() -> None:
    """The client's environment, made if need be (some ten seconds, once)."""
    reason = sdk_environment.make()
    if reason is not None:
        pytest.skip(reason)


def test_quick_round(environment: None) -> None:
    """Connect, stand, balance, walk a little, damp."""
    with served() as (bench, sdk):
        assert sdk("connect_udp", **bench.ports)["dof"] == 25
        sdk("stand")
        sdk("balance")
        sdk("set_velocity", vx=0.2, duration=0.5)
        assert bench.state is State.POLICY
        sdk("damp")
        sdk("close")
    assert bench.robot.edge.tally.dropped == {}


# -- the checklist ---------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def shared(environment: None) -> Iterator[tuple[Bench, Sdk]]:
    with served() as (bench, sdk):
        sdk("connect_udp", **bench.ports)
        yield bench, sdk


@pytest.fixture
def bench(shared: tuple[Bench, Sdk]) -> Iterator[Bench]:
    """The robot, in DAMP, without faults and with a connected client."""
    bench, sdk = shared
    sdk("damp")
    if bench.robot.firmware.snapshot.error_flags:
        restart(bench, sdk)
    yield bench


@pytest.fixture
def sdk(shared: tuple[Bench, Sdk]) -> Sdk:
    return shared[1]


def restart(bench: Bench, sdk: Sdk) -> None:
    bench.robot.firmware.faults.clear()
    bench.robot.restart()
    bench.until(lambda: not sdk("state")["faulted"])


@pytest.mark.slow
def test_point_1_facts_are_answered_and_accepted(environment: None) -> None:
    with served() as (bench, sdk):
        reply = sdk.outcome("connect_udp", **bench.ports)
        assert reply["result"]["dof"] == 25 and "battery" in reply["result"]["capabilities"]
        assert reply["seconds"] < 5.0
        sdk("close")
        bench.facts.stop()
        reply = sdk.outcome("connect_udp", **bench.ports)
        assert reply["error"] == "ConnectError"
        assert bench.since(0.0) == []  # and nothing was sent


@pytest.mark.slow
def test_point_2_state_comes_at_200_hz_and_whole(bench, sdk) -> None:
    sdk("stream")
    sdk("wait_for", seconds=2.0)
    stream = sdk("stream")
    times, sequences, clocks = (np.array(stream[name]) for name in ("times", "sequences", "clocks"))
    rate = (len(times) - 1) / (times[-1] - times[0])
    assert 100.0 < rate < 210.0  # 200 unless this machine is busy with something else
    assert np.diff(times).max() < 0.25
    assert (np.diff(sequences) >= 1).all() and (np.diff(clocks) > 0).all()
    assert stream["whole"]
    state = sdk("state")
    assert state["protocol_version"] == 1 and state["upright"]
    assert state["names"][23:] == ["Neck_Yaw", "Neck_Pitch"]
    assert all(20.0 < celsius < 60.0 for celsius in state["temperatures"])
    assert state["battery"] > 20.0


@pytest.mark.slow
def test_point_3_stand_is_reported_before_its_ramp_ends(bench, sdk) -> None:
    reply = sdk.outcome("stand")
    assert "error" not in reply
    assert 0.45 < reply["seconds"] < 2.0  # half a second of arming, not the two seconds of the ramp
    sent, reported = sdk("history")["modes"][-1]
    assert (sent, reported) == ("DAMP", "STAND")
    assert sdk("armed") is True


@pytest.mark.slow
def test_point_4_stand_balance_walk_balance_damp(bench, sdk) -> None:
    sdk("stand")
    sdk("balance")
    assert bench.state is State.POLICY
    began = time.monotonic()
    sdk("set_velocity", vx=0.3, duration=1.5)
    packets = [(at, command) for at, command, verdict in bench.since(began) if verdict.accepted]
    assert 14 <= len(packets) <= 17
    assert [round(command.policy.vx, 3) for _, command in packets] == [0.3] * (len(packets) - 1) + [0.0]
    bench.until(lambda: not bench.robot.firmware.snapshot.velocity.any())
    sdk("balance")
    sdk("wait_for", seconds=0.5)
    state = sdk("state")
    assert state["mode"] == "MOVE" and state["upright"] and not state["faulted"]
    sdk("damp")
    assert sdk("state")["mode"] == "DAMP"


@pytest.mark.slow
def test_point_5_velocity_without_standing_changes_nothing(bench, sdk) -> None:
    reply = sdk.outcome("balance")
    assert reply["error"] == "WaitTimeoutError" and "DAMP" in reply["message"]
    assert bench.state is State.DAMP
    dropped = bench.robot.edge.tally.dropped
    before = dropped[DropReason.NOT_ARMED]
    sdk("stand", wait=False)
    bench.until(lambda: bench.state is State.STAND)
    sdk("set_velocity", vx=0.2, wait=False, hold=False)
    bench.until(lambda: dropped[DropReason.NOT_ARMED] == before + 1)
    assert bench.state is State.STAND


@pytest.mark.slow
def test_point_6_joints_arrive_ankles_included_and_silence_ends_in_damp(bench, sdk) -> None:
    sdk("stand")
    bench.robot.firmware.gantry.by_hand("hoist")  # the client says it: joint control is for a robot that is supported
    sdk("wait_for", seconds=2.5)
    target = sdk("state")["positions"]
    names = sdk("state")["names"]
    for name, change in (("L_Shoulder_Pitch", 0.4), ("R_Elbow", -0.3), ("Neck_Yaw", 0.3), ("Neck_Pitch", -0.2)):
        target[names.index(name)] += change
    # The standing ankle pitch is 0.3 rad; both ankles to 0.15, in the motors' angles.
    for side, pitch in (("L", -0.15), ("R", 0.15)):
        target[names.index(f"{side}_Ankle_A")] = 2.02 * pitch
        target[names.index(f"{side}_Ankle_B")] = -2.02 * pitch
    sdk("set_joints", positions=target, duration=1.0, timeout=8.0)
    reached = np.array(sdk("state")["positions"])
    assert np.abs(reached - target).max() <= 0.06
    assert bench.state is State.TRAJECTORY
    # The neck that was asked to turn has turned: by name, not by place.
    joints = bench.robot.firmware.snapshot
    assert joints.motor_position[24] == pytest.approx(target[names.index("Neck_Yaw")], abs=0.06)
    sdk("trajectory", positions=target)  # ends the client's own stream: this one is not said again
    took = bench.until(lambda: bench.state is State.DAMP, timeout=6.0)
    assert 1.5 < took < 3.0
    bench.robot.firmware.gantry.by_hand("auto")


@pytest.mark.slow
def test_point_7_a_fall_latches_until_restart(bench, sdk) -> None:
    sdk("stand")
    bench.robot.firmware.faults.raise_alert("FALL_DETECTED")
    sdk("wait_for", seconds=0.2)
    state = sdk("state")
    assert state["mode"] in ("DAMP", "FAULT_DAMP") and state["faulted"]
    assert state["error_flags"] == FALL_FLAGS and "FALL_DETECTED" in state["alerts"]
    bench.robot.firmware.faults.clear()
    began = time.monotonic()
    while "FALL_DETECTED" in sdk("state")["alerts"]:
        assert time.monotonic() - began < 6.0
    assert 1.5 < time.monotonic() - began < 4.5
    reply = sdk.outcome("stand")
    assert reply["error"] == "RobotFaultedError" and "FALL_DETECTED" in reply["message"]
    assert sdk.outcome("set_velocity", vx=0.1, duration=0.3)["error"] == "RobotFaultedError"
    assert sdk("state")["error_flags"] == FALL_FLAGS and bench.state is State.DAMP
    restart(bench, sdk)
    sdk("stand")
    assert sdk("state")["mode"] == "STAND"


@pytest.mark.slow
def test_point_8_a_restart_is_noticed(bench, sdk) -> None:
    sdk("wait_for", seconds=1.2)  # the clock must go back by more than a second to show
    before = sdk("state")
    bench.robot.restart()
    bench.until(lambda: sdk("state")["fw_timestamp_us"] < before["fw_timestamp_us"])
    after = sdk("state")
    assert after["sequence"] < before["sequence"]
    assert any("the firmware restarted" in line for line in sdk("history")["log"])


@pytest.mark.slow
def test_point_9_bad_commands_change_nothing(bench, sdk) -> None:
    def command(**fields: Any) -> bytes:
        return io_pb2.RobotCommand(**({"protocol_version": 1, "sequence": 9} | fields)).SerializeToString()

    sdk("stand")
    tally = bench.robot.edge.tally
    before = tally.dropped.total()
    policy, targets = io_pb2.VelocityCommand, io_pb2.AllTrajectory
    packets = [
        command(mode=io_pb2.CONTROL_MODE_DAMP, protocol_version=2),
        command(mode=io_pb2.CONTROL_MODE_DAMP, protocol_version=0),
        command(mode=io_pb2.CONTROL_MODE_MOVE, policy=policy(vx=float("nan"))),
        command(mode=io_pb2.CONTROL_MODE_MOVE, all_trajectory=targets(positions=[0.0] * 24)),
        command(mode=io_pb2.CONTROL_MODE_MOVE, all_trajectory=targets(positions=[float("inf")] * 25)),
        command(mode=io_pb2.CONTROL_MODE_MOVE),
        b"",
        b"\xff" * 40,
    ]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        for packet in packets:
            other.sendto(packet, ("127.0.0.1", bench.lane.control_port))
        bench.until(lambda: tally.dropped.total() == before + len(packets))
        other.settimeout(0.2)
        with pytest.raises(TimeoutError):
            other.recv(100)
    assert sdk("state")["mode"] == "STAND"
    sdk("balance")  # the client is still in control


@pytest.mark.slow
def test_point_10_two_seconds_of_silence_on_either_side(environment: None) -> None:
    with served() as (bench, sdk):
        sdk("connect_udp", **bench.ports)
        sdk("stand")
        bench.robot.edge.detach(bench.lane)  # the robot's state no longer reaches the client
        sdk("wait_for", seconds=3.0)
        assert sdk.outcome("stand")["error"] == "LinkLostError"
        bench.robot.edge.attach(bench.lane)
        sdk("close")
        sdk("connect_udp", **bench.ports)
        sdk("stand")
        sdk("balance")
        sdk("set_velocity", vx=0.2, wait=False)
        bench.until(lambda: bench.robot.firmware.snapshot.velocity.any())
        sdk.kill()
        last = bench.since(0.0)[-1][0]
        bench.until(lambda: not bench.robot.firmware.snapshot.velocity.any(), timeout=5.0)
        assert 1.5 < time.monotonic() - last < 3.0
        assert bench.state is State.POLICY
