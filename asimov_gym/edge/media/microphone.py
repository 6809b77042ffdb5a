"""The robot's microphone: frames of sound, as fast as time goes by."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from asimov_gym.edge.media.sounds import SAMPLE_RATE, Silence, Sound
from asimov_gym.firmware import MICROSECONDS, Clock, WallClock

_log = logging.getLogger(__name__)

FRAME_MS = (10, 20)
"""Lengths of a frame that a microphone offers, ms."""
BACKLOG_S = 0.2
"""Later than this the microphone skips what nobody took, instead of making up for it."""


@dataclass(frozen=True)
class AudioFrame:
    """A piece of sound, 48 kHz, one channel."""

    timestamp_us: int
    """Edge wall clock at its first sample."""
    samples: np.ndarray
    """(n,) int16; 480 for 10 ms."""


class Microphone:
    """Hears a sound and hands it on in frames, in a thread of its own, paced by real time.

    Args:
        sound: what is heard.
        clock: the edge's, for the timestamps.
        frame_ms: length of a frame, 10 or 20 ms.

    Raises:
        ValueError: `frame_ms` is neither.
    """

    def __init__(self, sound: Sound | None = None, clock: Clock | None = None, frame_ms: int = 10) -> None:
        if frame_ms not in FRAME_MS:
            raise ValueError(f"frame_ms must be one of {', '.join(map(str, FRAME_MS))}, got {frame_ms}")
        self.sound = sound or Silence()
        self.clock = clock or WallClock()
        self.frame_samples = SAMPLE_RATE * frame_ms // 1000
        self.sent = 0
        """Frames handed on since `start`."""
        self.skipped = 0
        """Frames that were never made because the machine was too slow."""
        self._frame_s = frame_ms / 1000
        self._listeners: list[Callable[[AudioFrame], None]] = []
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None

    def subscribe(self, on_frame: Callable[[AudioFrame], None]) -> None:
        """Give every frame to a function from now on. It is called in the microphone's thread: be quick."""
        self._listeners = [*self._listeners, on_frame]

    def unsubscribe(self, on_frame: Callable[[AudioFrame], None]) -> None:
        """Stop that; no effect if it was not subscribed."""
        self._listeners = [known for known in self._listeners if known != on_frame]

    def start(self) -> None:
        """Start listening. No effect if it does already."""
        if self._thread is not None:
            return
        self._stop.clear()
        self.sent = self.skipped = 0
        self._thread = threading.Thread(target=self._run, name="microphone", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Stop listening. No effect if it does not listen."""
        self._stop.set()
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join()
        self._thread = None

    @property
    def running(self) -> bool:
        """Whether it listens."""
        return self._thread is not None and self._thread.is_alive()

    def __enter__(self) -> Microphone:
        self.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self.stop()

    def _run(self) -> None:
        begin, number = time.monotonic(), 0
        while True:
            # A frame can be handed on when its last sample has been heard.
            late = time.monotonic() - (begin + (number + 1) * self._frame_s)
            if late > BACKLOG_S:
                skipped = int(late / self._frame_s)
                self.skipped += skipped
                number += skipped
                late -= skipped * self._frame_s
            if self._stop.wait(max(0.0, -late)):
                return
            late = time.monotonic() - (begin + (number + 1) * self._frame_s)
            timestamp_us = self.clock.realtime_us() - round((late + self._frame_s) * MICROSECONDS)
            samples = self.sound.samples(number * self.frame_samples, self.frame_samples)
            self._hand_on(AudioFrame(timestamp_us, samples))
            number += 1

    def _hand_on(self, frame: AudioFrame) -> None:
        self.sent += 1
        for listener in self._listeners:
            try:
                listener(frame)
            except Exception:  # a listener's fault must not silence the others
                _log.exception("a frame of sound could not be handed on")
