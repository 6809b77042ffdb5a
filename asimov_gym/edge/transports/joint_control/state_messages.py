"""The robot's state in the vendor's messages: the 333 Hz stream, the whole state with its faults, the hardware."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from asimov_gym.edge.transports.joint_control.stamps import stamp
from asimov_gym.edge.transports.joint_control.vendor import header_pb2, robot_state_pb2
from asimov_gym.firmware import AlertId, Firmware, JointSample, Severity, State, error_bit
from asimov_gym.robot.frames import projected_gravity, rotate_inverse
from asimov_gym.robot.joints import JOINT_NAMES

BODY = "pelvis_link"
"""What the vendor's messages call the body."""
IMU_SITE = "imu_in_pelvis"
IMU_RATE_HZ = 1000.0
ALERT_FAULTS = 1000
"""Number of the behaviour fault that stands for a critical alert, less the alert's own."""
_FALLS = (AlertId.FALL_DETECTED, AlertId.TUMBLE_DETECTED)
_MADE = robot_state_pb2.FootState.CONTACT_MADE
_LOST = robot_state_pb2.FootState.CONTACT_LOST
_OK = header_pb2.CommonError(code=header_pb2.CommonError.CODE_OK)


class StateMessages:
    """Makes messages of one robot's state.

    Args:
        firmware: of the robot.
    """

    def __init__(self, firmware: Firmware) -> None:
        self._firmware = firmware
        model = firmware.physics.model
        self._gravity = float(-model.opt.gravity[2])
        self._imu = model.site_pos[model.site(IMU_SITE).id].tolist()
        self._urdf: str | None = None

    def streamed(self, samples: Sequence[JointSample]) -> Any:
        """One `RobotStateStreamResponse`: the last sample, with the IMU packets of all."""
        last = samples[-1]
        when = stamp(last.time_us)
        message = robot_state_pb2.RobotStateStreamResponse(
            header=header_pb2.ResponseHeader(response_timestamp=when, error=_OK),
            contact_states=[_MADE if made else _LOST for made in last.contacts],
        )
        joints = message.joint_states
        joints.acquisition_timestamp.CopyFrom(when)
        joints.position.extend(last.position.tolist())
        joints.velocity.extend(last.velocity.tolist())
        joints.load.extend(last.load.tolist())
        if last.echo.received_us:
            message.last_command.user_command_key = last.echo.key
            message.last_command.received_timestamp.CopyFrom(stamp(last.echo.received_us))
        imu = message.inertial_state
        imu.packet_rate, imu.identifier, imu.mounting_link_name = IMU_RATE_HZ, "imu", BODY
        _set_vector(imu.position_imu_rt_link, self._imu)
        for sample in samples:
            self._add_packet(imu, sample)
        kinematic = message.kinematic_state
        kinematic.acquisition_timestamp.CopyFrom(when)
        linear, angular = last.base_velocity.tolist(), _to_world(last.base_quat, last.gyro)
        for pose in (kinematic.odom_tform_body, kinematic.vision_tform_body):
            _set_vector(pose.position, last.base_position.tolist())
            _set_quaternion(pose.rotation, last.base_quat)
        for velocity in (kinematic.velocity_of_body_in_vision, kinematic.velocity_of_body_in_odom):
            _set_vector(velocity.linear, linear)
            _set_vector(velocity.angular, angular)
        return message

    def _add_packet(self, imu: Any, sample: JointSample) -> None:
        if sample.specific_force is None:
            return
        # What an accelerometer feels, less what it feels of gravity: the acceleration of the IMU against the ground.
        felt = sample.specific_force + self._gravity * projected_gravity(sample.base_quat)
        packet = imu.packets.add()
        packet.timestamp.CopyFrom(stamp(sample.time_us))
        _set_vector(packet.acceleration_rt_odom_in_link_frame, felt.tolist())
        _set_vector(packet.angular_velocity_rt_odom_in_link_frame, sample.gyro.tolist())
        _set_quaternion(packet.odom_rot_link, sample.base_quat)

    # -- the whole state ---------------------------------------------------------------------------

    def whole(self) -> Any:
        """The `RobotState` with faults, power, battery and E-stop. Call with the edge's lock held."""
        firmware = self._firmware
        sample, snapshot = firmware.joint_sample(), firmware.snapshot
        when = stamp(sample.time_us)
        message = robot_state_pb2.RobotState()
        power = message.power_state
        power.timestamp.CopyFrom(when)
        on, off = robot_state_pb2.PowerState.STATE_ON, robot_state_pb2.PowerState.STATE_OFF
        power.motor_power_state = off if firmware.e_stopped or firmware.state is State.DAMP else on
        power.robot_power_state = robot_state_pb2.PowerState.ROBOT_POWER_STATE_ON
        power.shore_power_state = robot_state_pb2.PowerState.SHORE_POWER_STATE_OFF
        power.locomotion_charge_percentage.value = snapshot.battery.soc_percent
        battery = message.battery_states.add(
            timestamp=when, identifier="battery", status=robot_state_pb2.BatteryState.STATUS_DISCHARGING
        )
        battery.charge_percentage.value = snapshot.battery.soc_percent
        battery.current.value, battery.voltage.value = snapshot.battery.current_a, snapshot.battery.voltage_v
        battery.temperatures.append(snapshot.battery.max_cell_temp_c)
        stop = robot_state_pb2.EStopState
        message.estop_states.add(
            timestamp=when,
            name="e-stop",
            type=stop.TYPE_SOFTWARE,
            state=stop.STATE_ESTOPPED if firmware.e_stopped else stop.STATE_NOT_ESTOPPED,
        )
        message.behavior_fault_state.faults.extend(self.faults())
        self._set_kinematics(message, sample)
        return message

    def faults(self) -> list[Any]:
        """What keeps a run from beginning, each a `BehaviorFault`: the fault of joint control, and latched alerts."""
        firmware, kind = self._firmware, robot_state_pb2.BehaviorFault
        found = []
        own = firmware.joints.fault
        if own is not None:
            found.append(
                kind(
                    behavior_fault_id=own.number,
                    onset_timestamp=stamp(own.onset_us),
                    cause=kind.CAUSE_COMMAND_FAILURE,
                    status=kind.STATUS_CLEARABLE,
                )
            )
        flags = firmware.alerts.error_flags
        onsets = {alert.id: alert.first_set_us for alert in firmware.alerts.active}
        boot_us = firmware.clock.realtime_us() - firmware.now_us
        for alert in AlertId:
            if alert.severity is Severity.CRITICAL and flags & error_bit(alert):
                onset = onsets.get(alert)
                found.append(
                    kind(
                        behavior_fault_id=ALERT_FAULTS + alert.value,
                        onset_timestamp=None if onset is None else stamp(boot_us + onset),
                        cause=kind.CAUSE_FALL if alert in _FALLS else kind.CAUSE_HARDWARE,
                        status=kind.STATUS_UNCLEARABLE,
                    )
                )
        return found

    def _set_kinematics(self, message: Any, sample: JointSample) -> None:
        state = message.kinematic_state
        state.acquisition_timestamp.CopyFrom(stamp(sample.time_us))
        rows = zip(JOINT_NAMES, sample.position.tolist(), sample.velocity.tolist(), sample.load.tolist(), strict=True)
        for name, position, velocity, load in rows:
            joint = state.joint_states.add(name=name)
            joint.position.value, joint.velocity.value, joint.load.value = position, velocity, load
        edges = state.transforms_snapshot.child_to_parent_edge_map
        edges["body"].parent_frame_name = ""
        back = -rotate_inverse(sample.base_quat, sample.base_position)
        for frame in ("odom", "vision"):
            edges[frame].parent_frame_name = "body"
            _set_vector(edges[frame].parent_tform_child.position, back.tolist())
            _set_quaternion(edges[frame].parent_tform_child.rotation, _turned_back(sample.base_quat))
        angular = _to_world(sample.base_quat, sample.gyro)
        for velocity in (state.velocity_of_body_in_vision, state.velocity_of_body_in_odom):
            _set_vector(velocity.linear, sample.base_velocity.tolist())
            _set_vector(velocity.angular, angular)
        feet = self._firmware.physics.read().foot_position[0]
        for made, foot in zip(sample.contacts, feet, strict=True):
            position = rotate_inverse(sample.base_quat, foot - sample.base_position)
            _set_vector(
                message.foot_state.add(contact=_MADE if made else _LOST).foot_position_rt_body, position.tolist()
            )

    def hardware(self) -> Any:
        """A `HardwareConfiguration`: the robot's description as URDF."""
        if self._urdf is None:
            from asimov_gym.robot.urdf import urdf

            self._urdf = urdf()
        configuration = robot_state_pb2.HardwareConfiguration()
        configuration.skeleton.urdf = self._urdf
        return configuration


def _to_world(quat: np.ndarray, vector: np.ndarray) -> list[float]:
    """A body vector in the world frame."""
    return rotate_inverse(_turned_back(quat), vector).tolist()


def _turned_back(quat: np.ndarray) -> np.ndarray:
    """The inverse of a rotation (w, x, y, z)."""
    return quat * np.array([1.0, -1.0, -1.0, -1.0])


def _set_vector(message: Any, values: Sequence[float]) -> None:
    message.x, message.y, message.z = values


def _set_quaternion(message: Any, quat: np.ndarray) -> None:
    message.w, message.x, message.y, message.z = quat.tolist()
