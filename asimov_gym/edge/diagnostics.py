"""EdgeDiagnostics from the running robot."""

from __future__ import annotations

from asimov_gym.edge.wire import cloud_pb2
from asimov_gym.firmware import Firmware
from asimov_gym.robot.joints import MOTOR_NAMES

BUSES: tuple[tuple[str, ...], ...] = (
    tuple(name for name in MOTOR_NAMES[:12] if name.startswith("L_")),
    tuple(name for name in MOTOR_NAMES[:12] if name.startswith("R_")),
    tuple(name for name in MOTOR_NAMES[12:22] if name.startswith("L_")),
    tuple(name for name in MOTOR_NAMES[12:22] if name.startswith("R_")),
    MOTOR_NAMES[22:],
)
"""Motors on each CAN bus: left leg, right leg, left arm, right arm, waist and neck."""


def diagnostics(firmware: Firmware, controller: str) -> cloud_pb2.EdgeEvent:
    """An `EdgeDiagnostics` event, not yet stamped.

    The simulated buses carry one command and one answer for each motor and tick, and lose nothing. There is no cloud,
    no Bluetooth, camera or microphone in this process.

    Args:
        firmware: source of the counters.
        controller: name of the client in control, empty for none.
    """
    message = cloud_pb2.EdgeDiagnostics(controller=controller, provisioned=True)
    for motors in BUSES:
        frames = firmware.ticks * len(motors)
        message.can_health.add(frames_sent=frames, frames_received=frames)
    if firmware.policy is not None:
        time = firmware.policy.time
        message.onnx_avg_ms, message.onnx_max_ms, message.onnx_count = time.average_ms, time.max_ms, time.count
    return cloud_pb2.EdgeEvent(diagnostics=message)
