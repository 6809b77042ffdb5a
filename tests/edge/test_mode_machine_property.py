"""Random commands, times and faults against an independent model of the interface's table."""

from __future__ import annotations

import math

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule, run_state_machine_as_test

from asimov_gym.edge import Client, Dialect, SimulatedRobot, Source, Verdict
from asimov_gym.edge.wire import cloud_pb2, io_pb2
from asimov_gym.firmware import AlertId, Severity
from asimov_gym.robot.joints import STAND_POSITION
from tests.edge.conftest import StandInPolicy
from tests.edge.mode_model import ModeModel

SOURCES = {
    "console": (Source.CONSOLE, (Dialect.CLOUD,)),
    "process": (Source.IN_PROCESS, (Dialect.CLOUD,)),
    "udp": (Source.UDP, (Dialect.IO,)),
    "room": (Source.LIVEKIT, (Dialect.CLOUD, Dialect.IO)),
}
CLIENTS = {name: Client(source, name, dialects) for name, (source, dialects) in SOURCES.items()}
CLOUD_SENDERS = [name for name, client in CLIENTS.items() if Dialect.CLOUD in client.dialects]
IO_SENDERS = [name for name, client in CLIENTS.items() if Dialect.IO in client.dialects]
CRITICAL = [alert for alert in AlertId if alert.severity is Severity.CRITICAL]
HARMLESS = [alert for alert in AlertId if alert.severity is not Severity.CRITICAL]
TARGETS = STAND_POSITION.tolist()
BAD_TRAJECTORIES = [
    cloud_pb2.TrajectoryRequest(),
    cloud_pb2.TrajectoryRequest(id="wave"),
    cloud_pb2.TrajectoryRequest(full=cloud_pb2.FullTrajectory()),
    cloud_pb2.TrajectoryRequest(full={"segments": [{"positions": [0.0] * 24}]}),
    cloud_pb2.TrajectoryRequest(full={"segments": [{"positions": [0.0] * 24 + [math.nan]}]}),
    cloud_pb2.TrajectoryRequest(full={"segments": [{"positions": [0.0] * 25}, {"positions": [0.0] * 3}]}),
]


class ModeMachine(RuleBasedStateMachine):
    """One robot on a taut rope, four clients, and the model."""

    steps = 0
    """Rules run so far, over all examples."""
    robot: SimulatedRobot

    @initialize()
    def boot(self) -> None:
        self.robot = self.spare or SimulatedRobot(StandInPolicy(), gantry="hold")
        type(self).spare = self.robot
        for client in CLIENTS.values():
            self.robot.edge.leave(client)
        self.robot.edge.e_stop(True)
        self.robot.edge.e_stop(False)
        self.robot.firmware.hang()
        self.robot.restart()
        self.robot.advance(0.005)
        self.model = ModeModel(now_ms=5)
        self.dropped = self.robot.edge.tally.dropped.total()

    spare: SimulatedRobot | None = None
    """Building the physics anew for each example would cost more than all its steps."""

    def _send_cloud(self, client: str, **fields: object) -> Verdict:
        packet = cloud_pb2.CloudCommand(**fields).SerializeToString()  # type: ignore[arg-type]
        return self.robot.edge.receive(packet, CLIENTS[client])

    def _send_io(self, client: str, **fields: object) -> Verdict:
        packet = io_pb2.RobotCommand(**({"protocol_version": 1} | fields)).SerializeToString()  # type: ignore[arg-type]
        return self.robot.edge.receive(packet, CLIENTS[client])

    def _expect(self, verdict: Verdict, taken: bool) -> None:
        assert verdict.accepted == taken, f"{verdict} ({verdict.kind}), the model says taken={taken}"
        self.dropped += not taken

    # -- time and faults -------------------------------------------------------------------------

    @rule(steps=st.sampled_from([1, 1, 2, 5, 39, 40, 41, 101]))
    def time_passes(self, steps: int) -> None:
        for _ in range(steps):
            self.robot.advance(0.005)
            self.model.step()
        assert self.robot.firmware.snapshot.velocity[0] == pytest.approx(self.model.velocity)

    @rule(steps=st.sampled_from([400, 401]))
    def two_seconds_pass(self, steps: int) -> None:
        self.time_passes(steps)

    @rule(alert=st.sampled_from(CRITICAL))
    def critical_alert(self, alert: AlertId) -> None:
        self.robot.firmware.inject(alert)
        self.model.fault()

    @rule(alert=st.sampled_from(HARMLESS))
    def harmless_alert(self, alert: AlertId) -> None:
        self.robot.firmware.inject(alert)

    @rule()
    def restart(self) -> None:
        self.robot.restart()
        self.model.restart()

    @rule(pressed=st.booleans())
    def e_stop(self, pressed: bool) -> None:
        if pressed != self.model.e_stop:
            self.robot.edge.e_stop(pressed)
            self.model.press(pressed)

    @rule(client=st.sampled_from(list(CLIENTS)))
    def leaves(self, client: str) -> None:
        self.robot.edge.leave(CLIENTS[client])
        self.model.leave(client)

    # -- commands --------------------------------------------------------------------------------

    @rule(client=st.sampled_from(CLOUD_SENDERS))
    def cloud_damp(self, client: str) -> None:
        self._expect(self._send_cloud(client, mode=cloud_pb2.ModeCommand(mode=cloud_pb2.MODE_DAMP)), True)
        self.model.damp(client)

    @rule(client=st.sampled_from(CLOUD_SENDERS))
    def cloud_stand(self, client: str) -> None:
        taken = self.model.command(client, "cloud", "stand")
        self._expect(self._send_cloud(client, mode=cloud_pb2.ModeCommand()), taken)

    @rule(client=st.sampled_from(CLOUD_SENDERS), vx=st.sampled_from([0.0, 0.25, 0.5]))
    def cloud_velocity(self, client: str, vx: float) -> None:
        taken = self.model.command(client, "cloud", "velocity", vx)
        self._expect(self._send_cloud(client, velocity=cloud_pb2.VelocityCommand(vx=vx)), taken)

    @rule(client=st.sampled_from(CLOUD_SENDERS))
    def cloud_trajectory(self, client: str) -> None:
        taken = self.model.command(client, "cloud", "trajectory")
        motors = self.robot.firmware.snapshot.motor_position.tolist()
        request = cloud_pb2.TrajectoryRequest(full={"segments": [{"positions": motors}]})
        self._expect(self._send_cloud(client, trajectory=request), taken)

    @rule(client=st.sampled_from(IO_SENDERS))
    def io_damp(self, client: str) -> None:
        self._expect(self._send_io(client, mode=io_pb2.CONTROL_MODE_DAMP), True)
        self.model.damp(client)

    @rule(client=st.sampled_from(IO_SENDERS))
    def io_stand(self, client: str) -> None:
        taken = self.model.command(client, "io", "stand")
        self._expect(self._send_io(client, mode=io_pb2.CONTROL_MODE_STAND), taken)

    @rule(client=st.sampled_from(IO_SENDERS), vx=st.sampled_from([0.0, 0.25]))
    def io_velocity(self, client: str, vx: float) -> None:
        taken = self.model.command(client, "io", "velocity", vx)
        self._expect(self._send_io(client, mode=2, policy=io_pb2.VelocityCommand(vx=vx)), taken)

    @rule(client=st.sampled_from(IO_SENDERS))
    def io_trajectory(self, client: str) -> None:
        taken = self.model.command(client, "io", "trajectory")
        targets = io_pb2.AllTrajectory(positions=TARGETS)
        self._expect(self._send_io(client, mode=2, command_control=1, all_trajectory=targets), taken)

    # -- what must change nothing ----------------------------------------------------------------

    @rule(client=st.sampled_from(CLOUD_SENDERS), bad=st.sampled_from([math.nan, math.inf, -math.inf]))
    def velocity_not_finite(self, client: str, bad: float) -> None:
        self._expect(self._send_cloud(client, velocity=cloud_pb2.VelocityCommand(vyaw=bad)), False)

    @rule(client=st.sampled_from(CLOUD_SENDERS), request=st.sampled_from(BAD_TRAJECTORIES))
    def bad_trajectory(self, client: str, request: cloud_pb2.TrajectoryRequest) -> None:
        self._expect(self._send_cloud(client, trajectory=request), False)

    @rule(client=st.sampled_from(CLOUD_SENDERS), mode=st.integers(2, 40))
    def unknown_mode(self, client: str, mode: int) -> None:
        self._expect(self._send_cloud(client, mode=cloud_pb2.ModeCommand(mode=mode)), False)  # type: ignore[arg-type]

    @rule(version=st.sampled_from([0, 2, 2**32 - 1]), mode=st.integers(0, 5))
    def wrong_version(self, version: int, mode: int) -> None:
        self._expect(self._send_io("udp", protocol_version=version, mode=mode), False)

    @rule(client=st.sampled_from(list(CLIENTS)), packet=st.binary(max_size=12).map(lambda tail: b"\xff" + tail))
    def garbage(self, client: str, packet: bytes) -> None:
        # 0xff opens a tag whose wire type, 7, does not exist.
        self._expect(self.robot.edge.receive(packet, CLIENTS[client]), False)

    # -- what must hold --------------------------------------------------------------------------

    @invariant()
    def agrees(self) -> None:
        if not hasattr(self, "model"):
            return
        type(self).steps += 1
        firmware = self.robot.firmware
        assert firmware.state.value == self.model.mode
        assert firmware.alerts.latched == self.model.latched
        holder = self.robot.edge.control.holder
        assert (None if holder is None else holder.name) == self.model.holder
        assert self.robot.edge.tally.dropped.total() == self.dropped


def run(steps: int) -> int:
    """Run until at least `steps` rules were checked; returns how many."""
    ModeMachine.steps = 0
    while ModeMachine.steps < steps:
        run_state_machine_as_test(
            ModeMachine,
            settings=settings(
                max_examples=max(5, steps // 100),
                stateful_step_count=100,
                deadline=None,
                database=None,
                suppress_health_check=list(HealthCheck),
            ),
        )
    return ModeMachine.steps


def test_a_thousand_random_steps_follow_the_table() -> None:
    assert run(1000) >= 1000


@pytest.mark.slow
def test_a_hundred_thousand_random_steps_follow_the_table() -> None:
    assert run(100_000) >= 100_000
