"""A second witness of what passes the edge, to hold a recording against."""

from __future__ import annotations

import hashlib
import logging
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

from asimov_gym.edge import Client, EdgeListener, Verdict
from asimov_gym.edge.wire import cloud_pb2, io_pb2, recording_pb2
from asimov_gym.recording import COMMANDS, LOG, ROBOT_STATE, STATE, SYSTEM, read_recording

_WRAP = 2**32


class Testimony:
    """How many messages of each topic, and a digest of all of them in their order. Takes the same room for any number.

    The log's lines are digested whatever their order: two threads may reach two handlers in different orders.
    """

    def __init__(self) -> None:
        self.count: Counter[str] = Counter()
        self._digests = {topic: hashlib.blake2b() for topic in (COMMANDS, STATE, ROBOT_STATE, SYSTEM)}
        self._log = 0

    def add(self, topic: str, *parts: bytes | str | int | Iterable[str]) -> None:
        """One more message; what it consists of."""
        self.count[topic] += 1
        said = repr(parts).encode()
        if topic == LOG:
            self._log += int.from_bytes(hashlib.blake2b(said).digest(), "big")
        else:
            self._digests[topic].update(said)

    @property
    def digests(self) -> dict[str, str]:
        """By topic."""
        return {LOG: f"{self._log:x}", **{topic: digest.hexdigest() for topic, digest in self._digests.items()}}


class Witness(EdgeListener, logging.Handler):
    """Hears what a recorder hears; of the log the lines of `asimov_gym`."""

    def __init__(self) -> None:
        super().__init__()
        self.heard = Testimony()

    def on_command(self, received_us: int, client: Client, packet: bytes, verdict: Verdict) -> None:
        notes = [note.name for note in verdict.notes]
        self.heard.add(COMMANDS, received_us, client.name, client.source.name, packet, str(verdict), notes)

    def on_telemetry(self, timestamp_us: int, packet: bytes) -> None:
        self.heard.add(STATE, packet)

    def on_robot_state(self, timestamp_us: int, packet: bytes, report: bool) -> None:
        self.heard.add(ROBOT_STATE, packet)

    def on_event(self, timestamp_us: int, packet: bytes) -> None:
        self.heard.add(SYSTEM, packet)

    def emit(self, record: logging.LogRecord) -> None:
        self.heard.add(LOG, record.name, record.getMessage())


def check_recording(path: Path, heard: Testimony) -> None:
    """Assert that a finished recording holds what the witness heard, all of it, in order, and nothing else.

    The messages' own counters are looked at too: none is left out between two frames, but for restarts of the firmware.
    """
    told = Testimony()
    last: dict[str, int] = {}
    boot, time_us = 0, 0
    for entry in read_recording(path):
        message = entry.message
        assert entry.time_us >= time_us
        time_us = entry.time_us
        if isinstance(message, recording_pb2.RecordedCommand):
            who = (message.client, message.source)
            told.add(COMMANDS, message.received_us, *who, message.payload, message.verdict, list(message.notes))
        elif isinstance(message, recording_pb2.LogLine):
            told.add(LOG, message.name, message.message)
        else:
            assert isinstance(message, cloud_pb2.EdgeTelemetry | cloud_pb2.EdgeEvent | io_pb2.RobotState)
            told.add(entry.topic, message.SerializeToString())
            if isinstance(message, io_pb2.RobotState) and message.firmware_epoch_id != boot:
                boot = message.firmware_epoch_id  # counts from the start again
            elif entry.topic in last:
                assert message.sequence == (last[entry.topic] + 1) % _WRAP, f"a gap in {entry.topic}"
            last[entry.topic] = message.sequence
    assert told.count == heard.count
    assert told.digests == heard.digests
