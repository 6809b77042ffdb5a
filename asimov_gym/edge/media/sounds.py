"""What a microphone may hear: silence, a tone, a recording. Pure functions of time."""

from __future__ import annotations

import math
import wave
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

SAMPLE_RATE = 48_000
"""Samples per second of all sound on the robot; 16 bits, one channel."""
FULL_SCALE = 32767.0
LONGEST_RECORDING_S = 600.0
"""A recording is held in memory as a whole."""


class Sound(Protocol):
    """Something to be heard."""

    def samples(self, start: int, count: int) -> np.ndarray:
        """Samples `start` to `start + count`, counted from the beginning of time, (count,) int16."""
        ...


class Silence:
    """Nothing."""

    def samples(self, start: int, count: int) -> np.ndarray:
        return np.zeros(count, dtype=np.int16)


@dataclass(frozen=True)
class Tone:
    """A steady sine.

    Raises:
        ValueError: the frequency is out of range.
    """

    hz: float = 440.0
    """20 to 20000 Hz."""
    level: float = 0.25
    """Amplitude as a share of full scale, above 0 to 1."""

    def __post_init__(self) -> None:
        if not 20.0 <= self.hz <= 20_000.0:
            raise ValueError(f"a tone must be from 20 to 20000 Hz, got {self.hz:g}")
        if not 0.0 < self.level <= 1.0:
            raise ValueError(f"level must be above 0 and at most 1, got {self.level:g}")

    def samples(self, start: int, count: int) -> np.ndarray:
        # Whole turns are dropped before the sine, which would lose digits after hours.
        turns = math.fmod(start * self.hz / SAMPLE_RATE, 1.0) + np.arange(count) * (self.hz / SAMPLE_RATE)
        return np.rint(self.level * FULL_SCALE * np.sin(2.0 * np.pi * turns)).astype(np.int16)


class Recording:
    """A WAV file, over and over again without a gap. Channels are averaged, other rates resampled.

    Args:
        path: PCM file of 8, 16, 24 or 32 bits, 4 to 192 kHz, at most ten minutes.

    Raises:
        ValueError: there is no such file, or it is none of these; says what is wrong.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._loop = np.rint(np.clip(_resampled(*_read(path)), -1.0, 1.0) * FULL_SCALE).astype(np.int16)

    @property
    def length(self) -> int:
        """Samples until it begins again."""
        return len(self._loop)

    def samples(self, start: int, count: int) -> np.ndarray:
        return self._loop[(start + np.arange(count)) % len(self._loop)]


def sound(description: str) -> Sound:
    """The sound that a person means by `silence`, `tone`, `tone:HZ` or the name of a WAV file.

    Raises:
        ValueError: none of these; says what is allowed.
    """
    kind, _, hz = description.partition(":")
    if description == "silence":
        return Silence()
    if description == "tone":
        return Tone()
    if kind == "tone":
        try:
            frequency = float(hz)
        except ValueError:
            raise ValueError(f"a tone is tone or tone:HZ, such as tone:440; got {description!r}") from None
        return Tone(frequency)
    if not Path(description).exists():
        raise ValueError(f"a microphone hears silence, tone, tone:HZ or a WAV file; there is no file {description!r}")
    return Recording(Path(description))


def _read(path: Path) -> tuple[np.ndarray, int]:
    """Samples of a WAV file, −1 to 1, (n,), and their rate."""
    cure = f"convert it with: ffmpeg -i {path.name} -ar {SAMPLE_RATE} -ac 1 -c:a pcm_s16le microphone.wav"
    try:
        with wave.open(str(path), "rb") as file:
            channels, width, rate = file.getnchannels(), file.getsampwidth(), file.getframerate()
            # A writer that was killed, or a pipe, leaves a wrong length: the rate bounds what is read.
            raw = file.readframes(min(file.getnframes(), round(rate * LONGEST_RECORDING_S) + 1))
    except (wave.Error, EOFError, OSError) as error:
        reason = str(error) or "it ends too early"
        raise ValueError(f"{path} is no WAV file that can be read: {reason}; {cure}") from error
    if not 4_000 <= rate <= 192_000:
        raise ValueError(f"{path}: the rate must be from 4000 to 192000 Hz, got {rate}; {cure}")
    if width not in (1, 2, 3, 4):
        raise ValueError(f"{path}: samples must have 8, 16, 24 or 32 bits, got {8 * width}; {cure}")
    frames = len(raw) // (channels * width)
    if frames == 0:
        raise ValueError(f"{path} holds no sound")
    if frames > rate * LONGEST_RECORDING_S:
        raise ValueError(f"{path} is longer than {LONGEST_RECORDING_S:.0f} s; cut it")
    octets = np.frombuffer(raw, dtype=np.uint8, count=frames * channels * width).reshape(frames, channels, width)
    if width == 1:
        values = octets[..., 0].astype(np.float64) / 128.0 - 1.0  # the only unsigned one
    else:
        padded = np.zeros((frames, channels, 4), dtype=np.uint8)
        padded[..., 4 - width :] = octets  # little-endian: the sample fills the upper bytes
        values = padded.view("<i4")[..., 0].astype(np.float64) / 2.0**31
    return values.mean(axis=1), rate


def _resampled(values: np.ndarray, rate: int) -> np.ndarray:
    """A loop of sound at the robot's rate. It is periodic, so cutting or extending its spectrum is exact."""
    if rate == SAMPLE_RATE:
        return values
    length = max(1, round(len(values) * SAMPLE_RATE / rate))
    spectrum = np.fft.rfft(values)[: length // 2 + 1]
    return np.fft.irfft(spectrum, length) * (length / len(values))
