"""EdgeDiagnostics from the running robot."""

from __future__ import annotations

from dataclasses import dataclass

from asimov_gym.edge.wire import cloud_pb2
from asimov_gym.firmware import Firmware


@dataclass
class LaneStatus:
    """What the diagnostics say of the lanes; set by the transports."""

    cloud_connected: bool = False
    """A room is joined."""
    camera_active: bool = False
    """Video frames are being sent."""
    mic_active: bool = False
    """Audio frames are being sent."""


def diagnostics(firmware: Firmware, controller: str, lanes: LaneStatus) -> cloud_pb2.EdgeEvent:
    """An `EdgeDiagnostics` event, not yet stamped. There is no Bluetooth on the simulated robot.

    Args:
        firmware: source of the counters.
        controller: name of the client in control, empty for none.
        lanes: state of room and media.
    """
    message = cloud_pb2.EdgeDiagnostics(
        controller=controller,
        provisioned=True,
        cloud_connected=lanes.cloud_connected,
        camera_active=lanes.camera_active,
        mic_active=lanes.mic_active,
    )
    state = firmware.snapshot
    for bus in state.can:
        message.can_health.add(
            frames_sent=bus.frames_sent,
            frames_received=bus.frames_received,
            errors=bus.errors,
            bus_offs=bus.bus_offs,
        )
    time = state.inference
    message.onnx_avg_ms, message.onnx_max_ms, message.onnx_count = time.average_ms, time.max_ms, time.count
    return cloud_pb2.EdgeEvent(diagnostics=message)
