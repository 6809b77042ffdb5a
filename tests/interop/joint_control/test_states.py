"""What the vendor's client reads of the robot: the stream of states, the whole state, the hardware."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("bosdyn", reason="bosdyn-client is not installed: pip install 'asimov-gym[joint-control,test]'")

from bosdyn.client.robot_command import RobotCommandBuilder

from asimov_gym.edge import SimulatedRobot
from asimov_gym.edge.transports.joint_control.vendor import robot_state_pb2
from asimov_gym.robot.joints import JOINT_NAMES
from asimov_gym.robot.urdf import urdf
from tests.interop.joint_control.joint_client import Clients, StateReader, eventually


def test_a_third_of_a_thousand_states_a_second(robot: SimulatedRobot, clients: Clients) -> None:
    reader = StateReader(clients)
    eventually(lambda: robot.edge.wants_samples, "the stream is open")
    robot.advance(0.3)
    eventually(lambda: len(reader.messages) >= 100, "the states arrive")
    reader.stop()
    assert len(reader.messages) == 100
    stamps = [message.joint_states.acquisition_timestamp.ToMicroseconds() for message in reader.messages]
    assert set(np.diff(stamps)) == {3000}
    assert len({tuple(message.joint_states.position) for message in reader.messages}) == 100
    packets = [packet.timestamp.ToMicroseconds() for m in reader.messages for packet in m.inertial_state.packets]
    assert set(np.diff(packets)) == {1000}
    eventually(lambda: not robot.edge.wants_samples, "the stream is closed")


def test_a_state_holds_what_the_interface_lists(robot: SimulatedRobot, clients: Clients) -> None:
    clients.command.robot_command(RobotCommandBuilder.synchro_stand_command())
    robot.advance(3.0)
    reader = StateReader(clients)
    eventually(lambda: robot.edge.wants_samples, "the stream is open")
    robot.advance(0.03)
    eventually(lambda: len(reader.messages) >= 10, "the states arrive")
    reader.stop()
    state = reader.messages[-1]
    sensed = robot.firmware.snapshot
    assert len(state.joint_states.velocity) == len(state.joint_states.load) == len(JOINT_NAMES)
    assert list(state.joint_states.position) == pytest.approx(sensed.joint_position.tolist(), abs=1e-6)
    assert list(state.joint_states.load) == pytest.approx(sensed.joint_torque.tolist(), abs=0.5)
    imu = state.inertial_state
    assert (imu.packet_rate, len(imu.packets), imu.mounting_link_name) == (1000.0, 3, "pelvis_link")
    at_rest = imu.packets[-1].acceleration_rt_odom_in_link_frame
    assert [at_rest.x, at_rest.y, at_rest.z] == pytest.approx([0.0, 0.0, 0.0], abs=0.2)
    pose = state.kinematic_state.odom_tform_body
    assert pose.position.z == pytest.approx(0.61, abs=0.02)
    assert state.kinematic_state.vision_tform_body == pose
    assert list(state.contact_states) == [robot_state_pb2.FootState.CONTACT_MADE] * 2
    assert not state.HasField("last_command")


def test_angular_velocity_is_told_in_the_world_frame(robot: SimulatedRobot, clients: Clients) -> None:
    """A robot lying on its side and turning about its long axis turns about the world's horizontal."""
    turned = np.array([np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0])  # its z axis along the world's x
    qpos, qvel = robot.physics.standing()
    qpos[2], qpos[3:7] = 3.0, turned
    qvel[3:6] = (0.0, 0.0, 2.0)  # body frame
    robot.firmware.gantry.by_hand("off")
    robot.physics.reset(qpos, qvel)
    reader = StateReader(clients)
    eventually(lambda: robot.edge.wants_samples, "the stream is open")
    robot.advance(0.005)
    eventually(lambda: reader.messages, "a state arrives")
    reader.stop()
    state = reader.messages[0]
    angular = state.kinematic_state.velocity_of_body_in_odom.angular
    assert [angular.x, angular.y, angular.z] == pytest.approx([2.0, 0.0, 0.0], abs=0.1)
    gyro = state.inertial_state.packets[-1].angular_velocity_rt_odom_in_link_frame
    assert gyro.z == pytest.approx(2.0, abs=0.1)
    falling = state.inertial_state.packets[-1].acceleration_rt_odom_in_link_frame
    assert falling.x == pytest.approx(9.81, abs=0.7), "down is the body's x axis; in free fall it is accelerated there"


def test_the_whole_state_and_the_hardware(robot: SimulatedRobot, clients: Clients) -> None:
    state = clients.state.get_robot_state()
    assert [joint.name for joint in state.kinematic_state.joint_states] == list(JOINT_NAMES)
    assert state.power_state.motor_power_state == robot_state_pb2.PowerState.STATE_OFF
    assert state.battery_states[0].charge_percentage.value > 50.0
    assert not state.behavior_fault_state.faults
    odom = state.kinematic_state.transforms_snapshot.child_to_parent_edge_map["odom"]
    assert odom.parent_frame_name == "body"
    assert odom.parent_tform_child.position.z == pytest.approx(-state_height(robot), abs=0.02)
    assert clients.state.get_robot_hardware_configuration().skeleton.urdf == urdf()


def state_height(robot: SimulatedRobot) -> float:
    return float(robot.physics.read().base_position[0, 2])
