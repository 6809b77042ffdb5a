"""The robot's speaker: what clients send is written into a WAV file."""

from __future__ import annotations

import logging
import os
import struct
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np

from asimov_gym.edge.media.sounds import FULL_SCALE, SAMPLE_RATE

_log = logging.getLogger(__name__)

LONGEST_BYTES = 2**32 - 1 - 36
"""Sound that a WAV file can hold; about 12 hours."""
_HEADER = struct.Struct("<4sI4s4sIHHIIHH4sI")


class SpeakerFile:
    """A WAV file, 48 kHz, 16 bits, one channel, that can be played at any moment, even after the robot was killed.

    It holds what was received, end to end: time in which nothing came takes no place in the file. (A client that keeps
    its track open sends silence by itself.)

    Args:
        path: file to write; an old one is replaced.
        on_failure: told once, in one line, when no more can be written.

    Raises:
        OSError: the file cannot be written.
    """

    def __init__(self, path: Path, on_failure: Callable[[str], None] = lambda reason: None) -> None:
        self.path = path
        self._on_failure = on_failure
        self.error = ""
        """Why writing ended early; empty if it did not."""
        self._lock = threading.Lock()
        self._resampler = Resampler(SAMPLE_RATE)
        self._bytes = 0
        self._file = open(path, "wb", buffering=0)  # noqa: SIM115, closed in close()
        self._file.write(_header(0))

    @property
    def seconds(self) -> float:
        """Length of the sound so far."""
        return self._bytes / (2 * SAMPLE_RATE)

    def write(self, samples: np.ndarray, rate: int = SAMPLE_RATE) -> None:
        """Play sound. When the disk or the file is full it is lost, which is logged once.

        Args:
            samples: (n,) int16, or (n, channels), which are averaged.
            rate: samples per second, 8000 to 48000. Others than 48000 are resampled linearly, good enough for speech.

        Raises:
            ValueError: wrong shape, type or rate.
        """
        if samples.dtype != np.int16 or samples.ndim not in (1, 2):
            raise ValueError(
                f"samples must be int16 with shape (n,) or (n, channels), got {samples.dtype} {samples.shape}"
            )
        mono = samples if samples.ndim == 1 else np.rint(samples.mean(axis=1)).astype(np.int16)
        with self._lock:
            if self._file.closed:
                return
            if rate != self._resampler.rate:
                self._resampler = Resampler(rate)
            data = self._resampler.resample(mono).astype("<i2").tobytes()
            try:
                self._append(data)
            except OSError as error:
                self.error = f"{self.path}: {error.strerror or error}"
                self._file.close()
        if self.error:
            _log.error("the speaker is off: %s", self.error)
            self._on_failure(self.error)

    def close(self) -> None:
        """Close the file. No effect if it is closed."""
        with self._lock:
            self._file.close()

    def __enter__(self) -> SpeakerFile:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def _append(self, data: bytes) -> None:
        if self._bytes + len(data) > LONGEST_BYTES:
            raise OSError("a WAV file can hold no more")
        rest = memoryview(data)
        while rest:  # a write without a buffer may take less
            rest = rest[self._file.write(rest) :]
        self._bytes += len(data)
        # First the sound, then the length that includes it: the file is complete at every moment.
        os.pwrite(self._file.fileno(), _header(self._bytes), 0)


class Resampler:
    """Brings a stream of sound to 48 kHz, piece by piece, by straight lines between samples.

    Args:
        rate: of the stream, 8000 to 48000 Hz.

    Raises:
        ValueError: the rate is out of range.
    """

    def __init__(self, rate: int) -> None:
        if not 8_000 <= rate <= SAMPLE_RATE:
            raise ValueError(f"rate must be from 8000 to {SAMPLE_RATE} Hz, got {rate}")
        self.rate = rate
        self._last = np.zeros(0, dtype=np.int16)
        self._place = 0
        """Place of the next sample after the last one of the stream so far, in steps of 1/48000 of a sample."""

    def resample(self, samples: np.ndarray) -> np.ndarray:
        """The next piece, (n,) int16; the pieces together are the whole, without a seam."""
        if self.rate == SAMPLE_RATE or not len(samples):
            return samples
        known = np.concatenate([self._last, samples])
        end = (len(known) - 1) * SAMPLE_RATE
        places = np.arange(self._place, end + 1, self.rate)
        self._place += len(places) * self.rate - end
        self._last = known[-1:]
        made = np.interp(places / SAMPLE_RATE, np.arange(len(known)), known)
        return np.rint(np.clip(made, -FULL_SCALE - 1, FULL_SCALE)).astype(np.int16)


def _header(length: int) -> bytes:
    """Header of a WAV file with so many bytes of sound."""
    return _HEADER.pack(
        b"RIFF", 36 + length, b"WAVE", b"fmt ", 16, 1, 1, SAMPLE_RATE, 2 * SAMPLE_RATE, 2, 16, b"data", length
    )
