"""EdgeTelemetry from a firmware state: every field of the message."""

from __future__ import annotations

from dataclasses import dataclass

from asimov_gym.edge.wire import cloud_pb2
from asimov_gym.firmware import FirmwareState

UINT32 = 2**32


@dataclass(frozen=True)
class AppliedCommand:
    """Timing of the last command that the firmware took."""

    sequence: int
    """The sender's sequence number."""
    received_us: int
    """Edge wall clock when the packet came in."""
    processed_us: int
    """From there until the control step that acts on it, microseconds."""


@dataclass(frozen=True)
class MediaTimes:
    """Wall-clock times of the last media frames sent, microseconds; 0 when none was."""

    video_us: int = 0
    audio_us: int = 0


def telemetry(
    state: FirmwareState,
    sequence: int,
    now_us: int,
    age_us: int,
    applied: AppliedCommand | None,
    media: MediaTimes,
) -> cloud_pb2.EdgeTelemetry:
    """The message for one instant.

    Args:
        state: what the firmware reports.
        sequence: counter of these messages; wraps at 2^32.
        now_us: edge wall clock.
        age_us: age of the firmware's state.
        applied: the last command taken, None before the first.
        media: times of the last media frames.
    """
    message = cloud_pb2.EdgeTelemetry(
        timestamp_us=now_us,
        fw_timestamp_us=state.timestamp_us,
        sequence=sequence % UINT32,
        fw_mode=cloud_pb2.FirmwareMode.ValueType(state.mode.value),
        joint_pos=state.motor_position.tolist(),
        joint_vel=state.motor_velocity.tolist(),
        joint_current=state.motor_current.tolist(),
        joint_temp=state.motor_temperature.tolist(),
        imu_quat=state.imu_quat.tolist(),
        imu_gyro=state.imu_gyro.tolist(),
        imu_gravity=state.imu_gravity.tolist(),
        error_flags=state.error_flags,
        alert_count=len(state.alerts),
        active_alerts=[
            cloud_pb2.FirmwareAlert(
                id=alert.id,
                severity=alert.id.severity,
                value=alert.value,
                threshold=alert.threshold,
                first_set_us=alert.first_set_us,
                source_id=alert.source,
            )
            for alert in state.alerts
        ],
        fw_age_ms=max(0, age_us) // 1000,
        last_video_timestamp_us=media.video_us,
        last_audio_timestamp_us=media.audio_us,
    )
    if applied is not None:
        message.applied_cmd.seq = applied.sequence
        message.applied_cmd.recv_us = applied.received_us
        message.applied_cmd.proc_us = min(applied.processed_us, UINT32 - 1)
        message.applied_cmd.age_us = min(max(0, now_us - applied.received_us), UINT32 - 1)
    return message
