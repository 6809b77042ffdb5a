"""Microphone and speaker: true pitch, no gap, no drift, files that can be read."""

from __future__ import annotations

import subprocess
import sys
import time
import wave
from pathlib import Path

import numpy as np
import pytest

from asimov_gym.edge.media import microphone, speaker
from asimov_gym.edge.media.microphone import AudioFrame, Microphone
from asimov_gym.edge.media.sounds import SAMPLE_RATE, Recording, Silence, Tone, sound
from asimov_gym.edge.media.speaker import Resampler, SpeakerFile
from asimov_gym.firmware import StepClock


def pitch(samples: np.ndarray, rate: int = SAMPLE_RATE) -> float:
    """Frequency of the strongest tone, Hz."""
    spectrum = np.abs(np.fft.rfft(samples * np.hanning(len(samples)), 8 * len(samples)))
    return float(np.argmax(spectrum)) * rate / (8 * len(samples))


def write_wav(path: Path, values: np.ndarray, rate: int, width: int = 2) -> Path:
    """`values` is (n, channels), −1 to 1."""
    numbers = np.rint(np.clip(values, -1.0, 1.0) * (2 ** (8 * width - 1) - 1)).astype(np.int64)
    if width == 1:
        numbers += 128
    octets = numbers.astype("<i8").view(np.uint8).reshape(*numbers.shape, 8)[..., :width]
    with wave.open(str(path), "wb") as file:
        file.setparams((values.shape[1], width, rate, 0, "NONE", ""))
        file.writeframes(octets.tobytes())
    return path


def read_wav(path: Path) -> np.ndarray:
    with wave.open(str(path), "rb") as file:
        assert (file.getnchannels(), file.getsampwidth(), file.getframerate()) == (1, 2, SAMPLE_RATE)
        frames = file.readframes(file.getnframes())
        assert len(frames) == 2 * file.getnframes()  # the header promises no more than there is
        return np.frombuffer(frames, dtype="<i2")


def sine(hz: float, seconds: float, rate: int) -> np.ndarray:
    return 0.5 * np.sin(2.0 * np.pi * hz * np.arange(round(seconds * rate)) / rate)


# -- sounds ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("description", "hz"), [("tone", 440.0), ("tone:1000", 1000.0), ("tone:261.63", 261.63)])
def test_tone_has_its_pitch_without_a_seam(description: str, hz: float) -> None:
    tone = sound(description)
    hour = 3600 * SAMPLE_RATE
    pieces = np.concatenate([tone.samples(hour + start, 480) for start in range(0, SAMPLE_RATE, 480)])
    assert pieces.dtype == np.int16
    assert pitch(pieces) == pytest.approx(hz, abs=0.2)
    assert np.abs(pieces).max() == pytest.approx(0.25 * 32767, rel=0.01)
    np.testing.assert_allclose(pieces, tone.samples(hour, SAMPLE_RATE), atol=1)


def test_silence_is_silent() -> None:
    assert isinstance(sound("silence"), Silence)
    assert not sound("silence").samples(5, 480).any()


@pytest.mark.parametrize(
    ("rate", "width", "channels"), [(48000, 2, 1), (44100, 2, 2), (16000, 1, 1), (96000, 3, 2), (22050, 4, 1)]
)
def test_recording_keeps_its_pitch_and_loops(tmp_path: Path, rate: int, width: int, channels: int) -> None:
    values = np.repeat(sine(500.0, 0.1, rate)[:, None], channels, axis=1)
    recording = sound(str(write_wav(tmp_path / "voice.wav", values, rate, width)))
    assert isinstance(recording, Recording)
    assert recording.length == 4800
    heard = recording.samples(0, 4800 * 5)
    # Fifty whole periods make up the file: looped, it is an endless tone.
    np.testing.assert_allclose(heard, 32767 * sine(500.0, 0.5, SAMPLE_RATE), atol=300 if width == 1 else 8)
    np.testing.assert_array_equal(recording.samples(4790, 20), np.tile(recording.samples(0, 4800), 2)[4790:4810])


def test_channels_are_averaged(tmp_path: Path) -> None:
    values = np.stack([np.full(480, 0.5), np.full(480, -0.1)], axis=1)
    heard = sound(str(write_wav(tmp_path / "two.wav", values, SAMPLE_RATE))).samples(0, 480)
    np.testing.assert_allclose(heard, 0.2 * 32767, atol=2)


def test_bad_descriptions_say_what_is_allowed(tmp_path: Path) -> None:
    empty, noise, short = tmp_path / "empty.wav", tmp_path / "noise.wav", tmp_path / "short.wav"
    write_wav(empty, np.zeros((0, 1)), SAMPLE_RATE)
    noise.write_bytes(b"this is no sound at all" * 10)
    short.write_bytes(b"RIFF")
    slow = write_wav(tmp_path / "slow.wav", np.zeros((10, 1)), 2000)
    floats = tmp_path / "floats.wav"
    floats.write_bytes(
        write_wav(tmp_path / "whole.wav", np.zeros((10, 1)), SAMPLE_RATE, 4)
        .read_bytes()
        .replace(b"\x10\x00\x00\x00\x01\x00", b"\x10\x00\x00\x00\x03\x00")
    )
    for description, message in (
        ("hum", "silence, tone, tone:HZ or a WAV file; there is no file 'hum'"),
        ("tone:high", "a tone is tone or tone:HZ"),
        ("tone:5", "from 20 to 20000 Hz, got 5"),
        ("tone:nan", "from 20 to 20000 Hz, got nan"),
        (str(empty), "holds no sound"),
        (str(noise), "no WAV file that can be read: .*ffmpeg"),
        (str(short), "no WAV file that can be read: .*ffmpeg"),
        (str(floats), "no WAV file that can be read: unknown format: 3; .*pcm_s16le"),
        (str(slow), "the rate must be from 4000 to 192000 Hz, got 2000"),
        (str(tmp_path), "no WAV file that can be read"),
    ):
        with pytest.raises(ValueError, match=message):
            sound(description)


def test_recording_that_is_too_long_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("asimov_gym.edge.media.sounds.LONGEST_RECORDING_S", 0.5)
    with pytest.raises(ValueError, match="longer than"):
        sound(str(write_wav(tmp_path / "long.wav", np.zeros((5000, 1)), 8000)))


# -- microphone --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("frame_ms", [10, 20])
def test_microphone_hears_in_real_time(frame_ms: int) -> None:
    frames: list[AudioFrame] = []
    began = time.time_ns() // 1000
    with Microphone(Tone(1000.0), frame_ms=frame_ms) as heard:
        heard.subscribe(frames.append)
        time.sleep(0.4)
    ended = time.time_ns() // 1000
    assert heard.sent + heard.skipped == pytest.approx((ended - began) / 1000 / frame_ms, abs=25 / frame_ms)
    if not heard.skipped:
        together = np.concatenate([frame.samples for frame in frames])
        np.testing.assert_array_equal(together[-4800:], Tone(1000.0).samples(0, len(together))[-4800:])
    times = np.array([frame.timestamp_us for frame in frames])
    # Spaced like the samples, however late the thread was; the rest is the granularity of two clocks.
    np.testing.assert_allclose(
        np.diff(times) / (1000 * frame_ms), np.rint(np.diff(times) / (1000 * frame_ms)), atol=0.1
    )
    assert began - 2000 <= times[0]
    assert times[-1] + 1000 * frame_ms <= ended + 2000


def test_microphone_skips_what_it_cannot_keep_up_with(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(microphone, "BACKLOG_S", 0.05)
    frames: list[AudioFrame] = []

    def slow(frame: AudioFrame) -> None:
        frames.append(frame)
        time.sleep(0.12 if len(frames) == 3 else 0.0)
        if len(frames) == 5:
            raise RuntimeError("a listener's mistake")

    began = time.monotonic()
    with Microphone(Tone(100.0)) as heard:
        heard.subscribe(slow)
        time.sleep(0.3)
    assert heard.skipped >= 10
    assert heard.sent + heard.skipped == pytest.approx((time.monotonic() - began) / 0.01, abs=3)
    gap_us = frames[3].timestamp_us - frames[2].timestamp_us
    assert gap_us == pytest.approx(10_000 * (1 + heard.skipped), abs=1000)
    # What is heard after the gap is what sounds then.
    step = round(gap_us / 10_000) * 480
    start = next(k for k in range(0, 4800, 480) if (frames[2].samples == Tone(100.0).samples(k, 480)).all())
    np.testing.assert_array_equal(frames[3].samples, Tone(100.0).samples(start + step, 480))


def test_microphone_reads_the_edges_clock() -> None:
    clock = StepClock(epoch_us=5_000_000)
    frames: list[AudioFrame] = []
    with Microphone(clock=clock) as heard:
        heard.subscribe(frames.append)
        time.sleep(0.05)
        heard.unsubscribe(frames.append)
    assert frames
    assert all(4_500_000 < frame.timestamp_us <= 4_990_000 for frame in frames)
    assert not heard.running
    with pytest.raises(ValueError, match="frame_ms must be one of 10, 20, got 15"):
        Microphone(frame_ms=15)


# -- speaker -----------------------------------------------------------------------------------------------------------


def test_speaker_file_survives_a_kill(tmp_path: Path) -> None:
    path = tmp_path / "speaker.wav"
    robot = f"""
import os, signal
from pathlib import Path
from asimov_gym.edge.media.sounds import Tone
from asimov_gym.edge.media.speaker import SpeakerFile
file = SpeakerFile(Path({str(path)!r}))
for start in range(0, 12000, 480):
    file.write(Tone(300.0).samples(start, 480))
os.kill(os.getpid(), signal.SIGKILL)
"""
    done = subprocess.run([sys.executable, "-c", robot], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == -9, done.stderr
    np.testing.assert_array_equal(read_wav(path), Tone(300.0).samples(0, 12000))


def test_speaker_file_can_be_read_at_any_moment(tmp_path: Path) -> None:
    with SpeakerFile(tmp_path / "speaker.wav") as file:
        assert len(read_wav(file.path)) == 0
        for count in range(1, 5):
            file.write(np.full(480, 100 * count, dtype=np.int16))
            time.sleep(0.01)  # silence of the client takes no place
            assert len(read_wav(file.path)) == 480 * count
        assert file.seconds == pytest.approx(0.04)
    file.write(np.zeros(480, dtype=np.int16))  # closed: no effect
    assert len(read_wav(file.path)) == 480 * 4


@pytest.mark.parametrize("rate", [8000, 16000, 24000, 44100])
def test_speaker_resamples_without_seams(tmp_path: Path, rate: int) -> None:
    stream = np.rint(32767 * sine(300.0, 1.0, rate)).astype(np.int16)
    with SpeakerFile(tmp_path / "speaker.wav") as file:
        for start in range(0, len(stream), 331):
            file.write(stream[start : start + 331], rate)
    heard = read_wav(file.path)
    assert len(heard) == pytest.approx(SAMPLE_RATE, abs=SAMPLE_RATE / rate + 1)
    assert pitch(heard) == pytest.approx(300.0, abs=0.2)
    np.testing.assert_allclose(heard, Resampler(rate).resample(stream), atol=1)  # rounding
    np.testing.assert_allclose(heard, 32767 * sine(300.0, 1.0, SAMPLE_RATE)[: len(heard)], atol=300)


def test_speaker_mixes_channels_and_refuses_what_is_no_sound(tmp_path: Path) -> None:
    with SpeakerFile(tmp_path / "speaker.wav") as file:
        file.write(np.tile(np.array([[1000, 3000]], dtype=np.int16), (480, 1)))
        for wrong, message in (
            (np.zeros(480), "samples must be int16"),
            (np.zeros((1, 2, 3), dtype=np.int16), "samples must be int16 with shape"),
        ):
            with pytest.raises(ValueError, match=message):
                file.write(wrong)
        with pytest.raises(ValueError, match="rate must be from 8000 to 48000 Hz, got 96000"):
            file.write(np.zeros(480, dtype=np.int16), 96000)
    assert (read_wav(file.path) == 2000).all()


def test_full_speaker_file_is_told_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(speaker, "LONGEST_BYTES", 2000)
    failures: list[str] = []
    with SpeakerFile(tmp_path / "speaker.wav", failures.append) as file:
        for _ in range(5):
            file.write(np.ones(480, dtype=np.int16))
    assert failures == [file.error]
    assert "a WAV file can hold no more" in file.error
    assert len(read_wav(file.path)) == 960
    with pytest.raises(OSError, match="no-such-folder"):
        SpeakerFile(tmp_path / "no-such-folder" / "speaker.wav")
