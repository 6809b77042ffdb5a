"""A client of the motion modes on a real ROS 2 installation, with the vendor's message package. Run by the tests.

Asks for the mode as the vendor's examples do: eight attempts of a quarter of a second.
"""

from __future__ import annotations

import time

import rclpy  # type: ignore[import-not-found]
from aimdk_msgs.msg import McLocomotionVelocity  # type: ignore[import-not-found]
from aimdk_msgs.srv import GetMcAction, SetMcAction  # type: ignore[import-not-found]


def main() -> None:
    rclpy.init()
    node = rclpy.create_node("asimov_motion_modes_test")
    get = node.create_client(GetMcAction, "/aimdk_5Fmsgs/srv/GetMcAction")
    switch = node.create_client(SetMcAction, "/aimdk_5Fmsgs/srv/SetMcAction")
    assert get.wait_for_service(10.0) and switch.wait_for_service(10.0), "the services were not found"

    def call(client: object, request: object) -> object:
        for _ in range(8):
            future = client.call_async(request)  # type: ignore[attr-defined]
            rclpy.spin_until_future_complete(node, future, timeout_sec=0.25)
            if future.done():
                return future.result()
        raise AssertionError("no answer in eight attempts")

    info = call(get, GetMcAction.Request()).info  # type: ignore[attr-defined]
    assert (info.action_desc, info.status.value) == ("PASSIVE_DEFAULT", 100), info
    request = SetMcAction.Request()
    request.source = "pnc"
    request.command.action_desc = "DAMPING_DEFAULT"
    assert call(switch, request).response.status.value == 1  # type: ignore[attr-defined]
    info = call(get, GetMcAction.Request()).info  # type: ignore[attr-defined]
    assert info.action_desc == "DAMPING_DEFAULT", info
    publisher = node.create_publisher(McLocomotionVelocity, "/aima/mc/locomotion/velocity", 10)
    message = McLocomotionVelocity()
    message.source, message.forward_velocity = "pnc", 0.3
    for _ in range(20):
        publisher.publish(message)
        time.sleep(0.05)
    node.destroy_node()
    rclpy.shutdown()


if __name__ == "__main__":
    main()
