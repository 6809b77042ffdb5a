"""Recordings in MCAP: every command with its verdict, every telemetry frame, every event."""

from asimov_gym.recording.reader import Entry, read_notes, read_recording
from asimov_gym.recording.recorder import Recorder
from asimov_gym.recording.schemas import COMMANDS, STATE, SYSTEM, TOPICS

__all__ = ["COMMANDS", "STATE", "SYSTEM", "TOPICS", "Entry", "Recorder", "read_notes", "read_recording"]
