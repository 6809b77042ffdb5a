"""The robot's reports as EdgeTelemetry, whatever dialect and lane they came by, in order and each once."""

from __future__ import annotations

import time
from collections.abc import Sequence
from enum import Enum

import numpy as np
from google.protobuf.message import DecodeError

from asimov_gym.edge.control import Dialect
from asimov_gym.edge.dialect import PROTOCOL_VERSION, RULES
from asimov_gym.edge.telemetry import UINT32
from asimov_gym.edge.wire import cloud_pb2, io_pb2
from asimov_gym.robot.alerts import DAMP_LATCHED
from asimov_gym.robot.joints import JOINT_NAMES

REORDER_WINDOW = 1000
"""A sample at most this many numbers behind is a late one; further behind, the robot has started to count anew."""
CLOCK_RESET_US = 1_000_000
"""A firmware clock that went back by more than this is a restart too."""
ALERT_HOLD_S = 0.3
"""The robot sends its alerts with about every 20th RobotState only; for this long they stand for the frames between."""

MODES = {
    io_pb2.CONTROL_MODE_DAMP: cloud_pb2.FW_MODE_DAMP,
    io_pb2.CONTROL_MODE_STAND: cloud_pb2.FW_MODE_STAND,
    io_pb2.CONTROL_MODE_MOVE: cloud_pb2.FW_MODE_MOVE,
    io_pb2.CONTROL_MODE_FAULT_DAMP: cloud_pb2.FW_MODE_DAMP,
}
"""Modes of dialect `io` by those of the contract; FAULT_DAMP is DAMP with bit 0 of `error_flags`."""


def telemetry_from_robot_state(state: io_pb2.RobotState, edge_timestamp_us: int = 0) -> cloud_pb2.EdgeTelemetry:
    """A RobotState in the contract's words: same values, joint arrays in the contract's order.

    What RobotState does not carry stays 0: `timestamp_us` where the lane has no edge clock (UDP), `fw_age_ms`, the
    media times, and all of `applied_cmd` but its sequence number.

    Raises:
        ValueError: a version other than 1, joint arrays that are not 25 long, or an unknown mode.
    """
    if state.protocol_version != PROTOCOL_VERSION:
        raise ValueError(f"protocol_version must be {PROTOCOL_VERSION}, got {state.protocol_version}")
    if state.current_mode not in MODES:
        raise ValueError(f"current_mode must be one of {sorted(MODES)}, got {state.current_mode}")
    latched = DAMP_LATCHED if state.current_mode == io_pb2.CONTROL_MODE_FAULT_DAMP else 0
    message = cloud_pb2.EdgeTelemetry(
        timestamp_us=edge_timestamp_us,
        fw_timestamp_us=state.timestamp_us,
        sequence=state.sequence,
        fw_mode=MODES[state.current_mode],
        joint_pos=_joints("joint_pos", state.joint_pos),
        joint_vel=_joints("joint_vel", state.joint_vel),
        joint_current=_joints("joint_current", state.joint_current),
        joint_temp=_joints("joint_temp", state.joint_temp),
        imu_quat=state.base_quat,
        imu_gyro=state.base_ang_vel,
        imu_gravity=state.projected_gravity,
        error_flags=state.error_flags | latched,
        alert_count=len(state.active_alerts),
        active_alerts=[
            cloud_pb2.FirmwareAlert(
                id=alert.id,
                severity=alert.severity,
                value=alert.value,
                threshold=alert.threshold,
                first_set_us=alert.first_set_us,
                source_id=alert.source_id,
            )
            for alert in state.active_alerts
        ],
    )
    if state.last_cmd_sequence:
        message.applied_cmd.seq = state.last_cmd_sequence
    return message


def _joints(name: str, values: Sequence[float]) -> list[float]:
    if len(values) != len(JOINT_NAMES):
        raise ValueError(f"{name} must hold {len(JOINT_NAMES)} values, got {len(values)}")
    return RULES[Dialect.IO].to_joint_order(np.asarray(values)).tolist()


class Arrival(Enum):
    """Where a sample stands in the stream."""

    NEWER = "newer"
    RESTART = "restart"
    """The first sample after the robot's firmware has restarted."""
    DUPLICATE = "duplicate"
    LATE = "late"
    MALFORMED = "malformed"


class ReportReader:
    """Turns packets into telemetry, and tells which are worth having. Not for several threads at once."""

    def __init__(self, dialect: Dialect) -> None:
        self._dialect = dialect
        self._last: cloud_pb2.EdgeTelemetry | None = None
        self._alerts: list[cloud_pb2.FirmwareAlert] = []
        self._alerts_until = 0.0

    def read(self, packet: bytes, edge_timestamp_us: int = 0) -> tuple[cloud_pb2.EdgeTelemetry | None, Arrival]:
        """The sample in a packet; None where there is none that is new."""
        try:
            sample = self._decode(packet, edge_timestamp_us)
        except (DecodeError, ValueError):
            return None, Arrival.MALFORMED
        arrival = self._place(sample)
        if arrival not in (Arrival.NEWER, Arrival.RESTART):
            return None, arrival
        if self._dialect is Dialect.IO:
            self._carry_alerts(sample, restarted=arrival is Arrival.RESTART)
        self._last = sample
        return sample, arrival

    def _decode(self, packet: bytes, edge_timestamp_us: int) -> cloud_pb2.EdgeTelemetry:
        if self._dialect is Dialect.IO:
            return telemetry_from_robot_state(io_pb2.RobotState.FromString(packet), edge_timestamp_us)
        sample = cloud_pb2.EdgeTelemetry.FromString(packet)
        if len(sample.joint_pos) != len(JOINT_NAMES):
            raise ValueError(f"joint_pos must hold {len(JOINT_NAMES)} values, got {len(sample.joint_pos)}")
        return sample

    def _place(self, sample: cloud_pb2.EdgeTelemetry) -> Arrival:
        last = self._last
        if last is None:
            return Arrival.NEWER
        behind = (last.sequence - sample.sequence) % UINT32
        if behind == 0 and sample.fw_timestamp_us == last.fw_timestamp_us:
            return Arrival.DUPLICATE
        if last.fw_timestamp_us - sample.fw_timestamp_us > CLOCK_RESET_US:
            return Arrival.RESTART
        if not 0 < behind < UINT32 // 2:
            return Arrival.NEWER
        return Arrival.LATE if behind <= REORDER_WINDOW else Arrival.RESTART

    def _carry_alerts(self, sample: cloud_pb2.EdgeTelemetry, restarted: bool) -> None:
        now = time.monotonic()
        if sample.alert_count:
            self._alerts, self._alerts_until = list(sample.active_alerts), now + ALERT_HOLD_S
        elif restarted or now >= self._alerts_until:
            self._alerts = []
        else:
            sample.active_alerts.extend(self._alerts)
            sample.alert_count = len(self._alerts)
