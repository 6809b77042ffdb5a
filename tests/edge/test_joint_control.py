"""Joint control through its port, in lockstep and without any transport."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from asimov_gym.edge import Client, EdgeListener, SimulatedRobot, Source, Verdict, connect
from asimov_gym.edge.joint_control import JOINT_CLIENT, CommandStream, JointControlPort
from asimov_gym.edge.verdict import DropReason, Note
from asimov_gym.edge.wire import cloud_pb2
from asimov_gym.firmware import AlertId, JointCommand, JointGains, JointSample, RunEnd, State
from asimov_gym.policy import default_contract
from asimov_gym.recording import COMMANDS, SYSTEM, Recorder, read_recording
from asimov_gym.recording.robot_replay import replay_robot
from asimov_gym.recording.summary import summarize
from asimov_gym.robot.joints import KD, KP, STAND_POSITION, joint_index

GAINS = JointGains(KP.copy(), KD.copy())
ELBOW = joint_index("left_elbow_joint")


class StandInPolicy:
    """A network that answers zero, as the robot's here."""

    def __init__(self) -> None:
        self.contract = default_contract(command_ranges=((-0.6, 0.8), (-0.4, 0.4), (-0.8, 0.8)))

    def infer(self, observation: np.ndarray) -> np.ndarray:
        return np.zeros((len(observation), 23), dtype=np.float32)


class Witness(EdgeListener):
    """What the edge tells its listeners."""

    wants_robot_state = True

    def __init__(self) -> None:
        self.events: list[str] = []
        self.verdicts: list[str] = []
        self.telemetry = 0
        self.robot_states = 0

    def on_event(self, timestamp_us: int, packet: bytes) -> None:
        event = cloud_pb2.EdgeEvent.FromString(packet)
        if event.HasField("controller"):
            self.events.append(f"{event.controller.previous} -> {event.controller.current}")
        elif event.error.code == "joint_control":
            self.events.append(event.error.message)

    def on_command(self, received_us: int, client: Client, packet: bytes, verdict: Verdict) -> None:
        self.verdicts.append(f"{verdict.kind} {verdict}")

    def on_telemetry(self, timestamp_us: int, packet: bytes) -> None:
        self.telemetry += 1

    def on_robot_state(self, timestamp_us: int, packet: bytes, report: bool) -> None:
        self.robot_states += 1


@pytest.fixture
def witness(robot: SimulatedRobot) -> Witness:
    witness = Witness()
    robot.edge.attach(witness)
    return witness


@pytest.fixture
def port(robot: SimulatedRobot, witness: Witness) -> Iterator[JointControlPort]:
    with JointControlPort(robot.edge) as port:
        yield port


def command(robot: SimulatedRobot, angle: float = 0.4, ahead_s: float = 0.05, **fields: Any) -> JointCommand:
    position = STAND_POSITION.copy()
    position[ELBOW] = angle
    end_us = robot.clock.now_us() + round(ahead_s * 1e6)
    given = {"position": position, "velocity": np.zeros(25), "load": np.zeros(25), "gains": GAINS, "end_us": end_us}
    return JointCommand(**(given | fields))


def begin(robot: SimulatedRobot, port: JointControlPort, ahead_s: float = 5.0, **fields: Any) -> CommandStream:
    """A run with one command in force."""
    stream = port.open_stream()
    assert stream is not None
    assert stream.update(command(robot, ahead_s=ahead_s, **fields)).accepted
    assert port.begin().accepted
    robot.advance(0.01)
    return stream


# -- states ----------------------------------------------------------------------------------------


def test_states_come_at_333_hz_each_a_new_sample(robot: SimulatedRobot, port: JointControlPort) -> None:
    states: list[tuple[JointSample, ...]] = []
    port.subscribe(states.append)
    robot.advance(0.3)
    assert len(states) == 100
    assert all(len(samples) == 3 for samples in states)
    stamps = [sample.time_us for samples in states for sample in samples]
    assert np.diff(stamps).tolist() == [1000] * 299
    positions = {samples[-1].position.tobytes() for samples in states}
    assert len(positions) == 100


def test_other_rates_stay_while_the_physics_runs_at_1_khz(
    robot: SimulatedRobot, port: JointControlPort, witness: Witness
) -> None:
    port.subscribe(lambda samples: None)
    first = robot.firmware.ticks
    robot.advance(1.0)
    assert robot.physics.timestep == 0.001
    assert robot.firmware.ticks - first == 200
    assert (witness.telemetry, witness.robot_states) == (10, 200)


def test_the_physics_goes_back_to_its_step_when_all_is_closed(robot: SimulatedRobot, port: JointControlPort) -> None:
    states: list[tuple[JointSample, ...]] = []
    port.subscribe(states.append)
    robot.advance(0.05)
    stream = begin(robot, port, ahead_s=0.1)
    stream.close()
    port.unsubscribe(states.append)  # another object for the same method
    robot.advance(0.05)
    assert robot.physics.timestep == 0.001, "a run goes on to the end of its last command"
    robot.advance(0.1)
    assert robot.physics.model.opt.timestep == robot.physics.timestep == 0.005


def test_the_echo_names_the_last_command_taken(robot: SimulatedRobot, port: JointControlPort) -> None:
    states: list[tuple[JointSample, ...]] = []
    port.subscribe(states.append)
    robot.advance(0.03)
    assert states[-1][-1].echo.received_us == 0
    stream = begin(robot, port, key=41)
    received_us = robot.clock.realtime_us() - 10_000
    robot.advance(0.03)
    assert (states[-1][-1].echo.key, states[-1][-1].echo.received_us) == (41, received_us)
    stream.update(command(robot, key=42, ahead_s=99.0))
    robot.advance(0.03)
    assert states[-1][-1].echo.key == 41


def test_contact_advice_holds_while_its_command_does(robot: SimulatedRobot, port: JointControlPort) -> None:
    from asimov_gym.firmware import Advice

    port.stand()
    robot.advance(2.5)
    states: list[tuple[JointSample, ...]] = []
    port.subscribe(states.append)
    stream = begin(robot, port, ahead_s=0.5)
    assert states[-1][-1].contacts == (True, True)
    stream.update(command(robot, ahead_s=0.5, advice=(Advice.NOT_IN_CONTACT, Advice.NONE)))
    robot.advance(0.01)
    assert states[-1][-1].contacts == (False, True)
    stream.update(command(robot, ahead_s=0.5))
    robot.advance(0.01)
    assert states[-1][-1].contacts == (True, True)


def test_a_sinusoid_is_tracked(robot: SimulatedRobot, port: JointControlPort) -> None:
    states: list[tuple[JointSample, ...]] = []
    port.subscribe(states.append)
    stream = begin(robot, port, angle=0.4)
    start, errors = robot.clock.now_us(), []
    stiff = JointGains(KP * 2.5, KD)
    for _ in range(200):
        t = (robot.clock.now_us() - start) * 1e-6
        velocity = np.zeros(25)
        velocity[ELBOW] = 0.4 * np.pi * np.cos(2.0 * np.pi * t)
        angle = 0.6 + 0.2 * np.sin(2.0 * np.pi * t)
        stream.update(command(robot, angle, gains=stiff, velocity=velocity, extrapolation_us=5_000))
        robot.advance(0.01)
        t += 0.01
        errors.append(states[-1][-1].position[ELBOW] - (0.6 + 0.2 * np.sin(2.0 * np.pi * t)))
    assert np.abs(errors[50:]).max() < 0.03


def test_the_same_commands_give_the_same_states() -> None:
    def states() -> list[bytes]:
        robot, found = SimulatedRobot(), []
        with JointControlPort(robot.edge) as port:
            port.subscribe(lambda samples: found.append(samples[-1].position.tobytes() + samples[-1].load.tobytes()))
            stream = begin(robot, port)
            for step in range(20):
                stream.update(command(robot, 0.4 + 0.02 * step))
                robot.advance(0.01)
        return found

    assert states() == states()


# -- streams ---------------------------------------------------------------------------------------


def test_commands_may_come_before_the_run_but_not_for_ever(robot: SimulatedRobot, port: JointControlPort) -> None:
    stream = port.open_stream()
    assert stream is not None
    verdict = stream.update(command(robot))
    assert (verdict.reason, verdict.notes) == (None, (Note.JOINT_WAITING,))
    assert robot.edge.control.holder is None, "a stream without a run takes no control"
    robot.advance(1.9)
    assert stream.update(command(robot)).accepted
    robot.advance(0.1)
    assert stream.update(command(robot)).reason is DropReason.JOINT_INACTIVE


def test_a_second_stream_is_refused_and_the_first_goes_on(robot: SimulatedRobot, port: JointControlPort) -> None:
    stream = begin(robot, port)
    assert port.open_stream() is None
    assert stream.update(command(robot)).accepted
    stream.close()
    assert port.open_stream() is not None


def test_a_stream_learns_that_its_command_ran_out_with_the_next_one(
    robot: SimulatedRobot, port: JointControlPort
) -> None:
    stream = begin(robot, port, ahead_s=0.05)
    robot.advance(0.05)
    assert robot.firmware.state is State.DAMP
    assert stream.update(command(robot)).reason is DropReason.JOINT_INACTIVE


def test_a_new_stream_continues_a_run_with_its_gains(robot: SimulatedRobot, port: JointControlPort) -> None:
    begin(robot, port, ahead_s=1.0).close()
    stream = port.open_stream()
    assert stream is not None
    assert stream.update(command(robot, gains=None)).accepted
    robot.advance(0.04)
    assert robot.firmware.joints.running


def test_gains_of_a_stream_that_never_got_its_run_are_forgotten(robot: SimulatedRobot, port: JointControlPort) -> None:
    first = port.open_stream()
    assert first is not None
    first.update(command(robot))
    first.close()
    second = port.open_stream()
    assert second is not None
    assert second.update(command(robot, gains=None)).reason is DropReason.JOINT_NO_GAINS


def test_times_and_gains_that_are_refused_are_told_apart(robot: SimulatedRobot, port: JointControlPort) -> None:
    stream = begin(robot, port)
    for ahead_s, reason in ((-0.01, DropReason.JOINT_EXPIRED), (10.1, DropReason.JOINT_TOO_DISTANT)):
        assert stream.update(command(robot, ahead_s=ahead_s)).reason is reason
    stream.refuse(b"rubbish")
    assert robot.edge.tally.dropped[DropReason.JOINT_INVALID] == 1


def test_what_was_clamped_is_noted(robot: SimulatedRobot, port: JointControlPort) -> None:
    stream = begin(robot, port)
    hard = JointGains(np.full(25, 936.0), np.full(25, 5.2))
    verdict = stream.update(command(robot, 9.0, gains=hard, load=np.full(25, 500.0)))
    assert set(verdict.notes) == {Note.POSITION_CLAMPED, Note.LOAD_CLAMPED, Note.GAIN_CLAMPED}


# -- one controller at a time ----------------------------------------------------------------------


def test_control_is_handed_over_and_damp_wins_over_all(
    robot: SimulatedRobot, port: JointControlPort, witness: Witness
) -> None:
    """The robot's own interface takes the robot out of a run; a lower rank cannot; DAMP of anybody can."""
    port.stand()
    robot.advance(2.5)
    ended: list[RunEnd] = []
    stream = port.open_stream(ended.append)
    assert stream is not None
    stream.update(command(robot, ahead_s=5.0))
    port.begin()
    robot.advance(0.02)
    assert robot.edge.control.holder == JOINT_CLIENT

    below = Client(Source.MOTION_MODES, "below")
    stand = cloud_pb2.CloudCommand(mode=cloud_pb2.ModeCommand(mode=cloud_pb2.MODE_STAND)).SerializeToString()
    damp = cloud_pb2.CloudCommand(mode=cloud_pb2.ModeCommand(mode=cloud_pb2.MODE_DAMP)).SerializeToString()
    assert robot.edge.receive(stand, below).reason is DropReason.NOT_IN_CONTROL
    assert robot.firmware.joints.running

    with connect(robot, "operator") as operator:
        operator.stand()
        robot.advance(0.02)
        assert (robot.firmware.state, ended) == (State.STAND, [RunEnd.OVERRIDDEN])
        assert stream.update(command(robot)).reason is DropReason.JOINT_INACTIVE
        assert port.begin().reason is DropReason.NOT_IN_CONTROL
    stream.close()

    stream = begin(robot, port)
    assert robot.edge.receive(damp, below).accepted
    assert (robot.firmware.state, robot.firmware.joints.ended) == (State.DAMP, RunEnd.OVERRIDDEN)
    assert robot.edge.control.holder == JOINT_CLIENT, "DAMP takes no control away"
    robot.advance(0.01)
    handovers = [event for event in witness.events if " -> " in event]
    assert handovers == [
        " -> joint-control",
        "joint-control -> operator",
        "operator -> ",
        " -> joint-control",
    ]


def test_a_run_of_the_port_ends_with_it(robot: SimulatedRobot, witness: Witness) -> None:
    with JointControlPort(robot.edge) as port:
        begin(robot, port)
    assert robot.firmware.state is State.DAMP
    assert robot.edge.control.holder is None
    robot.advance(0.05)
    assert robot.physics.timestep == 0.005


# -- the fault -------------------------------------------------------------------------------------


def test_a_joint_too_fast_ends_run_and_stream_until_the_fault_is_cleared(
    robot: SimulatedRobot, port: JointControlPort, witness: Witness
) -> None:
    ended: list[RunEnd] = []
    stream = port.open_stream(ended.append)
    assert stream is not None
    stream.update(command(robot, 2.0, ahead_s=5.0, velocity_limit=1.0))
    port.begin()
    robot.advance(0.5)
    fault = robot.firmware.joints.fault
    assert fault is not None
    assert ended == [RunEnd.FAULT]
    assert robot.firmware.state is State.DAMP
    stream.close()
    assert port.begin().reason is DropReason.JOINT_FAULT
    assert port.clear_fault(fault.number + 1).reason is DropReason.JOINT_FAULT
    assert port.clear_fault(fault.number).accepted
    begin(robot, port)
    told = [event for event in witness.events if " -> " not in event]
    assert told[0] == "run 1 began"
    assert told[1].startswith("fault 1: left_elbow_joint at 1.")
    assert told[2:] == [
        "run 1 ended: a joint was faster than the joint command allows",
        "fault 1 cleared",
        "run 2 began",
    ]


def test_powering_off_clears_the_fault(robot: SimulatedRobot, port: JointControlPort) -> None:
    begin(robot, port, angle=2.0, velocity_limit=1.0).close()
    robot.advance(0.5)
    assert robot.firmware.joints.fault is not None
    assert port.power_off().accepted
    assert robot.firmware.joints.fault is None
    assert port.begin().accepted


def test_a_latched_alert_is_not_cleared_here(robot: SimulatedRobot, port: JointControlPort) -> None:
    robot.firmware.faults.raise_alert(AlertId.FALL_DETECTED)
    assert port.begin().reason is DropReason.FAULT_LATCHED
    port.power_off()
    assert port.begin().reason is DropReason.FAULT_LATCHED
    robot.restart()
    assert port.begin().accepted


# -- recording -------------------------------------------------------------------------------------


def test_a_recording_holds_every_command_with_its_verdict_and_every_event(
    robot: SimulatedRobot, port: JointControlPort, tmp_path: Path
) -> None:
    path = tmp_path / "joints.mcap"
    with Recorder(path, robot.edge):
        stream = begin(robot, port, ahead_s=0.05)
        assert stream.update(command(robot, ahead_s=-1.0), b"late").reason is DropReason.JOINT_EXPIRED
        robot.advance(0.1)
        stream.refuse(b"rubbish")
    commands: list[Any] = [entry.message for entry in read_recording(path, [COMMANDS])]
    assert [(c.client, c.source, c.kind, c.verdict, c.payload) for c in commands] == [
        ("joint-control", "JOINT_CONTROL", "joint_command", "accepted", b""),
        ("joint-control", "JOINT_CONTROL", "joint_start", "accepted", b""),
        ("joint-control", "JOINT_CONTROL", "joint_command", "JOINT_EXPIRED", b"late"),
        ("joint-control", "JOINT_CONTROL", "joint_command", "JOINT_INVALID", b"rubbish"),
    ]
    events: list[Any] = [entry.message for entry in read_recording(path, [SYSTEM])]
    told = [event.error.message for event in events if event.error.code == "joint_control"]
    assert told == ["run 1 began", "run 1 ended: the last joint command ran out"]
    assert summarize(path).commands[("joint-control", "joint_command", "accepted")] == 1
    replay = replay_robot(path, StandInPolicy())
    assert (replay.commands, replay.identical) == (0, False)
    assert "joint control: its messages are not sent again" in replay.left_out
