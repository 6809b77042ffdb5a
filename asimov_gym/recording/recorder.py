"""Records what passes the edge, and the log, in an MCAP file, which Foxglove and other viewers open."""

from __future__ import annotations

import atexit
import logging
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType

from asimov_gym.edge import Client, Code, Edge, EdgeListener, Verdict
from asimov_gym.edge.wire import recording_pb2
from asimov_gym.firmware import StepClock
from asimov_gym.recording.log_tap import LogTap
from asimov_gym.recording.notes import edge_notes
from asimov_gym.recording.schemas import COMMANDS, LOG, ROBOT_STATE, STATE, SYSTEM
from asimov_gym.recording.spool import Spool

_log = logging.getLogger(__name__)
_LOCK_PATIENCE_S = 1.0


class Recorder(EdgeListener):
    """Records every command with its verdict, every telemetry frame, event and log line, until closed.

    Of the log it takes the lines of the logger `asimov_gym` that the logger's level lets through. A robot in real time
    never waits for the disk; one in lockstep does, when 256 MiB are queued. If the process is killed, all but the last
    second is in the file, and `read_recording` reads it. If the disk fails, the recording ends, the robot goes on, and
    the log, an event and `failure` say so.

    Args:
        path: of the file; its folder is made.
        edge: of the robot to record.
        notes: text entries about the run, kept in the file beside those of `asimov_gym.recording.notes`.
        robot_state: whether to have the edge make a `RobotState` for every control step; else those are recorded that
            it makes for somebody else.

    Raises:
        FileExistsError: there is such a file. Nothing recorded is ever overwritten.
        OSError: the file cannot be made.
    """

    def __init__(
        self, path: str | Path, edge: Edge, notes: Mapping[str, str] | None = None, robot_state: bool = False
    ) -> None:
        self.path = Path(path)
        self.wants_robot_state = robot_state
        self._edge = edge
        self._patient = isinstance(edge.clock, StepClock)
        with edge.lock:
            self._spool = Spool(self.path, {**edge_notes(edge), **(notes or {})}, self._on_failure)
            edge.attach(self)
        self._tap = LogTap(self._on_log, edge.clock.realtime_us)
        logging.getLogger("asimov_gym").addHandler(self._tap)
        atexit.register(self.close)

    @property
    def failure(self) -> str:
        """Why the recording ended before it was closed; empty if it did not."""
        return self._spool.failure

    @property
    def written(self) -> Counter[str]:
        """Messages handed to the file so far, by topic."""
        return Counter(self._spool.written)

    def close(self) -> None:
        """Stop recording and finish the file. Closing twice does nothing."""
        atexit.unregister(self.close)
        logging.getLogger("asimov_gym").removeHandler(self._tap)
        self._edge.detach(self)
        self._spool.close()

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
            source=client.source.name,
            dialect="" if verdict.dialect is None else verdict.dialect.value,
            client_dialects=[dialect.value for dialect in client.dialects],
        )
        self._put(COMMANDS, received_us, record.SerializeToString())

    def on_telemetry(self, timestamp_us: int, packet: bytes) -> None:
        """Record a telemetry frame."""
        self._put(STATE, timestamp_us, packet)

    def on_robot_state(self, timestamp_us: int, packet: bytes, report: bool) -> None:
        """Record a frame of the other dialect."""
        self._put(ROBOT_STATE, timestamp_us, packet)

    def on_event(self, timestamp_us: int, packet: bytes) -> None:
        """Record an event."""
        self._put(SYSTEM, timestamp_us, packet)

    def _put(self, topic: str, time_us: int, data: bytes) -> None:
        # In lockstep nothing is late while the robot waits for the disk; in real time it must not.
        self._spool.put(topic, time_us, data, wait=self._patient)

    # -- log and failure ---------------------------------------------------------------------------

    def _on_log(self, time_us: int, data: bytes) -> None:
        # Never waits: the line may be one of the thread that makes room.
        self._spool.put(LOG, time_us, data)

    def _on_failure(self, reason: str) -> None:
        _log.error("recording %s ends: %s; the robot goes on without", self.path, reason)
        # Not for ever: whoever closes the recorder may hold the lock, and wait for the thread that is here.
        if self._edge.lock.acquire(timeout=_LOCK_PATIENCE_S):
            try:
                self._edge.error(Code.RECORDER, f"the recording ends: {reason}")
            finally:
                self._edge.lock.release()
