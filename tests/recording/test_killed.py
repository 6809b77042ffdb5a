"""A process that is killed with SIGKILL in the middle of a recording."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
import zlib
from pathlib import Path
from typing import Any

from asimov_gym.recording import TOPICS, read_recording

ROOT = Path(__file__).parents[2]
RECORD = """
import logging, sys, threading, time, zlib
from asimov_gym.edge import EdgeListener, SimulatedRobot, connect
from asimov_gym.firmware import WallClock
from asimov_gym.recording import Recorder

class Witness(EdgeListener):
    def tell(self, topic, time_us, data):
        sys.stdout.write(f"{topic} {time_us} {zlib.crc32(data)}\\n")
    def on_command(self, received_us, client, packet, verdict):
        self.tell("/commands", received_us, packet)
    def on_telemetry(self, timestamp_us, packet):
        self.tell("/state", timestamp_us, packet)
    def on_robot_state(self, timestamp_us, packet, report):
        self.tell("/robot_state", timestamp_us, packet)
    def on_event(self, timestamp_us, packet):
        self.tell("/system", timestamp_us, packet)

sys.stdout.reconfigure(line_buffering=True)
robot = SimulatedRobot(clock=WallClock())
witness = Witness()
Recorder(sys.argv[1], robot.edge, robot_state=True)
robot.edge.attach(witness)
with robot, connect(robot, "tester") as session:
    while True:
        session.stand()
        time.sleep(0.02)
"""


def test_a_killed_process_loses_less_than_its_last_second(tmp_path: Path) -> None:
    """A second witness, at the other end of a pipe, saw what the robot did until the kill."""
    path = tmp_path / "killed.mcap"
    child = subprocess.Popen([sys.executable, "-c", RECORD, str(path)], cwd=ROOT, stdout=subprocess.PIPE, text=True)
    lines: list[str] = []
    begun = threading.Event()

    def listen() -> None:
        assert child.stdout is not None
        for line in child.stdout:
            lines.append(line)
            begun.set()

    listener = threading.Thread(target=listen)
    listener.start()
    try:
        assert begun.wait(60.0), "the robot never started"
        time.sleep(2.3)
        assert child.poll() is None, "the robot ended by itself"
    finally:
        child.send_signal(signal.SIGKILL)
        listener.join()
        child.wait()
    seen = [line.split() for line in lines if line.endswith("\n")]
    witnessed = {topic: [(int(us), int(crc)) for name, us, crc in seen if name == topic] for topic in TOPICS}
    recorded: dict[str, list[int]] = {topic: [] for topic in TOPICS}
    for entry in read_recording(path):
        message: Any = entry.message
        data = message.payload if entry.topic == "/commands" else message.SerializeToString()
        recorded[entry.topic].append(zlib.crc32(data))
    killed_us = max(us for times in witnessed.values() for us, _ in times)
    for topic in ("/commands", "/state", "/robot_state", "/system"):
        saved, told = recorded[topic], witnessed[topic]
        contents = [crc for _, crc in told]
        assert len(told) > 1 and saved == contents[: len(saved)], f"{topic}: the file is not what was seen, in order"
        lost = [us for us, _ in told[len(saved) :]]
        assert all(killed_us - us < 1_000_000 for us in lost), f"{topic}: lost {killed_us - min(lost)} us"
    assert len(recorded["/robot_state"]) > 100
