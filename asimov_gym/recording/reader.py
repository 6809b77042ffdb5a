"""Reads a recording back."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from google.protobuf.message import Message
from mcap.exceptions import EndOfFile, McapError
from mcap.reader import make_reader
from mcap.records import Channel, Schema
from mcap.records import Message as McapMessage
from mcap.stream_reader import StreamReader

from asimov_gym.recording.schemas import TOPICS

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Entry:
    """One message of a recording."""

    topic: str
    time_us: int
    """Edge wall clock, microseconds."""
    message: Message
    """`RecordedCommand`, `EdgeTelemetry` or `EdgeEvent`, by topic; see `asimov_gym.recording.schemas`."""


def read_recording(path: str | Path, topics: Iterable[str] | None = None) -> Iterator[Entry]:
    """The messages of a recording, in the order of time. One that was cut off is read as far as it goes.

    Args:
        path: an MCAP file that `Recorder` wrote.
        topics: only these; all when None.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: an unknown topic, or the file is not a recording; the message says which.
    """
    wanted = set(TOPICS if topics is None else topics)
    unknown = sorted(wanted - set(TOPICS))
    if unknown:
        raise ValueError(f"topics {unknown} are unknown; a recording has {', '.join(TOPICS)}")
    schemas: dict[int, str] = {}
    channels: dict[int, str] = {}
    with Path(path).open("rb") as file:
        try:
            for record in StreamReader(file).records:
                if isinstance(record, Schema):
                    schemas[record.id] = record.name
                elif isinstance(record, Channel):
                    _check_channel(path, record, schemas)
                    channels[record.id] = record.topic
                elif isinstance(record, McapMessage) and (topic := channels[record.channel_id]) in wanted:
                    yield Entry(topic, record.log_time // 1000, TOPICS[topic].FromString(record.data))
        except EndOfFile:
            if not channels:
                raise ValueError(f"{path} is not a readable recording: it ends before its first message") from None
            _log.warning("%s was cut off: read as far as it goes", path)
        except McapError as error:
            raise ValueError(f"{path} is not a readable recording: {type(error).__name__}: {error}") from error


def _check_channel(path: str | Path, channel: Channel, schemas: dict[int, str]) -> None:
    if channel.topic not in TOPICS:
        raise ValueError(f"{path} holds topic {channel.topic!r}; a recording has {', '.join(TOPICS)}")
    expected, found = TOPICS[channel.topic].DESCRIPTOR.full_name, schemas.get(channel.schema_id)
    if found != expected:
        raise ValueError(f"{path}: topic {channel.topic} holds {found or 'no schema'}, not {expected}")


def read_notes(path: str | Path) -> dict[str, str]:
    """The text entries that the recorder was given.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file is not a recording.
    """
    with Path(path).open("rb") as file:
        try:
            for record in make_reader(file).iter_metadata():
                if record.name == "asimov_gym":
                    return dict(record.metadata)
        except McapError as error:
            raise ValueError(f"{path} is not a readable recording: {type(error).__name__}: {error}") from error
    raise ValueError(f"{path} is an MCAP file, but not one of this project's recordings")
