"""Reading recordings back: whole, cut off, damaged, older and newer than this version."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from asimov_gym.edge import SimulatedRobot
from asimov_gym.edge.wire import cloud_pb2
from asimov_gym.recording import COMMANDS, STATE, SYSTEM, Recorder, read_notes, read_recording
from asimov_gym.recording.reader import is_complete


def test_reader_names_what_is_wrong(recording: Path, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="unknown; a recording has /commands, /state, /robot_state, /system, /log"):
        read_recording(recording, ["/camera"])
    with pytest.raises(FileNotFoundError):
        list(read_recording(tmp_path / "nothing.mcap"))
    (tmp_path / "other.mcap").write_bytes(b"no recording at all")
    (tmp_path / "empty.mcap").write_bytes(b"")
    for name in ("other.mcap", "empty.mcap"):
        for read in (read_notes, lambda path: list(read_recording(path))):
            with pytest.raises(ValueError, match=f"{name} is not a readable recording"):
                read(tmp_path / name)
        assert not is_complete(tmp_path / name)


def test_a_recording_is_read_as_far_as_it_goes_wherever_it_was_cut(
    recording: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    whole = recording.read_bytes()
    full = [(entry.topic, entry.time_us) for entry in read_recording(recording)]
    assert is_complete(recording)
    cut = tmp_path / "cut.mcap"
    lengths = []
    # Besides, every place in the index and the footer at the end, which have fields of all kinds.
    for length in (*(int(share * len(whole)) for share in (0.1, 0.5, 0.97)), *range(len(whole) - 500, len(whole), 3)):
        cut.write_bytes(whole[:length])
        found = [(entry.topic, entry.time_us) for entry in read_recording(cut)]
        assert found == full[: len(found)]
        assert not is_complete(cut)
        assert read_notes(cut) == read_notes(recording)
        lengths.append(len(found))
    assert lengths == sorted(lengths) and lengths[-1] == len(full)
    assert "was cut off" in caplog.text


def test_blocks_are_closed_by_time(tmp_path: Path) -> None:
    """Each block is its own loss: a slow robot's must not wait for a megabyte."""
    robot = SimulatedRobot()
    with Recorder(tmp_path / "slow.mcap", robot.edge) as recorder:
        for _ in range(3):
            robot.advance(0.1)
            time.sleep(0.75)
            seen = recorder.path.read_bytes()
            (tmp_path / "seen.mcap").write_bytes(seen)
            frames = list(read_recording(tmp_path / "seen.mcap", [STATE]))
            assert len(frames) == round(robot.clock.now_us() / 100_000)


@pytest.mark.parametrize("place", [0.3, 0.6])
def test_damage_within_the_file_is_told(recording: Path, tmp_path: Path, place: float) -> None:
    damaged = bytearray(recording.read_bytes())
    with recording.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    chunk = summary.chunk_indexes[0]
    at = chunk.chunk_start_offset + int(place * chunk.chunk_length)
    damaged[at : at + 40] = bytes(40)
    (tmp_path / "damaged.mcap").write_bytes(damaged)
    with pytest.raises(ValueError, match=r"damaged\.mcap is not a readable recording"):
        list(read_recording(tmp_path / "damaged.mcap"))


def test_topics_of_later_versions_are_left_out(
    recording: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "newer.mcap"
    with recording.open("rb") as old, path.open("wb") as new:
        writer = Writer(new)
        writer.start(profile="", library="asimov-gym")
        channels = {}
        writer.add_metadata("asimov_gym", read_notes(recording))
        odd = writer.register_channel("/joystick", "json", writer.register_schema("Joystick", "jsonschema", b"{}"))
        for schema, channel, message in make_reader(old).iter_messages():
            assert schema is not None
            if channel.topic not in channels:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.topic] = writer.register_channel(channel.topic, "protobuf", number)
            writer.add_message(channels[channel.topic], message.log_time, message.data, message.publish_time)
            writer.add_message(odd, message.log_time, b"{}", message.publish_time)
        writer.finish()
    assert len(list(read_recording(path))) == len(list(read_recording(recording)))
    assert caplog.text.count("/joystick is unknown to this version and left out") == 1


def test_a_topic_with_another_message_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "foreign.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel(STATE, "protobuf", writer.register_schema("some.State", "protobuf", b""))
        writer.add_message(channel, 1, b"", 1)
        writer.finish()
    with pytest.raises(ValueError, match=r"/state holds some\.State, not asimov_gym\.edge\.cloud\.EdgeTelemetry"):
        list(read_recording(path))
    with pytest.raises(ValueError, match="not one of this project's recordings"):
        read_notes(path)


def test_recordings_of_earlier_versions_stay_readable(old_recording: Path) -> None:
    entries = list(read_recording(old_recording))
    counts = {topic: sum(entry.topic == topic for entry in entries) for topic in (COMMANDS, STATE, SYSTEM)}
    assert counts == {COMMANDS: 6, STATE: 20, SYSTEM: 9} and sum(counts.values()) == len(entries)
    commands = [entry.message for entry in entries if entry.topic == COMMANDS]
    told = [(c.client, c.kind, c.verdict, list(c.notes)) for c in commands]  # type: ignore[attr-defined]
    assert told == [
        ("tester", "velocity", "VELOCITY_IN_DAMP", []),
        ("tester", "mode", "accepted", []),
        ("tester", "", "MALFORMED", []),
        ("tester", "velocity", "accepted", []),
        ("tester", "trajectory", "accepted", ["POSITION_CLAMPED", "GAIN_CLAMPED"]),
        ("tester", "mode", "accepted", []),
    ]
    last = [entry.message for entry in entries if entry.topic == STATE][-1]
    assert isinstance(last, cloud_pb2.EdgeTelemetry)
    assert len(last.joint_pos) == 25 and last.fw_mode == cloud_pb2.FW_MODE_DAMP
    assert read_notes(old_recording)["seed"] == "3"
