"""Recordings in MCAP: every command with its verdict, every telemetry frame, event and log line."""

from asimov_gym.recording.reader import Entry, read_notes, read_recording
from asimov_gym.recording.recorder import Recorder
from asimov_gym.recording.schemas import COMMANDS, LOG, ROBOT_STATE, STATE, SYSTEM, TOPICS

__all__ = [
    "COMMANDS",
    "LOG",
    "ROBOT_STATE",
    "STATE",
    "SYSTEM",
    "TOPICS",
    "Entry",
    "Recorder",
    "read_notes",
    "read_recording",
]
