from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.reader import make_reader

from asimov_gym.edge import SimulatedRobot, connect
from asimov_gym.edge.wire import cloud_pb2, recording_pb2
from asimov_gym.recording import COMMANDS, STATE, SYSTEM, TOPICS, Recorder, read_notes, read_recording


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    path = tmp_path / "folder" / "run.mcap"
    robot = SimulatedRobot()
    with Recorder(path, robot.edge, {"policy": "none"}), connect(robot, "tester") as session:
        robot.advance(0.2)
        session.stand()
        robot.advance(0.3)
        session.commands.send(b"\xff\xff")
        session.trajectory(list(session.state.get().joint_pos), kp=np.full(25, 900.0))
        robot.advance(0.5)
    session_after = connect(robot, "late")
    session_after.stand()
    robot.advance(0.5)
    return path


def test_every_command_is_there_with_its_verdict(recording: Path) -> None:
    commands = [entry.message for entry in read_recording(recording, [COMMANDS])]
    assert all(isinstance(command, recording_pb2.RecordedCommand) for command in commands)
    told = [(c.client, c.kind, c.verdict, list(c.notes)) for c in commands]  # type: ignore[attr-defined]
    assert told == [
        ("tester", "mode", "accepted", []),
        ("tester", "", "MALFORMED", []),
        ("tester", "trajectory", "accepted", ["GAIN_CLAMPED"]),
    ]
    first = cloud_pb2.CloudCommand.FromString(commands[0].payload)  # type: ignore[attr-defined]
    assert (first.WhichOneof("command"), first.mode.mode) == ("mode", cloud_pb2.MODE_STAND)
    assert commands[1].payload == b"\xff\xff"  # type: ignore[attr-defined]


def test_every_telemetry_frame_and_event_is_there_in_order(recording: Path) -> None:
    entries = list(read_recording(recording))
    assert [entry.time_us for entry in entries] == sorted(entry.time_us for entry in entries)
    frames = [entry.message for entry in entries if entry.topic == STATE]
    assert len(frames) == 10
    assert [frame.fw_timestamp_us for frame in frames] == [100_000 * (i + 1) for i in range(10)]  # type: ignore[attr-defined]
    codes = [entry.message.error.code for entry in entries if entry.topic == SYSTEM]  # type: ignore[attr-defined]
    assert codes[:1] == ["boot"]
    assert codes.count("mode_change") == 3


def test_notes_are_kept(recording: Path) -> None:
    assert read_notes(recording)["policy"] == "none"


def test_the_file_explains_itself_to_other_programs(recording: Path) -> None:
    """Decode with nothing but the schemas in the file, as a viewer does."""
    seen = set()
    with recording.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            assert schema is not None and schema.encoding == channel.message_encoding == "protobuf"
            pool = descriptor_pool.DescriptorPool()
            for proto in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
                pool.Add(proto)
            kind = message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))
            assert kind.FromString(message.data).SerializeToString(deterministic=True)
            seen.add(channel.topic)
    assert seen == set(TOPICS)


def test_reader_names_what_is_wrong(recording: Path, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="unknown; a recording has /commands, /state, /system"):
        list(read_recording(recording, ["/camera"]))
    with pytest.raises(FileNotFoundError):
        list(read_recording(tmp_path / "nothing.mcap"))
    (tmp_path / "other.mcap").write_bytes(b"no recording at all")
    with pytest.raises(ValueError, match="is not a readable recording"):
        list(read_recording(tmp_path / "other.mcap"))


def test_recording_of_a_killed_process_is_read_as_far_as_it_goes(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    robot = SimulatedRobot()
    with Recorder(tmp_path / "whole.mcap", robot.edge) as recorder:
        robot.advance(12.0)
        so_far = recorder.path.read_bytes()
    (tmp_path / "cut.mcap").write_bytes(so_far)
    frames = list(read_recording(tmp_path / "cut.mcap", [STATE]))
    assert 40 <= len(frames) < 120
    assert "was cut off" in caplog.text
    assert len(list(read_recording(tmp_path / "whole.mcap", [STATE]))) == 120
