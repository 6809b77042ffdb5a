"""Events of the system channel.

The message definition knows errors, diagnostics and changes of control; boot, mode changes and alerts, which the
channel also carries, go as `EdgeError` with the codes below. The list of codes is this project's: none is published.
"""

from __future__ import annotations

from enum import Enum

from asimov_gym.edge.control import Handover
from asimov_gym.edge.wire import cloud_pb2
from asimov_gym.firmware import Alert, AlertId, Firmware, FirmwareState
from asimov_gym.robot.joints import MOTOR_NAMES


class Code(Enum):
    """Codes of `EdgeError`, with what each says. Commands that are dropped make no event."""

    BOOT_PROGRESS = "boot_progress"
    """A step of the boot, `n/4 what: result`: motors, imu, policy, ready."""
    BOOT = "boot"
    """The firmware has booted, at start or after a restart; the message holds the count."""
    MODE_CHANGE = "mode_change"
    """The machine has changed state; the message is `FROM -> TO` with DAMP, STAND, MOVE/POLICY or MOVE/TRAJECTORY."""
    ALERT_RAISED = "alert_raised"
    """An alert is up; the message holds name, severity, source, value and threshold."""
    ALERT_CLEARED = "alert_cleared"
    """An alert has gone; the message holds its name and source."""
    FAULT_LATCHED = "fault_latched"
    """A critical alert has latched DAMP; the message holds the error word. Only a restart clears it."""
    OVERLOAD = "overload"
    """The simulation cannot keep up with real time; the message holds the factor it reached."""
    E_STOP = "e_stop"
    """The emergency stop was `pressed` or `released`."""
    JOINT_CONTROL = "joint_control"
    """A run of joint commands `began`, or `ended: ` and why; a fault of it was raised or cleared."""
    CONSOLE = "console"
    """The bench operator acted: injected a fault, moved the gantry, restarted the firmware; the message says what."""
    CAMERA = "camera"
    """A camera failed, or came back."""
    MICROPHONE = "microphone"
    """The microphone's source failed."""
    SPEAKER = "speaker"
    """The speaker's file failed."""
    CLOUD = "cloud"
    """The room was joined, lost or joined again."""
    RECORDER = "recorder"
    """The recording failed; the robot goes on without it."""
    SHUTDOWN = "shutdown"
    """The simulated robot is going away."""


def error(
    code: Code, message: str, subsystem: cloud_pb2.Subsystem.ValueType = cloud_pb2.SUBSYSTEM_FIRMWARE
) -> cloud_pb2.EdgeEvent:
    """An `EdgeError` event, not yet stamped."""
    return cloud_pb2.EdgeEvent(error=cloud_pb2.EdgeError(subsystem=subsystem, code=code.value, message=message))


def handover(change: Handover) -> cloud_pb2.EdgeEvent:
    """A `ControllerEvent`, not yet stamped. Nobody is the empty string."""
    previous = "" if change.previous is None else change.previous.name
    current = "" if change.current is None else change.current.name
    return cloud_pb2.EdgeEvent(
        controller=cloud_pb2.ControllerEvent(previous=previous, current=current, reason=change.reason)
    )


def describe(alert: Alert) -> str:
    """An alert in words: `MOTOR_OVERTEMP critical source 3 value 801 threshold 800`."""
    severity = alert.id.severity.name.lower()
    return f"{alert.id.name} {severity} source {alert.source} value {alert.value} threshold {alert.threshold}"


def boot_progress(firmware: Firmware) -> list[cloud_pb2.EdgeEvent]:
    """The steps of a boot, each with what was found."""
    state = firmware.snapshot
    missing = len({alert.source for alert in state.alerts if alert.id is AlertId.MOTOR_MISSING})
    imu = {AlertId.IMU_FAILURE, AlertId.IMU_STALE}.isdisjoint(alert.id for alert in state.alerts)
    policy = "none, velocities are dropped" if firmware.policy is None else firmware.policy.contract.observation.layout
    steps = (
        f"motors: {len(MOTOR_NAMES) - missing} of {len(MOTOR_NAMES)} answer",
        f"imu: {'answers' if imu else 'silent'}",
        f"policy: {policy}",
        "ready",
    )
    return [error(Code.BOOT_PROGRESS, f"{n}/{len(steps)} {step}") for n, step in enumerate(steps, start=1)]


class ChangeWatch:
    """Turns the stream of firmware states into events: each is compared with the one before."""

    def __init__(self) -> None:
        self._boot = 0
        self._alerts: dict[tuple[AlertId, int], Alert] = {}
        self._latched = False

    def events(self, state: FirmwareState) -> list[cloud_pb2.EdgeEvent]:
        """What happened since the last state, in the order boot, alerts, latch, mode."""
        found = []
        if state.boot != self._boot:
            self._boot, self._alerts, self._latched = state.boot, {}, False
            found.append(error(Code.BOOT, f"boot {state.boot}"))
        alerts = {(alert.id, alert.source): alert for alert in state.alerts}
        if alerts.keys() != self._alerts.keys():
            raised = [alerts[key] for key in alerts.keys() - self._alerts.keys()]
            cleared = [self._alerts[key] for key in self._alerts.keys() - alerts.keys()]
            found += [error(Code.ALERT_RAISED, describe(a)) for a in sorted(raised, key=lambda a: (a.id, a.source))]
            found += [
                error(Code.ALERT_CLEARED, f"{a.id.name} source {a.source}")
                for a in sorted(cleared, key=lambda a: (a.id, a.source))
            ]
        self._alerts = alerts
        if state.latched and not self._latched:
            found.append(error(Code.FAULT_LATCHED, f"error_flags 0x{state.error_flags:x}"))
        self._latched = state.latched
        found += [error(Code.MODE_CHANGE, f"{old.value} -> {new.value}") for old, new in state.changes]
        return found
