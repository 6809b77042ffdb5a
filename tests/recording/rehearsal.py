"""A run that the tests of this folder record and look into."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import numpy as np

from asimov_gym.assets import asset_path
from asimov_gym.edge import SimulatedRobot, connect
from asimov_gym.recording import Recorder, read_recording


def record_run(path: Path, seed: int = 5, policy: bool = True) -> None:
    """DAMP, STAND, a walk, joint targets, a packet of noise, DAMP: 3.2 s in lockstep, with log lines."""
    robot = SimulatedRobot(asset_path("policies", "asimov_walk.onnx") if policy else None, seed=seed)
    log = logging.getLogger("asimov_gym.edge.rehearsal")
    with Recorder(path, robot.edge, {"purpose": "test"}, robot_state=True), connect(robot, "tester") as session:
        robot.advance(0.2)
        log.error("the %s is %s", "rehearsal", "on")
        session.stand()
        robot.advance(0.6)
        session.velocity(0.4)
        robot.advance(1.2)
        session.commands.send(b"\xff\xff")
        session.trajectory(list(session.state.get().joint_pos), kp=np.full(25, 900.0))
        robot.advance(0.15)
        session.damp()
        robot.advance(1.05)
    connect(robot, "late").stand()
    robot.advance(0.5)


def messages(path: Path, topic: str) -> list[Any]:
    """The messages of one topic of a recording."""
    return [entry.message for entry in read_recording(path, [topic])]
