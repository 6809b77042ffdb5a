"""What the recorder takes, and that nothing it meets stops the robot."""

from __future__ import annotations

import logging
import resource
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.unknown_fields import UnknownFieldSet
from mcap.reader import make_reader

from asimov_gym.edge import Client, Dialect, EdgeListener, SimulatedRobot, Source
from asimov_gym.edge.wire import cloud_pb2, io_pb2, recording_pb2
from asimov_gym.firmware import WallClock
from asimov_gym.recording import (
    COMMANDS,
    LOG,
    ROBOT_STATE,
    STATE,
    SYSTEM,
    TOPICS,
    Recorder,
    read_notes,
    read_recording,
    spool,
)
from tests.recording.rehearsal import messages, record_run

ROOT = Path(__file__).parents[2]


class Events(EdgeListener):
    def __init__(self) -> None:
        self.errors: list[tuple[str, str]] = []

    def on_event(self, timestamp_us: int, packet: bytes) -> None:
        event = cloud_pb2.EdgeEvent.FromString(packet)
        self.errors.append((event.error.code, event.error.message))


def test_every_command_is_there_with_its_verdict_and_sender(recording: Path) -> None:
    posed = "POSITION_CLAMPED"  # where the walk took the joints depends on the policy
    told = [
        (c.client, c.source, c.kind, c.verdict, [note for note in c.notes if note != posed], c.dialect)
        for c in messages(recording, COMMANDS)
    ]
    assert told == [
        ("tester", "IN_PROCESS", "mode", "accepted", [], "cloud"),
        ("tester", "IN_PROCESS", "velocity", "accepted", [], "cloud"),
        ("tester", "IN_PROCESS", "", "MALFORMED", [], ""),
        ("tester", "IN_PROCESS", "trajectory", "accepted", ["GAIN_CLAMPED"], "cloud"),
        ("tester", "IN_PROCESS", "mode", "accepted", [], "cloud"),
    ]
    first = cloud_pb2.CloudCommand.FromString(messages(recording, COMMANDS)[0].payload)
    assert (first.WhichOneof("command"), first.mode.mode) == ("mode", cloud_pb2.MODE_STAND)
    assert messages(recording, COMMANDS)[2].payload == b"\xff\xff"


def test_a_command_of_the_other_dialect_is_recorded_as_such(tmp_path: Path) -> None:
    robot = SimulatedRobot()
    client = Client(Source.UDP, "udp 127.0.0.1:5", (Dialect.IO, Dialect.CLOUD))
    stand = io_pb2.RobotCommand(mode=io_pb2.CONTROL_MODE_STAND, protocol_version=1).SerializeToString()
    with Recorder(tmp_path / "io.mcap", robot.edge):
        verdict = robot.edge.receive(stand, client)
        robot.edge.receive(io_pb2.RobotCommand(protocol_version=7).SerializeToString(), client)
    assert verdict.accepted
    first, second = messages(tmp_path / "io.mcap", COMMANDS)
    assert (first.source, first.dialect, list(first.client_dialects)) == ("UDP", "io", ["io", "cloud"])
    assert first.payload == stand and second.verdict != "accepted"


def test_every_frame_event_and_log_line_is_there_in_order(recording: Path) -> None:
    entries = list(read_recording(recording))
    assert [entry.time_us for entry in entries] == sorted(entry.time_us for entry in entries)
    assert [m.fw_timestamp_us for m in messages(recording, STATE)] == [100_000 * (i + 1) for i in range(32)]
    assert [m.timestamp_us for m in messages(recording, ROBOT_STATE)] == [5000 * (i + 1) for i in range(640)]
    codes = [m.error.code for m in messages(recording, SYSTEM) if m.WhichOneof("event") == "error"]
    assert codes.count("boot") == 1 and codes.count("mode_change") == 4
    (line,) = [m for m in messages(recording, LOG) if m.name == "asimov_gym.edge.rehearsal"]
    assert line.message == "the rehearsal is on"
    assert (line.level, line.file) == (recording_pb2.LogLine.ERROR, "rehearsal.py")
    dropped = [m.message for m in messages(recording, LOG) if m.level == recording_pb2.LogLine.WARNING]
    assert any("MALFORMED" in text for text in dropped)


def test_log_lines_below_the_logger_s_level_stay_out(tmp_path: Path) -> None:
    logger = logging.getLogger("asimov_gym")
    robot = SimulatedRobot()
    with Recorder(tmp_path / "log.mcap", robot.edge):
        logger.info("unheard")
        logger.setLevel(logging.DEBUG)
        logger.debug("heard")
        try:
            raise KeyError("why")
        except KeyError:
            logger.exception("and \ud800 this")
    logger.error("too late")
    heard, failed = messages(tmp_path / "log.mcap", LOG)
    assert (heard.message, heard.level) == ("heard", recording_pb2.LogLine.DEBUG)
    assert failed.message.startswith("and ? this") and "KeyError: 'why'" in failed.message


def test_notes_name_versions_settings_and_policy(recording: Path) -> None:
    notes = read_notes(recording)
    assert notes["purpose"] == "test"
    assert (notes["policy"], notes["seed"], notes["time"], notes["ankle"]) == (
        "asimov_walk.onnx",
        "5",
        "lockstep",
        "linear",
    )
    assert len(notes["policy_sha256"]) == 64
    assert {"asimov_gym", "mujoco", "numpy", "python", "started", "firmware_config"} <= set(notes)


def test_the_file_explains_itself_to_other_programs(recording: Path) -> None:
    """Decode with nothing but the schemas in the file, as a viewer does."""
    seen = {}
    with recording.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            assert schema is not None and schema.encoding == channel.message_encoding == "protobuf"
            pool = descriptor_pool.DescriptorPool()
            for proto in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
                pool.Add(proto)
            kind = message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))
            decoded: Any = kind.FromString(message.data)
            assert decoded.SerializeToString(deterministic=True)
            assert len(UnknownFieldSet(decoded)) == 0
            seen[channel.topic] = schema.name
    assert set(seen) == set(TOPICS)
    assert seen[LOG] == "foxglove.Log"


def test_the_log_has_the_fields_of_foxglove_s_log(recording: Path) -> None:
    """Names, numbers and types that Foxglove's log panel looks for, from its published schema."""
    with recording.open("rb") as file:
        schema, _, message = next(iter(make_reader(file).iter_messages(topics=[LOG])))
    assert schema is not None
    pool = descriptor_pool.DescriptorPool()
    for proto in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
        pool.Add(proto)
    log = pool.FindMessageTypeByName("foxglove.Log")
    kind = descriptor_pb2.FieldDescriptorProto
    assert {field.name: (field.number, field.type) for field in log.fields} == {
        "timestamp": (1, kind.TYPE_MESSAGE),
        "level": (2, kind.TYPE_ENUM),
        "message": (3, kind.TYPE_STRING),
        "name": (4, kind.TYPE_STRING),
        "file": (5, kind.TYPE_STRING),
        "line": (6, kind.TYPE_FIXED32),
    }
    levels = {value.name: value.number for value in log.fields_by_name["level"].enum_type.values}
    assert levels == {"UNKNOWN": 0, "DEBUG": 1, "INFO": 2, "WARNING": 3, "ERROR": 4, "FATAL": 5}
    assert log.fields_by_name["timestamp"].message_type.full_name == "google.protobuf.Timestamp"
    decoded: Any = message_factory.GetMessageClass(log).FromString(message.data)
    assert decoded.timestamp.seconds * 10**9 + decoded.timestamp.nanos == message.log_time
    # A second program's copy of Foxglove's own messages must still load beside ours.
    with pytest.raises(KeyError):
        descriptor_pool.Default().FindMessageTypeByName("foxglove.Log")


def test_the_same_run_is_recorded_the_same(recording: Path, tmp_path: Path) -> None:
    record_run(tmp_path / "again.mcap")
    for topic in TOPICS:
        assert [_timeless(m) for m in messages(recording, topic)] == [
            _timeless(m) for m in messages(tmp_path / "again.mcap", topic)
        ], topic


def _timeless(message: Any) -> bytes:
    """A message without the times that the network took on this machine."""
    if isinstance(message, cloud_pb2.EdgeEvent) and message.WhichOneof("event") == "diagnostics":
        message.diagnostics.ClearField("onnx_avg_ms")
        message.diagnostics.ClearField("onnx_max_ms")
    if isinstance(message, io_pb2.RobotState):
        message.ClearField("onnx_metrics")
        message.ClearField("policy_timing")
    return message.SerializeToString(deterministic=True)


def test_robot_state_is_asked_for_only_on_request(tmp_path: Path) -> None:
    robot = SimulatedRobot()
    with Recorder(tmp_path / "plain.mcap", robot.edge) as recorder:
        robot.advance(0.1)
    assert recorder.written[STATE] == 1 and recorder.written[ROBOT_STATE] == 0


def test_nothing_recorded_is_overwritten(tmp_path: Path) -> None:
    (tmp_path / "kept.mcap").write_bytes(b"precious")
    with pytest.raises(FileExistsError, match="never overwritten"):
        Recorder(tmp_path / "kept.mcap", SimulatedRobot().edge)
    assert (tmp_path / "kept.mcap").read_bytes() == b"precious"
    assert not logging.getLogger("asimov_gym").handlers


def test_closing_twice_is_no_effect(tmp_path: Path) -> None:
    robot = SimulatedRobot()
    recorder = Recorder(tmp_path / "twice.mcap", robot.edge)
    robot.advance(0.1)
    recorder.close()
    size = recorder.path.stat().st_size
    recorder.close()
    robot.advance(0.5)
    assert recorder.path.stat().st_size == size
    assert len(messages(recorder.path, STATE)) == 1


def test_a_recorder_that_nobody_closes_is_finished_when_python_ends(tmp_path: Path) -> None:
    code = (
        "import sys; from asimov_gym.edge import SimulatedRobot; from asimov_gym.recording import Recorder;"
        "robot = SimulatedRobot(); Recorder(sys.argv[1], robot.edge); robot.advance(1.0)"
    )
    path = tmp_path / "left.mcap"
    subprocess.run([sys.executable, "-c", code, str(path)], check=True, cwd=ROOT, timeout=60)
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None and summary.statistics is not None
    assert len(messages(path, STATE)) == 10


def test_warnings_still_reach_a_terminal_that_configured_no_log(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(logging.getLogger(), "handlers", [])
    robot = SimulatedRobot()
    with Recorder(tmp_path / "a.mcap", robot.edge), Recorder(tmp_path / "b.mcap", robot.edge):
        logging.getLogger("asimov_gym.edge").warning("look here")
    assert capsys.readouterr().err.count("look here") == 1


# -- a disk that fails -----------------------------------------------------------------------------


@pytest.fixture
def small_files() -> Iterator[None]:
    """The system refuses to let a file grow beyond 64 KiB, as a full disk would."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (64 * 1024, hard))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_a_full_disk_ends_the_recording_and_not_the_robot(
    tmp_path: Path, small_files: None, caplog: pytest.LogCaptureFixture
) -> None:
    robot, events = SimulatedRobot(), Events()
    robot.edge.attach(events)
    recorder = Recorder(tmp_path / "full.mcap", robot.edge, robot_state=True)
    for _ in range(40):
        robot.advance(0.5)
        if recorder.failure:
            break
    recorder.close()
    before = robot.clock.now_us()
    robot.advance(0.5)
    assert robot.clock.now_us() == before + 500_000
    assert "File too large" in recorder.failure
    assert [code for code, _ in events.errors].count("recorder") == 1
    assert caplog.text.count("the robot goes on without") == 1
    frames = messages(recorder.path, ROBOT_STATE)
    assert [m.sequence for m in frames] == list(range(1, len(frames) + 1)), "no hole before the end"


def test_a_disk_that_hangs_never_holds_a_robot_in_real_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    free = threading.Event()
    monkeypatch.setattr(spool, "QUEUE_LIMIT_BYTES", 40_000)
    robot, events = SimulatedRobot(clock=WallClock()), Events()
    robot.edge.attach(events)
    recorder = Recorder(tmp_path / "hangs.mcap", robot.edge, robot_state=True)
    write = recorder._spool._writer.add_message
    monkeypatch.setattr(recorder._spool._writer, "add_message", lambda *args: (free.wait(20.0), write(*args))[1])
    for _ in range(400):
        robot._step()
        if recorder.failure:
            break
    assert "too slow" in recorder.failure
    assert ("recorder", f"the recording ends: {recorder.failure}") in events.errors
    taken = robot.firmware.snapshot.tick
    free.set()
    recorder.close()
    frames = messages(recorder.path, ROBOT_STATE)
    assert 0 < len(frames) <= taken
    assert [m.sequence for m in frames] == list(range(1, len(frames) + 1)), "all that was queued is in the file"


def test_a_robot_in_lockstep_waits_for_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(spool, "QUEUE_LIMIT_BYTES", 20_000)
    robot = SimulatedRobot()
    with Recorder(tmp_path / "waits.mcap", robot.edge, robot_state=True) as recorder:
        robot.advance(2.0)
    assert not recorder.failure
    assert len(messages(recorder.path, ROBOT_STATE)) == 400
