"""Reads a recording back."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from google.protobuf.message import DecodeError, Message
from mcap.exceptions import EndOfFile, InvalidMagic
from mcap.records import Channel, Metadata, Schema
from mcap.records import Message as McapMessage
from mcap.stream_reader import StreamReader
from mcap.writer import MCAP0_MAGIC

from asimov_gym.recording.schemas import TOPICS, schema

_log = logging.getLogger(__name__)

_RECORD_LIMIT = 1 << 28
"""No record of ours is near this size; a length beyond it is damage, and not to be allocated."""


@dataclass(frozen=True)
class Entry:
    """One message of a recording."""

    topic: str
    time_us: int
    """Edge wall clock, microseconds; never less than that of the entry before."""
    message: Message
    """By topic: `RecordedCommand`, `EdgeTelemetry`, `RobotState`, `EdgeEvent` or `LogLine`; see
    `asimov_gym.recording.schemas`."""


def read_recording(path: str | Path, topics: Iterable[str] | None = None) -> Iterator[Entry]:
    """The messages of a recording, in the order of time. One that was cut off is read as far as it goes.

    Topics that this version does not know are left out, with a warning: files of later versions can be read.

    Args:
        path: an MCAP file that `Recorder` wrote.
        topics: only these; all when None.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: an unknown topic was asked for, or the file is not a recording; the message says which.
    """
    wanted = set(TOPICS if topics is None else topics)
    unknown = sorted(wanted - set(TOPICS))
    if unknown:
        raise ValueError(f"topics {unknown} are unknown; a recording has {', '.join(TOPICS)}")
    return _entries(Path(path), wanted)


def _entries(path: Path, wanted: set[str]) -> Iterator[Entry]:
    schemas: dict[int, str] = {}
    channels: dict[int, str] = {}
    for record in _records(path):
        if isinstance(record, Schema):
            schemas[record.id] = record.name
        elif isinstance(record, Channel):
            if record.id not in channels:
                _check_channel(path, record, schemas)
            channels[record.id] = record.topic
        elif isinstance(record, McapMessage) and (topic := channels[record.channel_id]) in wanted:
            try:
                message = TOPICS[topic].FromString(record.data)
            except DecodeError as error:
                raise ValueError(f"{path} is damaged: a message of {topic} cannot be decoded: {error}") from error
            yield Entry(topic, record.log_time // 1000, message)


def _check_channel(path: Path, channel: Channel, schemas: dict[int, str]) -> None:
    if channel.topic not in TOPICS:
        _log.warning("%s: topic %s is unknown to this version and left out", path, channel.topic)
        return
    expected, found = schema(channel.topic).name, schemas.get(channel.schema_id)
    if found != expected:
        raise ValueError(f"{path}: topic {channel.topic} holds {found or 'no schema'}, not {expected}")


def read_notes(path: str | Path) -> dict[str, str]:
    """What the recording says of its run: see `asimov_gym.recording.notes`, and what the recorder was given.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file is not a recording.
    """
    for record in _records(Path(path)):
        if isinstance(record, Metadata) and record.name == "asimov_gym":
            return dict(record.metadata)
        if isinstance(record, McapMessage):
            break  # the notes come before the first message
    raise ValueError(f"{path} is an MCAP file, but not one of this project's recordings")


def is_complete(path: str | Path) -> bool:
    """Whether the recorder closed the file; else it was cut off.

    Raises:
        FileNotFoundError: there is no such file.
    """
    with Path(path).open("rb") as file:
        head, size = file.read(len(MCAP0_MAGIC)), file.seek(0, 2)
        file.seek(max(0, size - len(MCAP0_MAGIC)))
        return size >= 2 * len(MCAP0_MAGIC) and head == file.read() == MCAP0_MAGIC


def _records(path: Path) -> Iterator[object]:
    """The records of a file as far as it goes; damage within it is a ValueError."""
    begun = False
    with path.open("rb") as file:
        records = iter(StreamReader(file, validate_crcs=True, record_size_limit=_RECORD_LIMIT).records)
        while True:
            try:
                record = next(records, None)
            except OSError:
                raise
            except Exception as error:  # McapError, and what decompressor and parser raise over damaged bytes
                # Whatever a parser says of a record that the file's end cuts through: nothing is left after it.
                if begun and (isinstance(error, EndOfFile) or not file.read(1)):
                    _log.warning("%s was cut off: read as far as it goes", path)
                    return
                why = f"{type(error).__name__}: {error}"
                if isinstance(error, EndOfFile):
                    why = "it ends before its first message"
                elif isinstance(error, InvalidMagic):
                    why = "no MCAP file"
                raise ValueError(f"{path} is not a readable recording: {why}") from error
            if record is None:
                return
            begun = begun or isinstance(record, Channel | Metadata)
            yield record
