"""A client of the motion modes on the genuine roslibpy, in a process of its own: `roslibpy_client.py PORT WHAT`.

WHAT is `calls` (looks around, makes good and bad calls, walks the robot through the modes), `walk` (publishes
velocities until it is killed) or a mode to ask for.
"""

from __future__ import annotations

import sys
import time
from typing import Any

import roslibpy

SET, GET = "/aimdk_5Fmsgs/srv/SetMcAction", "/aimdk_5Fmsgs/srv/GetMcAction"
INPUT, CURRENT = "/aimdk_5Fmsgs/srv/SetMcInputSource", "/aimdk_5Fmsgs/srv/GetCurrentInputSource"
VELOCITY = "/aima/mc/locomotion/velocity"
VELOCITY_TYPE = "aimdk_msgs/msg/McLocomotionVelocity"


class Robot:
    """The services by roslibpy."""

    def __init__(self, port: int) -> None:
        self.ros = roslibpy.Ros("127.0.0.1", port)
        self.ros.run(10)
        self.velocity = roslibpy.Topic(self.ros, VELOCITY, VELOCITY_TYPE)
        self.slowest = 0.0

    def call(self, name: str, **fields: Any) -> Any:
        service = roslibpy.Service(self.ros, name, "aimdk_msgs/srv/" + name.rpartition("/")[2])
        start = time.monotonic()
        answer = service.call(roslibpy.ServiceRequest(fields), timeout=5)
        self.slowest = max(self.slowest, time.monotonic() - start)
        return answer

    def ask(self, mode: str) -> Any:
        return self.call(SET, source="node", command={"action_desc": mode})["response"]

    @property
    def mode(self) -> tuple[str, int]:
        info = self.call(GET)["info"]
        return info["action_desc"], info["status"]["value"]

    def go(self, mode: str) -> None:
        """Ask until the robot is there."""
        end = time.monotonic() + 10.0
        while self.mode != (mode, 100):
            answer = self.ask(mode)
            assert answer["status"]["value"] == 1, answer
            assert time.monotonic() < end
            time.sleep(0.1)

    def walk(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.velocity.publish(roslibpy.Message({"source": "node", "forward_velocity": 0.3}))
            time.sleep(0.02)


def calls(robot: Robot) -> None:
    assert {SET, GET, INPUT, CURRENT} < set(robot.ros.get_services())
    assert robot.ros.get_service_type(SET) == "aimdk_msgs/srv/SetMcAction"
    assert robot.ros.get_services_for_type("aimdk_msgs/srv/GetMcAction") == [GET]
    assert robot.ros.get_topics() == [VELOCITY]
    assert robot.ros.get_topic_type(VELOCITY) == VELOCITY_TYPE

    for wrong in ({"command": {"mode": "x"}}, {"source": 1}):
        try:
            robot.call(SET, **wrong)
        except roslibpy.core.ServiceException as error:
            assert "aimdk_msgs" in str(error) or "source" in str(error)
        else:
            raise AssertionError(f"{wrong} was taken")

    source = {"name": "node", "priority": 40, "timeout": 1000}
    for action, good in ((1001, True), (1001, False), (1002, True)):
        answer = robot.call(INPUT, action={"value": action}, input_source=source)["response"]
        assert (answer["header"]["code"] == 0) is good, answer
    assert robot.call(CURRENT)["input_source"]["name"] == ""

    assert robot.mode == ("PASSIVE_DEFAULT", 100)
    refusal = robot.ask("STAND_DEFAULT")
    assert refusal["status"]["value"] == 2 and refusal["message"], refusal
    robot.go("JOINT_DEFAULT")
    robot.go("STAND_DEFAULT")
    heard: list[Any] = []
    robot.velocity.subscribe(heard.append)
    robot.walk(1.0)
    assert robot.mode == ("LOCOMOTION_DEFAULT", 100)
    assert len(heard) >= 20 and heard[0]["forward_velocity"] == 0.3
    assert robot.call(CURRENT)["input_source"] == source
    robot.go("DAMPING_DEFAULT")


def main(port: int, what: str) -> None:
    robot = Robot(port)
    if what == "walk":
        robot.velocity.advertise()
        print("walking", flush=True)
        robot.walk(60.0)
    elif what == "calls":
        calls(robot)
    else:
        assert robot.ask(what)["status"]["value"] == 1
    print(f"slowest answer, s: {robot.slowest:.4f}")
    robot.ros.terminate()


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2])
