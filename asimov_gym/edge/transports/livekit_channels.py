"""Names of what travels through a room, robot's and client's end alike."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from asimov_gym.edge.control import Dialect

COMMANDS = "commands"
"""Topic of the reliable packets that carry commands, and name of a client's data track that streams them."""
SYSTEM = "system"
"""Topic of the reliable packets that carry events."""
STATE_TOPIC = "state"
"""Topic of the lossy packets that carry EdgeTelemetry beside the data track."""
REPORT_TRACK: Mapping[Dialect, str] = MappingProxyType({Dialect.CLOUD: "telemetry", Dialect.IO: "state"})
"""Name of the robot's data track by dialect: EdgeTelemetry on the one, RobotState on the other."""
COMMANDS_TRACK_ATTRIBUTE = "asimov.commands_track"
"""Attribute of the robot's participant; `1` says that it reads a client's data track `commands`."""
SIMULATOR_ATTRIBUTE = "asimov.simulator"
"""Attribute of the robot's participant, ours: only a simulated robot has it."""
SYSTEM_INFO = "edge.getSystemInfo"
"""Remote call that a robot answers with its facts, as JSON."""
MICROPHONE = "microphone"
"""Name of the robot's audio track."""
