"""The process that draws for `camera_process`. Run as `python -m asimov_gym.rendering.camera_worker JOB`.

JOB is a JSON object with the sizes and the descriptors that were handed over; poses come in on standard input. For each
pose that it gets round to, always the newest, the process draws every camera and says where the pictures are. It ends
when standard input does, so it never outlives the one that started it.
"""

from __future__ import annotations

import json
import os
import pickle
import signal
import struct
import sys
from contextlib import suppress
from dataclasses import asdict, dataclass

POSE_HEADER = struct.Struct("=qq")
"""Sequence number and timestamp (µs); the generalised positions follow as float64."""
NOTICE = struct.Struct("=qqii")
"""Sequence number and timestamp of the pose shown, camera, slot of the ring."""
READY = -1
"""Sequence number of the notice that says that the process can draw."""
NICENESS = 10
"""Added to the process's niceness: late pictures are dropped, a late robot falls."""
_READ_BYTES = 1 << 20
"""More than a pipe holds, so that one read gets every pose that waits."""


@dataclass(frozen=True)
class Job:
    """What a worker needs to know."""

    cameras: tuple[str, ...]
    width: int
    height: int
    model_file: int
    """Descriptor of a file with the pickled model."""
    ring_file: int
    """Descriptor of the shared pictures."""
    notices: int
    """Descriptor of the pipe for notices."""

    def to_json(self) -> str:
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> Job:
        fields = json.loads(text)
        return cls(**fields | {"cameras": tuple(fields["cameras"])})


def pose_record(sequence: int, timestamp_us: int, qpos: bytes) -> bytes:
    """A pose as it goes over the pipe."""
    return POSE_HEADER.pack(sequence, timestamp_us) + qpos


def work(job: Job) -> None:
    """Draw until standard input ends."""
    import numpy as np

    from asimov_gym.rendering.frame_ring import FrameRing
    from asimov_gym.rendering.offscreen import LIVE, OffscreenRenderer

    with open(job.model_file, "rb") as file:
        model = pickle.load(file)
    ring = FrameRing(job.ring_file, len(job.cameras), job.width, job.height)
    renderer = OffscreenRenderer(model, job.width, job.height, LIVE)
    for camera in job.cameras:  # the first picture takes longer than the others
        renderer.draw(model.qpos0, camera)
    os.write(job.notices, NOTICE.pack(READY, 0, 0, 0))
    size = POSE_HEADER.size + model.nq * 8
    while poses := os.read(sys.stdin.fileno(), _READ_BYTES):
        newest = poses[-size:]  # whole poses only: each was written in one piece
        sequence, timestamp_us = POSE_HEADER.unpack_from(newest)
        qpos = np.frombuffer(newest, offset=POSE_HEADER.size)
        for index, camera in enumerate(job.cameras):
            slot = ring.take(index)
            if slot is not None:
                renderer.draw(qpos, camera, out=ring.picture(index, slot))
                os.write(job.notices, NOTICE.pack(sequence, timestamp_us, index, slot))


def main() -> None:
    """Do the job in the first argument."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # ctrl-C is for the robot, which then closes the pipe
    os.nice(NICENESS)
    with suppress(BrokenPipeError):  # the robot is gone
        work(Job.from_json(sys.argv[1]))


if __name__ == "__main__":
    main()
