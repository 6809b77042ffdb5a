"""The queue between the robot and the disk: messages go in at once, a thread compresses and writes them.

A block of the file is closed and handed to the operating system `BLOCK_PERIOD_S` after its first message, so a process
that is killed loses less than the last second. A recording has no holes: when the disk is full, or hangs until
`QUEUE_LIMIT_BYTES` wait, it ends there and says so. Beside the queue, memory grows with the file's index alone: about
600 bytes for each block, 90 MB a day.
"""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import BinaryIO, NamedTuple

from mcap.writer import Writer

from asimov_gym.recording.schemas import TOPICS, schema

BLOCK_PERIOD_S = 0.6
"""Age at which a block is closed."""
BLOCK_BYTES = 1024 * 1024
"""Size at which a block is closed before that, before compression."""
WAKE_PERIOD_S = 0.05
"""How often the thread looks into the queue. Waking it for each message would cost the control loop a switch each."""
QUEUE_LIMIT_BYTES = 256 * 1024 * 1024
"""How much may wait: about 40 minutes of a disk that hangs, with every topic recorded."""
_OVERHEAD_BYTES = 200
"""Memory that a queued message takes beside its data, about."""
_NANOSECONDS = 1000


class _Queued(NamedTuple):
    topic: str
    log_ns: int
    publish_ns: int
    data: bytes


class Spool:
    """An MCAP file with one channel for each topic of a recording, filled by a thread.

    Args:
        path: of the file, which must not exist; its folder is made.
        notes: kept in the file.
        on_failure: called once, on whichever thread notices, when the recording ends before `close`; gets the reason.

    Raises:
        FileExistsError: there is such a file. Nothing recorded is ever overwritten.
        OSError: the file cannot be made.
    """

    def __init__(self, path: Path, notes: Mapping[str, str], on_failure: Callable[[str], None]) -> None:
        self.failure = ""
        """Why the recording ended before it was closed; empty if it did not."""
        self.written: Counter[str] = Counter()
        """Messages handed to the file, by topic."""
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            self._file: BinaryIO = path.open("xb")
        except FileExistsError:
            raise FileExistsError(f"{path} exists, and a recording is never overwritten: name another file") from None
        self._on_failure = on_failure
        self._lock = threading.Lock()
        self._room = threading.Condition(self._lock)
        self._queue: list[_Queued] = []
        self._queued_bytes = 0
        self._last_ns = 0
        self._closed = False
        self._wake = threading.Event()
        self._writer = Writer(self._file, chunk_size=BLOCK_BYTES)
        try:
            self._channels = _start(self._writer, notes)
            self._file.flush()
        except OSError:
            self._file.close()
            raise
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    def put(self, topic: str, time_us: int, data: bytes, wait: bool = False) -> None:
        """Queue a message. After a failure, or after `close`, it is dropped.

        Args:
            topic: one of `TOPICS`.
            time_us: edge wall clock. Where that was set back, the message is logged at the time of the one before.
            data: the serialized message.
            wait: whether to wait for room when the queue is full; else the recording fails.
        """
        with self._lock:
            while wait and self._full and not self._closed:
                self._room.wait()
            if self._closed:
                return
            if not self._full:
                publish_ns = time_us * _NANOSECONDS
                self._last_ns = max(self._last_ns, publish_ns)
                self._queue.append(_Queued(topic, self._last_ns, publish_ns, data))
                self._queued_bytes += len(data) + _OVERHEAD_BYTES
                return
        self._fail(f"the disk is too slow: {self._queued_bytes / 2**20:.1f} MiB wait to be written")

    @property
    def _full(self) -> bool:
        return self._queued_bytes >= QUEUE_LIMIT_BYTES

    def close(self) -> None:
        """Write what is queued and finish the file. Closing twice does nothing."""
        with self._lock:
            self._closed = True
            self._room.notify_all()
        self._wake.set()
        if threading.current_thread() is not self._thread:
            self._thread.join()

    # -- the thread --------------------------------------------------------------------------------

    def _run(self) -> None:
        try:
            self._write_until_closed()
        except Exception as error:  # whatever a disk and a compressor can come up with: the robot goes on without
            self._fail(f"{type(error).__name__}: {error}")
            self._take()
        finally:
            try:
                self._file.close()  # which tries to write what is buffered
            except OSError as error:
                self._fail(f"{type(error).__name__}: {error}")

    def _write_until_closed(self) -> None:
        block_began: float | None = None
        closed = False
        while not closed:
            self._wake.wait(WAKE_PERIOD_S)
            batch, closed = self._take()
            for message in batch:
                channel, sequence = self._channels[message.topic], self.written[message.topic] % 2**32
                self._writer.add_message(channel, message.log_ns, message.data, message.publish_ns, sequence)
                self.written[message.topic] += 1
            now = time.monotonic()
            if batch and block_began is None:
                block_began = now
            if block_began is not None and now - block_began >= BLOCK_PERIOD_S:
                self._writer.flush()
                block_began = None
        self._writer.finish()

    def _take(self) -> tuple[list[_Queued], bool]:
        """What is queued, and whether nothing will follow."""
        with self._lock:
            batch, self._queue = self._queue, []
            self._queued_bytes = 0
            self._room.notify_all()
            return batch, self._closed

    def _fail(self, reason: str) -> None:
        """Take no more messages. Those queued before are still written where that can be done."""
        with self._lock:
            if self.failure:
                return
            self.failure = reason
            self._closed = True
            self._room.notify_all()
        self._wake.set()
        self._on_failure(reason)


def _start(writer: Writer, notes: Mapping[str, str]) -> dict[str, int]:
    """Head of the file; gives the channel of each topic."""
    writer.start(profile="", library="asimov-gym")
    channels = {}
    for topic in TOPICS:
        described = schema(topic)
        number = writer.register_schema(name=described.name, encoding="protobuf", data=described.data)
        channels[topic] = writer.register_channel(topic, message_encoding="protobuf", schema_id=number)
    writer.add_metadata("asimov_gym", dict(notes))
    return channels
