"""Writes what passes the edge to an MCAP file, which Foxglove and other viewers open."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import TracebackType

from mcap.writer import Writer

from asimov_gym.edge import Client, Edge, Verdict
from asimov_gym.edge.wire import recording_pb2
from asimov_gym.recording.schemas import COMMANDS, STATE, SYSTEM, TOPICS, descriptor_set

_NANOSECONDS = 1000
CHUNK_BYTES = 64 * 1024
"""Size of the blocks that reach the disk, before compression: about five seconds of a running robot."""


class Recorder:
    """Records every command with its verdict, every telemetry frame and every event, until closed.

    If the process is killed, what came before the last few seconds is in the file, and `read_recording` reads it.

    Args:
        path: of the file; its folder is made, an existing file is replaced.
        edge: of the robot to record.
        notes: text entries about the run, kept in the file.
    """

    def __init__(self, path: str | Path, edge: Edge, notes: Mapping[str, str] | None = None) -> None:
        self.path = Path(path)
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self._file = self.path.open("wb")
        self._writer = Writer(self._file, chunk_size=CHUNK_BYTES)
        self._writer.start(profile="", library="asimov-gym")
        self._channels: dict[str, int] = {}
        self._counts: dict[str, int] = {}
        for topic, message in TOPICS.items():
            name = message.DESCRIPTOR.full_name
            schema = self._writer.register_schema(name=name, encoding="protobuf", data=descriptor_set(message))
            self._channels[topic] = self._writer.register_channel(topic, message_encoding="protobuf", schema_id=schema)
            self._counts[topic] = 0
        self._writer.add_metadata("asimov_gym", {"edge_clock": "microseconds since 1970", **(notes or {})})
        self._edge = edge
        edge.attach(self)

    def close(self) -> None:
        """Stop recording and finish the file. Closing twice does nothing."""
        self._edge.detach(self)
        with self._edge.lock:
            if not self._file.closed:
                self._writer.finish()
                self._file.close()

    def __enter__(self) -> Recorder:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    # -- EdgeListener ------------------------------------------------------------------------------

    def on_command(self, received_us: int, client: Client, packet: bytes, verdict: Verdict) -> None:
        """Record a packet and what became of it."""
        record = recording_pb2.RecordedCommand(
            received_us=received_us,
            client=client.name,
            payload=packet,
            kind=verdict.kind,
            verdict=str(verdict),
            notes=[note.name for note in verdict.notes],
        )
        self._write(COMMANDS, received_us, record.SerializeToString())

    def on_telemetry(self, timestamp_us: int, packet: bytes) -> None:
        """Record a telemetry frame."""
        self._write(STATE, timestamp_us, packet)

    def on_event(self, timestamp_us: int, packet: bytes) -> None:
        """Record an event."""
        self._write(SYSTEM, timestamp_us, packet)

    def _write(self, topic: str, time_us: int, data: bytes) -> None:
        time_ns = time_us * _NANOSECONDS
        self._writer.add_message(self._channels[topic], time_ns, data, time_ns, self._counts[topic])
        self._counts[topic] = (self._counts[topic] + 1) % 2**32
