"""RobotState of dialect `io` from a firmware state."""

from __future__ import annotations

from asimov_gym.edge.control import Dialect
from asimov_gym.edge.dialect import PROTOCOL_VERSION, RULES
from asimov_gym.edge.wire import io_pb2
from asimov_gym.firmware import FirmwareState, Mode

UINT32 = 2**32
_RULES = RULES[Dialect.IO]
_MODES = {
    Mode.DAMP: io_pb2.CONTROL_MODE_DAMP,
    Mode.STAND: io_pb2.CONTROL_MODE_STAND,
    Mode.MOVE: io_pb2.CONTROL_MODE_MOVE,
}


def robot_state(state: FirmwareState, last_command: int, alerts: bool) -> io_pb2.RobotState:
    """The message for one control step.

    Clock and counter are both the firmware's and restart with it, which is how a client notices a restart.

    Args:
        state: what the firmware reports.
        last_command: sequence of the last command taken in this dialect, 0 before the first.
        alerts: whether to carry the blocks of one frame in twenty: alerts, and with them buses and timing.
    """
    # In every frame: the public client takes a frame without a battery for a robot without one.
    battery = state.battery
    message = io_pb2.RobotState(
        timestamp_us=state.timestamp_us,
        sequence=state.tick % UINT32,
        current_mode=io_pb2.CONTROL_MODE_FAULT_DAMP if state.latched else _MODES[state.mode],
        joint_pos=_RULES.from_joint_order(state.motor_position).tolist(),
        joint_vel=_RULES.from_joint_order(state.motor_velocity).tolist(),
        joint_current=_RULES.from_joint_order(state.motor_current).tolist(),
        joint_temp=_RULES.from_joint_order(state.motor_temperature).tolist(),
        base_ang_vel=state.imu_gyro.tolist(),
        projected_gravity=state.imu_gravity.tolist(),
        base_quat=state.imu_quat.tolist(),
        error_flags=state.error_flags,
        last_cmd_sequence=last_command,
        protocol_version=PROTOCOL_VERSION,
        battery=io_pb2.BatteryState(
            voltage_v=battery.voltage_v,
            current_a=battery.current_a,
            soc_percent=battery.soc_percent,
            max_cell_temp_c=battery.max_cell_temp_c,
            protection_flags=battery.protection_flags,
        ),
        firmware_epoch_id=state.epoch,
    )
    if alerts:
        _add_slow_blocks(message, state)
    return message


def _add_slow_blocks(message: io_pb2.RobotState, state: FirmwareState) -> None:
    for alert in state.alerts:
        message.active_alerts.add(
            id=alert.id,
            severity=alert.id.severity,
            value=alert.value,
            threshold=alert.threshold,
            first_set_us=alert.first_set_us,
            source_id=alert.source,
        )
    for bus in state.can:
        message.can_health.add(
            frames_sent=bus.frames_sent,
            frames_received=bus.frames_received,
            errors=bus.errors,
            bus_offs=bus.bus_offs,
        )
    cycle, inference = state.cycle, state.inference
    message.policy_timing.max_cycle_us = cycle.max_us
    message.policy_timing.avg_cycle_us = cycle.avg_us
    message.policy_timing.jitter_us = cycle.jitter_us
    message.onnx_metrics.avg_inference_ms = inference.average_ms
    message.onnx_metrics.max_inference_ms = inference.max_ms
    message.onnx_metrics.inference_count = inference.count
